"""Which vehicles differ, from themselves and from the others: one test per vehicle, channel and question.

changed : late flights against early ones of one vehicle. What all vehicles have in common between the two
    (a season, another kind of flying) is the fleet's and taken off.
unlike : late flights of one vehicle against those of the vehicles that have not changed.

Both compare log gain and phase at the frequencies of the band (`band`). Of all tests together, Benjamini and
Hochberg (1995) hold the share of false ones among the flagged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import stats

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.fleet.models.band import Band, band_of
from flysid.fleet.models.common_grid import Sampling
from flysid.fleet.models.groups import Response, fit_group, response_of
from flysid.fleet.models.scatter import PER_NUMBER, Scatter, Tail, pool, tail_of
from flysid.fleet.models.triangles import Triangle
from flysid.showing import counted

Question = Literal["changed", "unlike"]


@dataclass(frozen=True, eq=False)
class FlightPart:
    """What is kept of a flight and a channel; `start_ns` is UTC, None where the log does not know."""

    flight: str
    vehicle: str
    firmware: str
    start_ns: int | None
    triangle: Triangle


@dataclass(frozen=True, eq=False)
class Test:
    """A vehicle's answer to one question.

    `difference`: (2 k,) of log gain and phase (rad).
    `covariance`: (2 k, 2 k) of it.
    `statistic`, `p`: Hotelling's T², and the chance of a larger one where nothing differs.
    `freedom`: behind the covariance.
    `flights`: before and after, or of the vehicle and of the others.
    `flagged`: the rate of false discoveries allows to say so.
    """

    channel: str
    vehicle: str
    question: Question
    difference: FloatArray
    covariance: FloatArray
    statistic: float
    p: float
    freedom: float
    flights: tuple[int, int]
    flagged: bool = False

    @property
    def sigmas(self) -> FloatArray:
        """(2 k,) standard deviations of the difference."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, eq=False)
class JudgedChannel:
    """A channel and its tests.

    `flown`: the vehicles' flights, in the order of time.
    `present`: responses of their late flights.
    `too_few`: vehicles that cannot be compared with themselves, and why.
    `common`: (2 k,) what all vehicles have in common from early to late; None where they are too few to tell.
    """

    channel: str
    sampling: Sampling
    band: Band
    scatter: Scatter
    tests: tuple[Test, ...]
    flown: Mapping[str, list[FlightPart]]
    present: Mapping[str, Response]
    too_few: Mapping[str, str]
    common: FloatArray | None


