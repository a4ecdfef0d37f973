"""A design: gains beside the present ones, what each means on every plant, and its files."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flysid.design.drawn_plants import PlantSet
from flysid.design.firmware import SAFETY, parameter_file
from flysid.design.gain_search import Bounds
from flysid.design.law import TUNED, Gains, LoopParts
from flysid.design.loopfigures import Laws, figures
from flysid.errors import StoreError, UsageError
from flysid.foreign import inner_path, read_object, shaped
from flysid.showing import counted

FORMAT = "flysid-design"
RATE_FORMAT = "flysid-rate-design"
VERSION = 1
FILE = "design.json"
SAID = {
    "present": "with your gains",
    "present_x2": "with your gains times two",
    "next": "for the next flight",
    "goal": "where this leads",
}
"""Laws of a design in the order in which they are told."""


WAY_BACK = "The old gains are in old.param, beside new.param."


@dataclass(frozen=True)
class DesignMeaning:
    """What a law means over all plants: the smallest and the largest of each figure.

    `stable`: on every plant.
    `crossover_hz`, `ms`, `peak`, `noise`: see `flysid.design.loopfigures.Figures`.
    `gain_db`, `phase_deg`: margins; inf where the loop never turns or never crosses.
    `tracking`: m^2 s, after a step of 1 m.
    """

    stable: bool
    crossover_hz: tuple[float, float]
    gain_db: tuple[float, float]
    phase_deg: tuple[float, float]
    ms: tuple[float, float]
    peak: tuple[float, float]
    noise: tuple[float, float]
    tracking: tuple[float, float]

    @classmethod
    def of(cls, gains: Gains, plants: PlantSet) -> DesignMeaning:
        """The figures of one law."""
        import control

        found = figures(Laws.of(gains), plants.responses, LoopParts.at(plants.omega, plants.dt_s))
        loops = found.loop[0]
        sides = [
            control.stability_margins((np.abs(x), np.degrees(np.unwrap(np.angle(x))), plants.omega))
            for x in loops
        ]
        gain = [20.0 * math.log10(s[0]) if 0.0 < s[0] < math.inf else math.inf for s in sides]
        return cls(
            bool(found.stable.all()),
            _ends(found.crossover[0] / (2.0 * np.pi)),
            _ends(np.asarray(gain)),
            _ends(np.asarray([s[1] for s in sides])),
            _ends(found.ms[0]),
            _ends(found.peak[0]),
            _ends(found.noise[0]),
            _ends(found.tracking[0]),
        )

    def line(self, whose: str, noise: str) -> str:
        """One line for people; `noise` is the format of what noise does."""
        if not self.stable:
            return f"{whose} the loop is unstable on some of the plants"
        return (
            f"{whose}: crossover {_range(self.crossover_hz, '.2f')} Hz, Ms {_range(self.ms, '.2f')}, "
            f"phase margin {_range(self.phase_deg, '.0f')} deg, squared error of a step "
            f"{_range(self.tracking, '.2f')} m^2 s; " + noise.format(self.noise[1])
        )


def _ends(values: Any) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


def _range(ends: tuple[float, float], form: str) -> str:
    low, high = (format(v, form) for v in ends)
    return low if low == high else f"{low} to {high}"


@dataclass(frozen=True, eq=False)
class Axis:
    """One channel of a design.

    `units`: of input and output.
    `sign`: -1 where the output falls as the input rises: the controller's output is turned round.
    `laws`: by the names of `SAID`, those that there are.
    `meanings`: of each law.
    `bounds`: that "next" and "goal" keep on every plant.
    `plants`: labels of all.
    `band_hz`: that the flights tell.
    `notes`: sentences.
    """

    channel: str
    input: str
    output: str
    units: tuple[str, str]
    sign: float
    dt_s: float
    laws: Mapping[str, Gains]
    meanings: Mapping[str, DesignMeaning]
    bounds: Bounds
    plants: tuple[str, ...]
    band_hz: tuple[float, float]
    notes: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """For people: gains and what they mean."""
        low, high = self.band_hz
        told = [
            f"{self.channel}: {self.input} -> {self.output}, {counted(len(self.plants), 'plant')}; "
            f"known from {low:.2f} to {high:.2f} Hz"
        ]
        noise = f"1 {self.units[1]} of noise moves {self.input} by at most {{:.3g}} {self.units[0]}"
        for name, words in SAID.items():
            if name in self.laws:
                told.append(f"  {self.meanings[name].line(words, noise)}")
        return told + [f"  {note}" for note in self.notes]

    def table(self) -> list[tuple[str, ...]]:
        """Rows of gains, the first of names."""
        names = [n for n in SAID if n in self.laws]
        rows = [("", *(SAID[n] for n in names))]
        return rows + [(gain, *(f"{getattr(self.laws[n], gain):.4g}" for n in names)) for gain in TUNED]


@dataclass(frozen=True, eq=False)
class Design:
    """What `flysid design` found.

    `firmware`: name, and in words the versions whose parameters these are.
    `axes`: designed channels.
    `refused`: channel -> (why, what to fly next).
    `old`, `new`: parameters of the vehicle; empty without present gains.
    """

    run: str
    firmware: tuple[str, str]
    axes: tuple[Axis, ...]
    refused: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    old: Mapping[str, float] = field(default_factory=dict)
    new: Mapping[str, float] = field(default_factory=dict)

    @property
    def caution(self) -> str:
        """What everybody who reads the gains must know."""
        if self.new:
            return f"{SAFETY} {WAY_BACK}"
        return f"No new.param: without the present gains (--old FILE) there is no way back. {SAFETY}"

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "safety": SAFETY,
            "run": self.run,
            "firmware": list(self.firmware),
            "axes": [_plain(asdict(axis)) for axis in self.axes],
            "refused": {name: list(words) for name, words in self.refused.items()},
            "old": dict(self.old),
            "new": dict(self.new),
        }

    def files(self) -> dict[str, str]:
        """Name -> text; parameter files only beside the old values, which are the way back."""
        found = {FILE: json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"}
        if self.new:
            whose = f"Parameters of {self.firmware[1]}."
            found["old.param"] = parameter_file(
                self.old, (f"The gains before the design of {self.run}: the way back. {whose}", SAFETY)
            )
            changed = "; ".join(f"{k} {self.old.get(k, 0.0):g} -> {v:g}" for k, v in self.new.items())
            found["new.param"] = parameter_file(
                self.new,
                (
                    f"For the next flight only, of {self.run}: no gain more than doubled or halved. {whose}",
                    changed,
                    SAFETY,
                    WAY_BACK,
                ),
            )
        return found


def _plain(value: Any) -> Any:
    """Infinite and unknown numbers as null."""
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def open_design(path: Path) -> tuple[Axis, ...]:
    """The channels of a design's JSON, or of the folder that holds it.

    Raises UsageError: no such file, or a design of rate loops. Raises StoreError: no design, or damaged.
    """
    file = inner_path(path, FILE, path) if path.is_dir() else path
    if not file.is_file():
        raise UsageError("no such design", path=file, hint="make one: flysid design RUN -o DIR")
    body = read_object(file, "a design", "design again")
    if body.get("format") == RATE_FORMAT:
        raise UsageError(
            "a design of rate loops, and only position loops are flown",
            path=file,
            hint="what it would do on the flights: flysid predict LOG --file new.txt, or new.param",
        )
    if (body.get("format"), body.get("version")) != (FORMAT, VERSION):
        raise StoreError("not a design of this version of flysid", path=file)
    try:
        return shaped(_with_infinity(body.get("axes")), tuple[Axis, ...])
    except ValueError as error:
        raise StoreError(f"the design is damaged: {error}", path=file, hint="design again") from error


def _with_infinity(value: Any) -> Any:
    """The numbers that `_plain` has left out."""
    if isinstance(value, dict):
        return {k: _with_infinity(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_with_infinity(v) for v in value]
    return math.inf if value is None else value
