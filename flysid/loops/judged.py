"""What the gains of an axis mean, flight by flight: measured, checked, put into words."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from flysid.errors import DataError, UsageError
from flysid.laws.described import blackbox_law, parameter_law
from flysid.loops.betaflight import AXES, NO_CONDITIONS, Conditions, betaflight
from flysid.loops.between_flights import Curve
from flysid.loops.blackbox_loops import record_of, settings_of
from flysid.loops.controller import Controller, refuse_misfit
from flysid.loops.law_parts import TermCheck
from flysid.loops.margins import (
    Figure,
    Margins,
    flight_curves,
    loop_around,
    margins,
    margins_across,
    trusted_band,
)
from flysid.loops.moved_means import conditions_under
from flysid.loops.parameter_checks import ardupilot_checks, px4_checks
from flysid.loops.parameter_laws import ardupilot, px4, px4_law
from flysid.loops.parameterlogs import ardupilot_parameters, ardupilot_record, px4_parameters, px4_record
from flysid.loops.stick_response import Loop, StickRecord
from flysid.progress import tell

CAUTION = (
    "Calculated from what past flights did; nothing was tested on the vehicle. The margins hold for these "
    "flights, below the limits of the motors. They are not a recommendation to raise a gain."
)


@dataclass(frozen=True, eq=False)
class Judged:
    """One axis of the flights that flew the same gains.

    Attributes
    ----------
    flights : their names.
    gains : as the firmware names them.
    refused : why nothing is known; "" where something is.
    miss : how far the controller that the gains make is from what the log recorded.
    checks : the same of its terms, the worst of the flights.
    law : firmware and version, where its law is described.
    margins : what is known of these flights; of several the intervals hold the scatter between them.
    across : the same with that scatter even of one flight, to compare sets of gains; None of a set that
        stands alone, or where fewer than two flights show their plant.
    """

    axis: str
    flights: tuple[str, ...]
    gains: Mapping[str, float]
    refused: str = ""
    hint: str = ""
    miss: float = math.nan
    margins: Margins | None = None
    loop: Loop | None = None
    controller: Controller | None = None
    checks: tuple[TermCheck, ...] = ()
    law: str = ""
    across: Margins | None = None

    def lines(self) -> list[str]:
        """At most five lines for people."""
        gains = ", ".join(f"{name} {value:g}" for name, value in self.gains.items())
        whose = f"{len(self.flights)} flights" if len(self.flights) > 1 else ", ".join(self.flights)
        head = f"{self.axis}: {gains} ({whose})" if gains else f"{self.axis} ({whose})"
        if self.margins is None:
            told = [f"  {self.law}, term by term: {self._terms()}"] if self.checks else []
            return [head, f"  refused: {self.refused}", f"  try: {self.hint}", *told]
        low, high = self.margins.band_hz
        crossing, peaks, answers = (_known(row) for row in _rows(self.margins))
        checked = f"the rebuilt controller gives the recorded output to {100.0 * self.miss:.0f} %"
        if self.checks:
            checked += f" ({self.law}: {self._terms()})"
        rows = [
            "; ".join(crossing),
            "; ".join(peaks + _list_unknown(self.margins)),
            "; ".join(answers),
            f"identified from {low:.0f} to {high:.0f} Hz; {checked}",
        ]
        return [head, *(f"  {row}" for row in rows if row)]

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        told: dict[str, Any] = {
            "axis": self.axis,
            "flights": list(self.flights),
            "gains": dict(self.gains),
            "refused": self.refused or None,
            "law": self.law or None,
            "terms": [asdict(check) | {"fits": check.fits} for check in self.checks],
        }
        if self.margins is None:
            return told
        return told | {
            "controller_miss": self.miss,
            "band_hz": list(self.margins.band_hz),
            "figures": _plain_figures(self.margins),
            "across_flights": _plain_figures(self.across) if self.across is not None else None,
        }

    def _terms(self) -> str:
        return ", ".join(check.said() for check in self.checks)


def _worst(of_flights: Iterable[tuple[TermCheck, ...]]) -> tuple[TermCheck, ...]:
    """Of every term the check that misses most."""
    worst: dict[str, TermCheck] = {}
    for check in (own for checks in of_flights for own in checks):
        known = worst.setdefault(check.term, check)
        if check.miss > known.miss:
            worst[check.term] = check
    return tuple(worst.values())


def _rows(m: Margins) -> list[list[tuple[str, Figure, str, str]]]:
    """Name, figure, format and unit of every figure, row by row."""
    return [
        [
            ("crossover", m.crossover_hz, ".1f", " Hz"),
            ("phase margin", m.phase_deg, ".0f", " deg"),
            ("delay margin", m.delay_ms, ".1f", " ms"),
        ],
        [("gain margin", m.gain_db, ".1f", " dB"), ("peak sensitivity Ms", m.ms, ".2f", "")],
        [
            ("bandwidth (-3 dB)", m.bandwidth_hz, ".1f", " Hz"),
            ("noise gain (thousandths of the output per deg/s)", m.noise, ".2f", ""),
        ],
    ]


def _known(row: list[tuple[str, Figure, str, str]]) -> list[str]:
    return [
        f"{name} {figure.said(form, unit)}" for name, figure, form, unit in row if math.isfinite(figure.low)
    ]


def _list_unknown(m: Margins) -> list[str]:
    """The figures that are not determined, each reason once."""
    by_reason: dict[str, list[str]] = {}
    for name, figure, _, _ in (item for row in _rows(m) for item in row):
        if not math.isfinite(figure.low):
            by_reason.setdefault(figure.why, []).append(name)
    return [f"not determined: {', '.join(names)} ({why})" for why, names in by_reason.items()]


def _plain_figures(m: Margins) -> dict[str, Any]:
    return {name: value.to_dict() for name, value in vars(m).items() if isinstance(value, Figure)}


@dataclass(frozen=True)
class Kind:
    """How one family of logs states and records its loops.

    Attributes
    ----------
    mark : a stream that only these logs have.
    recipe : the shipped one of their rate loops.
    settings : of a log, by name.
    record : (log, axis, settings) -> the loop, and what gains depended on.
    controller : (settings, axis, conditions) -> the law.
    under : (log, axis, settings, other settings, conditions, plant) -> conditions under the others; None
        where they stay the same.
    alike : (settings, axis) -> what flights that are judged together share.
    """

    mark: str
    recipe: str
    settings: Callable[[Any], Mapping[str, Any]]
    record: Callable[[Any, str, Mapping[str, Any]], tuple[StickRecord, Conditions]]
    controller: Callable[[Mapping[str, Any], str, Conditions], Controller]
    alike: Callable[[Mapping[str, Any], str], tuple[Any, ...]]
    under: Callable[..., Conditions] | None = None


KINDS = (
    Kind(
        "vehicle_rates_setpoint",
        "px4-rates",
        px4_parameters,
        lambda log, axis, stated: (px4_record(log, axis), px4_checks(log, axis, stated)),
        lambda stated, axis, _: px4(stated, axis),
        lambda stated, axis: (
            *_own(stated, f"MC_{axis.upper()}RATE_"),
            *_own(stated, "IMU_DGYRO_CUTOFF"),
            px4_law(stated).since,
        ),
    ),
    Kind(
        "RATE",
        "ardupilot-rate",
        ardupilot_parameters,
        lambda log, axis, stated: (ardupilot_record(log, axis), ardupilot_checks(log, axis, stated)),
        lambda stated, axis, _: ardupilot(stated, axis),
        lambda stated, axis: _own(stated, f"ATC_RAT_{parameter_law('arducopter').part('axes')[axis]}_"),
    ),
    Kind(
        "main",
        "betaflight-rate",
        settings_of,
        record_of,
        betaflight,
        lambda settings, axis: _of_law(settings, axis),
        conditions_under,
    ),
)


Settings = Mapping[str, Any] | DataError | UsageError
"""What a log states, or why it states nothing that is known."""
Stating = tuple[Any, Settings]
"""A log, and what it states."""


def _state(settings: Settings) -> Mapping[str, Any]:
    if isinstance(settings, Exception):
        raise settings
    return settings


def _own(stated: Mapping[str, float], stem: str) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((name, value) for name, value in stated.items() if name.startswith(stem)))


def _of_law(settings: Mapping[str, str], axis: str) -> tuple[str, ...]:
    """An axis' gains, the firmware, and every line of the header that its law reads."""
    law = blackbox_law(settings.get("Firmware revision", ""))
    lines = [line for names in law.names.values() for line in names]
    return tuple(settings.get(line, "") for line in (AXES[axis], "Firmware revision", *lines))


