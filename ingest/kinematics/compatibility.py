"""One log's instruments held against each other, and what of it is a finding."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from flysid.dataset import FloatArray
from flysid.errors import FlysidError
from flysid.ingest.align import resample
from flysid.ingest.align.clocks import align_clocks
from flysid.ingest.align.conditions import condition_spans
from flysid.ingest.align.recipe import Recipe, parse_recipe
from flysid.ingest.align.resample import RecordedSignal
from flysid.ingest.align.signals import Loaded, Log, find_source, load_signal
from flysid.ingest.excitation.excitation import QUIET
from flysid.ingest.kinematics.agreement import Agreement, MotionRecord, agreement
from flysid.ingest.kinematics.motion import (
    INSTRUMENTS,
    MIN_SECONDS,
    attitude,
    gridded,
    highest_hz,
    without_jumps,
)

GRAVITY_RANGE = 0.026
"""m/s^2: half of what gravity varies by from the equator to the poles."""
UNKNOWN_SCALE = 0.5
"""An axis whose scale is not known better did not move enough; one off by more follows another motion."""
AGAINST: Mapping[str, str] = {
    "gyro": "the attitude's rate",
    "accelerometer": "what attitude and velocity say",
    "velocity": "the position's rate",
    "heading_velocity": "the position's rate",
}
FLY: Mapping[str, str] = {
    "p": "roll doublets",
    "q": "pitch doublets",
    "r": "turns of the heading to either side",
    "f_x": "fast flight forwards and back",
    "f_y": "fast flight to either side",
    "f_z": "climbs and descents with hard starts",
    "v_north": "legs north and south",
    "v_east": "legs east and west",
    "v_down": "climbs and descents",
    "v_forward": "legs forwards and back",
    "v_right": "legs to either side",
}


@dataclass(frozen=True)
class Parameter:
    """One number between an instrument and what the others say.

    `instrument`: a channel of `quantities.toml`.
    `signal`: an axis of it; "" where the number is of all axes.
    `kind`: "bias" and "offset" (of the reading, in `unit`; an offset is at the flight's mean), "scale", "lag"
        (s) or "arm" (m; of the accelerometer forward, right and below what the velocity is of).
    `value`, `sd`: estimate and standard deviation.
    `nominal`: what it is where nothing is wrong. `tolerance`: what may pass for it.
    `unit`: of value and sd.
    `found`: it differs from its nominal value.
    """

    instrument: str
    signal: str
    kind: str
    value: float
    sd: float
    nominal: float
    tolerance: float
    unit: str
    found: bool = False

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        half = float(ndtri(0.975)) * self.sd
        return self.value - half, self.value + half

    @property
    def foreign(self) -> bool:
        """An axis that is off by more than half: the two do not describe one motion."""
        return self.found and self.kind == "scale" and abs(self.value - 1.0) > UNKNOWN_SCALE

    @property
    def chance(self) -> float:
        """p-value of the nominal value, tolerance granted."""
        beyond = max(0.0, abs(self.value - self.nominal) - self.tolerance)
        return float(2.0 * ndtr(-beyond / self.sd)) if self.sd > 0.0 else float(beyond == 0.0)


@dataclass(frozen=True)
class InstrumentCheck:
    """One instrument against the others.

    `instrument`: a channel of `quantities.toml`.
    `sources`: signal -> stream and field.
    `seconds`, `cut_s`: of flight that were compared, and that were left out around jumps of an estimator.
    `parameters`: all that was estimated.
    `still`: axes that did not move enough to show their scale.
    `reason`: why nothing was compared; "" where it was.
    """

    instrument: str
    sources: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    seconds: float = 0.0
    cut_s: float = 0.0
    parameters: tuple[Parameter, ...] = ()
    still: tuple[str, ...] = ()
    reason: str = ""

    @property
    def axes(self) -> tuple[str, ...]:
        """The instrument's signals."""
        return quantities().channels[self.instrument].outputs


@dataclass(frozen=True)
class Compatibility:
    """All that could be compared of one log."""

    name: str
    comparisons: tuple[InstrumentCheck, ...]

    @property
    def findings(self) -> tuple[Parameter, ...]:
        """What differs from its nominal value."""
        return tuple(p for c in self.comparisons for p in c.parameters if p.found)


@cache
def quantities() -> Recipe:
    """Where logs hold what is compared."""
    text = (resources.files("flysid.ingest.kinematics") / "quantities.toml").read_text("utf-8")
    return parse_recipe(tomllib.loads(text), "quantities")


def compatibility(log: Log) -> Compatibility:
    """Hold a log's instruments against each other.

    Velocity is compared first, with the position. Where it is found at fault, accelerometers are compared
    with the velocity as it should be. Findings are those that remain at 5 % a flight (Holm 1979), beyond
    what splines lose, half a period of the slower source, and the range of gravity over the earth.

    >>> from flysid.ingest.align.signals import FlightLog
    >>> found = compatibility(FlightLog(flysid.read("sample_logs/01-multisine-seed1.tlog")))
    >>> [c.instrument for c in found.comparisons if not c.reason]
    []
    """
    corrections: dict[str, Correction] = {}
    comparisons = []
    for instrument in ("velocity", "heading_velocity", "gyro", "accelerometer"):
        compared = _compare(instrument, log, corrections)
        comparisons.append(compared)
        corrections |= corrections_of(_judge([compared])[0].parameters)
    return Compatibility(log.name, tuple(_judge(comparisons)))


@dataclass(frozen=True)
class Correction:
    """What makes a reading right: (reading - bias) / scale, `lag_s` earlier."""

    scale: float = 1.0
    bias: float = 0.0
    lag_s: float = 0.0

    def apply(self, series: RecordedSignal) -> RecordedSignal:
        """The signal as it should have been logged."""
        late = round(self.lag_s * 1e9)
        return replace(series, t_ns=series.t_ns - late, x=(series.x - self.bias) / self.scale)


def corrections_of(parameters: Sequence[Parameter]) -> dict[str, Correction]:
    """By signal, from what was found: biases and scales of one axis go together, as do all axes' lags.

    Nothing where an axis follows another motion: nobody knows which of the two is right.
    """
    if any(p.foreign for p in parameters):
        return {}
    signals = dict.fromkeys(p.signal for p in parameters if p.signal)
    late = next((p.value for p in parameters if p.kind == "lag" and p.found), 0.0)
    made = {}
    for signal in signals:
        own = {p.kind: p for p in parameters if p.signal == signal}
        wrong = {kind: p.value for kind, p in own.items() if any(o.found for o in own.values())}
        if wrong or late:
            made[signal] = Correction(wrong.get("scale", 1.0), wrong.get("bias", 0.0), late)
    return made


def _compare(instrument: str, log: Log, corrections: Mapping[str, Correction]) -> InstrumentCheck:
    recipe = quantities()
    names = recipe.signals_of(instrument)
    absent = [n for n in names if find_source(recipe.signals[n].sources, log) is None]
    if absent:
        return InstrumentCheck(instrument, reason="not logged: " + ", ".join(absent))
    try:
        clocks = align_clocks(recipe.clocks, log)
        loaded = {n: clocks.apply(load_signal(n, recipe.signals[n], log)) for n in names}
        spans = condition_spans(recipe.conditions, log)
    except FlysidError as error:
        return InstrumentCheck(instrument, reason=error.message)
    sources = {n: (found.stream, found.field) for n, found in loaded.items()}
    records: list[MotionRecord] = []
    highest = np.inf
    slowest = 0.0
    whole = 0.0
    upright = []
    for boot in sorted(set.intersection(*(set(found.boots) for found in loaded.values()))):
        series = {n: _tidy(n, found, boot) for n, found in loaded.items()}
        if min(len(s.t_ns) for s in series.values()) < resample.SPIKE_SAMPLES:
            continue
        series = {n: corrections[n].apply(s) if n in corrections else s for n, s in series.items()}
        grids = gridded(series, spans.spans.get(boot, [] if spans.spans else None))
        source_s = max(resample.period_ns(s.t_ns) * 1e-9 for s in series.values())
        for grid in grids:
            record = INSTRUMENTS[instrument](grid)
            whole += len(record.measured) * record.dt_s
            records += without_jumps(record, source_s)
        if instrument == "accelerometer":
            upright += [np.abs(attitude(grid).inv().apply([0.0, 0.0, 1.0])).mean(axis=0) for grid in grids]
        if grids:
            highest = min(highest, highest_hz(series))
            slowest = max(slowest, source_s)
    if not records:
        return InstrumentCheck(
            instrument, sources, reason=f"no stretch of {MIN_SECONDS:g} s in which all of it was logged"
        )
    alive = np.max([np.ptp(r.measured, axis=0) for r in records], axis=0) > 0.0
    axes = [a for a, moves in zip(recipe.channels[instrument].outputs, alive, strict=True) if moves]
    if not axes:
        return InstrumentCheck(instrument, sources, reason="its readings never change")
    records = [_of_axes(r, alive) for r in records]
    found = agreement(records, highest)
    gravity = np.mean(upright, axis=0)[alive] * GRAVITY_RANGE if upright else np.zeros(len(axes))
    return InstrumentCheck(
        instrument,
        sources,
        seconds := sum(len(r.measured) * r.dt_s for r in records),
        whole - seconds,
        tuple(_parameters(instrument, axes, found, 0.5 * slowest, gravity)),
        tuple(a for i, a in enumerate(axes) if _is_still(found, i, recipe.signals[a].unit)),
    )


def _of_axes(record: MotionRecord, kept: npt.NDArray[np.bool_]) -> MotionRecord:
    """Some of a record's axes."""
    names = ("measured", "implied", "arm")
    columns = {name: getattr(record, name)[:, kept] for name in names}
    return replace(record, **columns, noise=record.noise[kept], flat=record.flat[kept])


def _is_still(found: Agreement, axis: int, unit: str, *, fewest_lines: float = 5.0) -> bool:
    """True where an axis moved too little to show its scale.

    `fewest_lines`: motion at fewer frequencies is noise that looks like it.
    """
    quiet = found.moved[axis] < QUIET.get(unit, 0.0) or found.lines[axis] < fewest_lines
    return bool(quiet or 2.0 * found.scale_sd[axis] > UNKNOWN_SCALE)


def _tidy(name: str, found: Loaded, boot: int) -> RecordedSignal:
    samples = found.boots[boot]
    return resample.tidy(samples.t_ns, samples.x, quantities().signals[name].max_rate)


def _parameters(
    instrument: str,
    axes: Sequence[str],
    found: Agreement,
    half_period_s: float,
    gravity: FloatArray,
    *,
    spline_loss: float = 0.01,
) -> Iterator[Parameter]:
    """`spline_loss`: of a scale: what splines lose of motion as fast as is looked at."""
    for i, axis in enumerate(axes):
        unit = quantities().signals[axis].unit
        rows = [("bias", found.bias[i], found.bias_sd[i], 0.0, unit)]
        if abs(found.mean[i]) > found.spread[i]:
            rows.append(("offset", found.offset[i], found.offset_sd[i], 0.0, unit))
        if not _is_still(found, i, unit):
            rows.append(("scale", found.scale[i], found.scale_sd[i], 1.0, ""))
        for kind, value, sd, nominal, of in rows:
            tolerance = spline_loss if kind == "scale" else max(float(gravity[i]), QUIET.get(unit, 0.0))
            yield Parameter(instrument, axis, kind, float(value), float(sd), nominal, tolerance, of)
    if all(_is_still(found, i, quantities().signals[axis].unit) for i, axis in enumerate(axes)):
        return
    yield Parameter(instrument, "", "lag", found.lag_s, found.lag_sd, 0.0, half_period_s, "s")
    for axis, value, sd in zip(("forward", "right", "down"), found.arm, found.arm_sd, strict=False):
        yield Parameter(instrument, "", f"arm {axis}", float(value), float(sd), 0.0, 0.0, "m")


def _judge(comparisons: Sequence[InstrumentCheck], *, level: float = 0.05) -> list[InstrumentCheck]:
    """Holm over all parameters; an axis that follows another motion has no other finding.

    `level`: chance of any finding at all in a flight whose instruments agree.
    """
    chances = sorted((p.chance, i, j) for i, c in enumerate(comparisons) for j, p in enumerate(c.parameters))
    found = set()
    for rank, (chance, i, j) in enumerate(chances):
        if chance > level / (len(chances) - rank):
            break
        found.add((i, j))
    marked = [
        replace(c, parameters=tuple(replace(p, found=(i, j) in found) for j, p in enumerate(c.parameters)))
        for i, c in enumerate(comparisons)
    ]
    return [replace(c, parameters=tuple(_alone(c.parameters))) for c in marked]


def _alone(parameters: Sequence[Parameter]) -> Iterator[Parameter]:
    foreign = {p.signal for p in parameters if p.foreign}
    for p in parameters:
        follows = p.foreign or (bool(p.signal) and p.signal not in foreign) or not foreign
        yield p if follows else replace(p, found=False)