def judge_channel(
    channel: str, parts: Sequence[FlightPart], sampling: Sampling, before_ns: int | None = None
) -> JudgedChannel:
    """Has any vehicle changed in this channel? No test is flagged yet: that is for `judge`.

    `before_ns`: flights that began before (UTC) are early; None: the first half of each vehicle's flights.
    Raises DataError: several inputs or outputs; no band of coherence; too few repeated flights.
    """
    if len(sampling.inputs) != 1 or len(sampling.outputs) != 1:
        raise DataError(
            f"channel {channel!r} has {counted(len(sampling.inputs), 'input')} and "
            f"{counted(len(sampling.outputs), 'output')}",
            hint="responses are compared from one input to one output",
        )
    useful = [p for p in parts if p.triangle.rows]
    none = np.zeros((len(sampling.omega), 2, 2), dtype=np.complex128)
    spectra = sum((p.triangle.spectra for p in useful), none)
    band = band_of(spectra, sampling.omega, 0, 1, channel)
    flown = by_vehicle(useful)
    too_few = {p.vehicle: "no flight is long enough" for p in parts if p.vehicle not in flown}
    early: dict[str, Response] = {}
    late: dict[str, Response] = {}
    divided: dict[str, tuple[list[FlightPart], list[FlightPart]]] = {}
    for name, own in flown.items():
        first, second = split(own, before_ns)
        try:
            late[name] = _response(second or own, sampling, band)
            if first and second:
                early[name] = _response(first, sampling, band)
                divided[name] = (first, second)
            else:
                too_few[name] = f"{len(first)} early and {len(second)} late flights"
        except DataError as error:
            too_few[name] = error.message
    scatter = pool([r[name] for name in early for r in (early, late)], channel)
    shifts = {name: wrap_phases(late[name].value - early[name].value) for name in early}
    size = 2 * len(band.frequencies)
    differences: dict[str, tuple[FloatArray, FloatArray, float]] = {}
    for name, shift in shifts.items():
        common, spread = _common([s for other, s in shifts.items() if other != name], size)
        difference = wrap_phases(shift - common)
        covariance = scatter.covariance(early[name]) + scatter.covariance(late[name]) + spread
        differences[name] = (difference, covariance, hotelling(difference, covariance))
    usual = tail_of([], size, scatter.freedom)
    ordinary = _ordinary({n: usual.p_value(found[2], size) for n, found in differences.items()})
    mixed = [_mix(*divided[name], sampling, band, scatter) for name in ordinary]
    tail = tail_of([value for value in mixed if value is not None], size, scatter.freedom)
    tests = [
        Test(channel, name, "changed", difference, tail.scale * covariance, statistic,
             tail.p_value(statistic, size), tail.freedom, (early[name].flights, late[name].flights))
        for name, (difference, covariance, statistic) in differences.items()
    ]  # fmt: skip
    shared = _common(list(shifts.values()), size)[0] if shifts else None
    return JudgedChannel(channel, sampling, band, scatter, tuple(tests), flown, late, too_few, shared)


def judge(channels: Sequence[JudgedChannel], rate: float) -> list[JudgedChannel]:
    """All channels with the vehicles compared with each other too, and the tests flagged.

    `rate`: of false discoveries, e.g. 0.05.
    """
    first = flagged([t for c in channels for t in c.tests], rate)
    changed = {t.vehicle for t in first if t.flagged}
    whole = [t for c in channels for t in (*c.tests, *_unlike(c, changed))]
    decided = flagged(whole, rate)
    return [replace(c, tests=tuple(t for t in decided if t.channel == c.channel)) for c in channels]


def flagged(tests: Sequence[Test], rate: float) -> list[Test]:
    """The tests, flagged where Benjamini and Hochberg's rule allows it."""
    if not tests:
        return []
    adjusted = stats.false_discovery_control([t.p for t in tests])
    return [replace(t, flagged=bool(q <= rate)) for t, q in zip(tests, adjusted, strict=True)]


def _unlike(judged: JudgedChannel, changed: set[str]) -> list[Test]:
    """Every vehicle against the others that have not changed; none where they are too few.

    The others' spread holds what makes specimens differ, and how unsure an ordinary response is. Where the
    vehicle's own is less sure than that, the difference is added.
    """
    reference = {n: r.value for n, r in judged.present.items() if n not in changed}
    size = 2 * len(judged.band.frequencies)
    if len(reference) <= PER_NUMBER * size:
        return []
    middle = np.median(np.array(list(reference.values())), axis=0)
    unsure = {n: judged.scatter.covariance(r) for n, r in judged.present.items()}
    ordinary = np.mean([unsure[n] for n in reference], axis=0)
    tests = []
    for name, response in judged.present.items():
        others = np.array([wrap_phases(v - middle) for n, v in reference.items() if n != name])
        difference = wrap_phases(response.value - middle) - others.mean(axis=0)
        covariance = np.cov(others.T) * (1.0 + 1.0 / len(others)) + _positive(unsure[name] - ordinary)
        left = len(others) - size
        covariance *= (len(others) - 1) / left
        statistic = hotelling(difference, covariance)
        p = Tail(1.0, left).p_value(statistic, size)
        tests.append(
            Test(judged.channel, name, "unlike", difference, covariance, statistic, p, left,
                 (response.flights, sum(judged.present[n].flights for n in reference if n != name)))
        )  # fmt: skip
    return tests