def states_gains(log: Any) -> bool:
    """Whether a log is of a family whose gains are read."""
    return any(kind.mark in log.facts.streams for kind in KINDS)


def rate_recipe(log: Any) -> str:
    """The shipped recipe of the loops whose gains a log states."""
    return kind_of(log).recipe


def kind_of(log: Any) -> Kind:
    """The family of a log; the last, which names what is missing, where none fits."""
    return next((kind for kind in KINDS if kind.mark in log.facts.streams), KINDS[-1])


def judge(logs: Iterable[Any], axes: Iterable[str] = ("roll", "pitch")) -> list[Judged]:
    """Every axis of every set of gains, in the order of the flights.

    Parameters
    ----------
    logs : flights of a lake.

    Flights of the same gains are judged together. What cannot be known is refused with its reason; nothing is
    raised.
    """
    groups = _flown_alike(logs, dict.fromkeys(axes))
    measured: dict[str, list[Judged]] = {}
    for i, (axis, group) in enumerate(groups):
        tell(f"measuring the {axis} loop", log=group[0][0].name, share=i / len(groups))
        measured.setdefault(axis, []).append(_measure(group, axis))
    return [judged for sets in measured.values() for judged in find_margins(sets)]


def find_margins(sets: Sequence[Judged]) -> list[Judged]:
    """The sets of gains of one axis with the margins of their loops; a loop without is refused.

    All flights show how plants scatter between flights, whatever their gains.
    """
    loops = [judged.loop for judged in sets if judged.loop is not None]
    curves = flight_curves(loops)
    return [_with_margins(judged, curves, len(loops) > 1) for judged in sets]


def _with_margins(judged: Judged, curves: Sequence[Curve], is_compared: bool) -> Judged:
    if judged.loop is None or judged.controller is None:
        return judged
    law = judged.controller.at_rest()
    try:
        own = margins(judged.loop, law)
        across = margins_across(judged.loop, law, curves, own)
        is_several = len(judged.loop.blocks) > 1
        stated = across if is_several and across is not None else own
        return replace(judged, margins=stated, across=across if is_compared else None)
    except (DataError, UsageError) as error:
        return replace(
            judged,
            refused=error.message,
            hint=error.hint,
            miss=math.nan,
            loop=None,
            controller=None,
        )


def sets_of_gains(logs: Iterable[Any], axes: Iterable[str] = ("roll", "pitch")) -> int:
    """How many different sets of gains flights flew, as far as they state them: the most of any axis."""
    stating = [log for log in logs if states_gains(log)]
    sets = Counter(axis for axis, _ in _flown_alike(stating, axes))
    return max(sets.values(), default=0)


def _flown_alike(logs: Iterable[Any], axes: Iterable[str]) -> list[tuple[str, list[Stating]]]:
    """Of every axis the flights by their gains, in their order; one that states none stands alone."""
    stating = [(log, _settings(log)) for log in logs]
    found: list[tuple[str, list[Stating]]] = []
    for axis in axes:
        groups: dict[tuple[Any, ...], list[Stating]] = {}
        for log, settings in stating:
            groups.setdefault(_gains_key(log, settings, axis), []).append((log, settings))
        found += [(axis, group) for group in groups.values()]
    return found


def _settings(log: Any) -> Settings:
    """What a log states, or why it states nothing that is known."""
    try:
        return kind_of(log).settings(log)
    except (DataError, UsageError) as error:
        return error


def _gains_key(log: Any, settings: Settings, axis: str) -> tuple[Any, ...]:
    """Equal for flights of the same gains."""
    kind = kind_of(log)
    if isinstance(settings, Exception):
        return (log.name,)
    try:
        return (kind.mark, kind.alike(settings, axis))
    except (DataError, UsageError):
        return (log.name,)


def _measure(group: list[Stating], axis: str) -> Judged:
    """The loop and the controller of one set of gains, or why there is none."""
    logs = [log for log, _ in group]
    names = tuple(log.name for log in logs)
    gains: Mapping[str, float] = {}
    law = ""
    checks: tuple[TermCheck, ...] = ()
    try:
        kind = kind_of(logs[0])
        settings = [_state(own) for _, own in group]
        stated = kind.controller(settings[0], axis, NO_CONDITIONS)
        gains, law = stated.gains, stated.law
        parts = [kind.record(log, axis, own) for log, own in zip(logs, settings, strict=True)]
        each = [kind.controller(own, axis, flown) for own, (_, flown) in zip(settings, parts, strict=True)]
        checks = _worst(flown.checks for _, flown in parts)
        controller = each[0]
        loop = loop_around([record for record, _ in parts], controller)
        low, high = trusted_band(loop)
        miss = refuse_misfit(controller, loop, low, high, checks)
        return Judged(axis, names, gains, miss=miss, loop=loop, controller=controller, checks=checks, law=law)
    except (DataError, UsageError) as error:
        return Judged(axis, names, gains, error.message, error.hint, checks=checks, law=law)
    except ValueError as error:
        return Judged(axis, names, gains, f"the stated gains cannot be read: {error}", "log them again")