def _ordinary(p_values: Mapping[str, float], *, suspect: float = 0.05) -> list[str]:
    """Vehicles that no test of them alone would flag: one that has changed is no measure of how others stray.

    `suspect`: adjusted p below which a vehicle does not count among those that tell how far T² strays.
    """
    adjusted = stats.false_discovery_control(list(p_values.values())) if p_values else []
    return [name for name, q in zip(p_values, adjusted, strict=True) if q > suspect]


def _mix(
    first: Sequence[FlightPart],
    second: Sequence[FlightPart],
    sampling: Sampling,
    band: Band,
    scatter: Scatter,
) -> float | None:
    """T² between two mixtures of early and late flights, which a change is in alike; None of too few."""
    if len(first) < 2 or len(second) < 2:
        return None
    try:
        one = _response([*first[::2], *second[1::2]], sampling, band)
        other = _response([*first[1::2], *second[::2]], sampling, band)
    except DataError:
        return None
    return hotelling(
        wrap_phases(one.value - other.value), scatter.covariance(one) + scatter.covariance(other)
    )


def _positive(matrix: FloatArray) -> FloatArray:
    """The part of a symmetric matrix that belongs to its positive eigenvalues."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _common(shifts: Sequence[FloatArray], size: int) -> tuple[FloatArray, FloatArray]:
    """The median shift of vehicles and its covariance; zero where they are too few to tell."""
    if len(shifts) <= PER_NUMBER * size:
        return np.zeros(size), np.zeros((size, size))
    every = np.array(shifts)
    middle = np.median(every, axis=0)
    robust = stats.median_abs_deviation(every, axis=0, scale="normal")
    return middle, np.diag(robust**2 * np.pi / 2.0 / len(every))


def since(judged: JudgedChannel, vehicle: str) -> str:
    """The first flight after the split of a vehicle's flights that separates its parts best."""
    own = judged.flown[vehicle]
    common = np.zeros(2 * len(judged.band.frequencies)) if judged.common is None else judged.common
    best = ("", -1.0)
    for at in range(1, len(own)):
        try:
            first = _response(own[:at], judged.sampling, judged.band)
            second = _response(own[at:], judged.sampling, judged.band)
        except DataError:
            continue
        shift = wrap_phases(second.value - first.value - common)
        covariance = judged.scatter.covariance(first) + judged.scatter.covariance(second)
        statistic = hotelling(shift, covariance)
        if statistic > best[1]:
            best = (own[at].flight, statistic)
    return best[0]


def _response(parts: Sequence[FlightPart], sampling: Sampling, band: Band) -> Response:
    rows = sum(p.triangle.rows for p in parts)
    return response_of(fit_group([p.triangle.r for p in parts], rows, sampling), sampling, band.frequencies)


def by_vehicle(parts: Sequence[FlightPart]) -> dict[str, list[FlightPart]]:
    """The flights of each vehicle, by name, in the order of time; of those without UTC, by their ids."""
    found: dict[str, list[FlightPart]] = {}
    for part in sorted(parts, key=lambda p: (p.vehicle, p.start_ns or 0, p.flight)):
        found.setdefault(part.vehicle, []).append(part)
    return found


def split(own: Sequence[FlightPart], before_ns: int | None) -> tuple[list[FlightPart], list[FlightPart]]:
    """Early and late flights."""
    if before_ns is None:
        half = len(own) // 2
        return list(own[:half]), list(own[half:])
    early = [p for p in own if p.start_ns is not None and p.start_ns < before_ns]
    return early, [p for p in own if p.start_ns is not None and p.start_ns >= before_ns]


def hotelling(difference: FloatArray, covariance: FloatArray) -> float:
    """T² of a difference."""
    return float(difference @ np.linalg.solve(covariance, difference))


def wrap_phases(value: FloatArray) -> FloatArray:
    """(2 k,) with its phases between -pi and pi."""
    k = len(value) // 2
    phase = np.angle(np.exp(1j * value[k:]))
    return np.concatenate([value[:k], phase])
