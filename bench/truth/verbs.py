"""What the verbs print of a record, figure by figure, beside the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.signal import lfilter

from bench.truth.laws import Law
from bench.truth.plants import Plant
from bench.truth.records import Record
from flysid.dataset import FloatArray
from flysid.errors import FlysidError
from flysid.ingest.excitation.excitation import excitation
from flysid.ingest.excitation.share import share_explained
from flysid.model.frequency.sampling import sample
from flysid.model.polynomials import DB, Z95, ComplexArray
from flysid.model.shared import sharing
from flysid.model.step_response import step_response
from flysid.model.transfer_function import TF
from flysid.validate.transfers.identify import ChannelTransfers, identify_channel

PRINTED = 1e-3
"""Last digit of the table of responses, 0.01 dB and 0.1 degrees, as a relative error."""
NEAR_DB, NEAR_DEG = 1.5, 10.0
"""How near a model has to come inside a band that is called trusted."""
POINTS = 3
"""Points of a response that are scored per record: a few, as neighbours miss together."""

SAME = (("tf steady gain", "step final value"),)
"""Figures of two verbs that are of the same thing."""


@dataclass(frozen=True)
class Score:
    """One printed figure: its interval (none where it is refused) and the truth (none where it has none)."""

    figure: str
    true: float | None
    low: float | None
    high: float | None

    @property
    def held(self) -> bool:
        """The interval, as printed (three digits), holds the truth to those digits."""
        if self.true is None or self.low is None or self.high is None:
            return False
        low, true, high = (float(f"{x:.3g}") for x in (self.low, self.true, self.high))
        return low <= true <= high

    def to_dict(self) -> dict[str, str | float | None]:
        """JSON types only."""
        return asdict(self)


@sharing()
def scores(record: Record) -> list[Score]:
    """Of every verb that answers within seconds; a verb that refuses the record gives one refusal."""
    found: list[Score] = []
    at = record.reference
    names = ("r",) if at else ()
    try:
        channel = identify_channel("x", record.data, TF(reference=names), at)
        found += [*_transfer(record, channel), *_claim_of_a_loop(record, channel)]
        if record.approximation is None:
            found += [*_command(record, channel), *_loop(record, channel)]
    except FlysidError:
        found.append(Score("tf", 0.0, None, None))
    if record.controller is None and record.approximation is None:
        found += [*_step(record), *score_excitation(record)]
        found += _agreement(found)
    return found


def _agreement(found: Sequence[Score]) -> Iterator[Score]:
    """Where two verbs state the same: whether their intervals meet."""
    by_name = {s.figure: s for s in found}
    for one, other in SAME:
        a, b = by_name.get(one), by_name.get(other)
        if a is None or b is None or a.low is None or a.high is None or b.low is None or b.high is None:
            continue
        meet = float(a.low <= b.high and b.low <= a.high)
        yield Score(f"{one} meets {other}", 1.0, meet, meet)


def score_excitation(record: Record) -> Iterator[Score]:
    """The share of the output's power that follows the input, of a record of one segment."""
    if len(record.data.segments) > 1:
        return
    (segment,) = record.data.segments
    moves = excitation(record.data)
    a, (b,) = sample(record.plant.transfer, record.data.dt_s, "zero")
    clean = np.asarray(lfilter(b, a, segment.u[:, 0]))
    hz = np.fft.rfftfreq(len(segment), record.data.dt_s)
    used = (hz > 0.0) & (hz <= moves.band_hz)
    answer, rest = (
        float(np.sum(np.abs(np.fft.rfft(x - x.mean())[used]) ** 2)) for x in (clean, segment.y[:, 0] - clean)
    )
    share = share_explained(record.data, moves)
    yield Score("share of power", answer / (answer + rest), share.low, share.high)


def _transfer(record: Record, channel: ChannelTransfers) -> Iterator[Score]:
    """Measured and modelled response where the verb says to trust it; gain and dead time."""
    measured = channel.measured[0]
    band = channel.band(0, 0)
    yield Score("tf band", 1.0, *((1.0, 1.0) if band else (None, None)))
    if measured is None or band is None:
        return
    within = (measured.omega >= band[0]) & (measured.omega <= band[1])
    inside = np.flatnonzero(within & np.isfinite(record.response(measured.omega)))
    rng = np.random.default_rng(record.seed)
    picked = np.sort(rng.choice(inside, min(POINTS, len(inside)), replace=False))
    omega = measured.omega[picked]
    true = np.log(record.response(omega))
    half = np.maximum(measured.half_width()[picked, 0], PRINTED)
    turn = np.maximum(measured.phase_half_width()[picked, 0], PRINTED)
    seen = np.log(measured.response[picked, 0]) - true
    g, db, deg = channel.response(0, 0, omega)
    model = np.log(g) - true
    for k in range(len(picked)):
        turned = float(np.angle(np.exp(1j * seen[k].imag)))
        yield Score("tf measured gain", 0.0, seen[k].real - half[k], seen[k].real + half[k])
        yield Score("tf measured phase", 0.0, turned - turn[k], turned + turn[k])
        own = max(db[k] / DB, PRINTED)
        yield Score("tf model gain", 0.0, model[k].real - own, model[k].real + own)
        turned = float(np.angle(np.exp(1j * model[k].imag)))
        own = max(np.radians(deg[k]), PRINTED)
        yield Score("tf model phase", 0.0, turned - own, turned + own)
        near = float(DB * abs(model[k].real) < NEAR_DB and np.degrees(abs(turned)) < NEAR_DEG)
        yield Score("tf model near", 1.0, near, near)
    if record.approximation is not None:
        return
    transfer = channel.model.transfer()
    gain = transfer.gain
    known = np.isfinite(gain.value) and not Z95 * gain.error > abs(gain.value)
    printed = known and transfer.carries_gain(band)
    yield Score("tf steady gain", record.plant.gain, *(gain.interval if printed else (None, None)))


def _claim_of_a_loop(record: Record, channel: ChannelTransfers) -> Iterator[Score]:
    """The sentence that a loop is closed: false of a record in open loop, right where a pilot closes it."""
    if record.reference:
        return
    seen = (1.0, 1.0) if channel.is_looped(0) else (None, None)
    yield Score("tf a loop is closed", None if record.controller is None else 1.0, *seen)


def _command(record: Record, channel: ChannelTransfers) -> Iterator[Score]:
    true = command_truth(record.plant, record.data.dt_s)
    for figure in channel.figures.get("command", ()):
        yield Score(f"tf {figure.name}", true.get(figure.name), figure.low, figure.high)


def _loop(record: Record, channel: ChannelTransfers) -> Iterator[Score]:
    true = loop_truth(record.plant, record.controller, record.data.dt_s) if record.controller else {}
    for figure in channel.figures.get("loop", ()):
        yield Score(f"tf loop {figure.name}", true.get(figure.name), figure.low, figure.high)


def command_truth(plant: Plant, dt_s: float) -> dict[str, float]:
    """Bandwidth below the steady gain, peak above it, and those of handling qualities."""
    omega = plant.grid(dt_s)
    g = plant.response(omega, dt_s)
    level = np.log(np.abs(g))
    phase = _from_sign(g)
    found: dict[str, float] = {}
    if plant.gain is not None:
        above = level - np.log(abs(plant.gain))
        found |= _last(omega, above + np.log(2.0) / 2.0, "bandwidth_rads")
        found["peak_db"] = DB * float(max(above.max(), 0.0))
    found |= _first(omega, phase + 0.75 * np.pi, "bandwidth_phase_rads")
    turned = np.flatnonzero(phase < -np.pi)
    if len(turned):
        at = turned[0]
        six = level - level[at] - np.log(10.0) * 6.0 / 20.0
        found |= _last(omega[:at], six[:at], "bandwidth_gain_rads")
        twice = int(np.searchsorted(omega, 2.0 * omega[at]))
        if twice < len(omega):
            found["phase_delay_ms"] = 1e3 * float((-np.pi - phase[twice]) / (2.0 * omega[at]))
    return found


def loop_truth(plant: Plant, controller: Law, dt_s: float) -> dict[str, float]:
    """Crossover, margins, peak of S, bandwidth of disturbance rejection of the loop cut open."""
    omega = plant.grid(dt_s)
    loop = controller.response(omega, dt_s) * plant.response(omega, dt_s) * np.exp(-1j * omega * dt_s)
    level = np.log(np.abs(loop))
    phase = np.unwrap(np.angle(loop))
    phase -= 2.0 * np.pi * np.round(phase[0] / 2.0 / np.pi)
    found: dict[str, float] = {}
    down = np.flatnonzero((level[:-1] > 0.0) & (level[1:] <= 0.0))
    if len(down):
        found["crossover_rads"] = float(omega[down[-1]])
        found["phase_margin_deg"] = 180.0 + float(np.degrees(phase[down[-1]]))
    turned = np.flatnonzero(phase < -np.pi)
    if len(turned):
        found["gain_margin_db"] = -DB * float(level[turned[0]])
    s = 20.0 * np.log10(np.abs(1.0 / (1.0 + loop)))
    found["sensitivity_peak_db"] = float(s.max())
    return found | _first(omega, -3.0102999566 - s, "disturbance_rejection_bandwidth_rads")


def _from_sign(g: ComplexArray) -> FloatArray:
    """Phase without jumps that starts between -270 and 90 degrees."""
    phase = np.unwrap(np.angle(g))
    return np.asarray(phase - 2.0 * np.pi * np.ceil((phase[0] - np.pi / 2) / (2.0 * np.pi) - 1e-9))


def _first(omega: FloatArray, falling: FloatArray, name: str) -> dict[str, float]:
    down = np.flatnonzero((falling[:-1] > 0.0) & (falling[1:] <= 0.0))
    return {name: float(omega[down[0]])} if len(down) else {}


def _last(omega: FloatArray, falling: FloatArray, name: str) -> dict[str, float]:
    down = np.flatnonzero((falling[:-1] > 0.0) & (falling[1:] <= 0.0))
    return {name: float(omega[down[-1]])} if len(down) else {}


def _step(record: Record) -> Iterator[Score]:
    plant = record.plant
    true = step_truth(plant, record.data.dt_s)
    names = ("latency", "rise", "overshoot", "settling", "final value")
    try:
        found = step_response(record.data, 0, 0)  # as `tf` asked for it
    except FlysidError:
        yield from (Score(f"step {name}", true.get(name), None, None) for name in names)
        return
    yield from (Score(f"step {f.name}", true.get(f.name), f.low, f.high) for f in found.figures)
    if not found.is_settled:
        return
    rng = np.random.default_rng(record.seed)
    low, high = found.interval
    count = round(found.length_s / record.data.dt_s) + 2
    right = np.interp(found.time_s, record.data.dt_s * np.arange(count), plant.step(record.data.dt_s, count))
    for k in rng.choice(np.arange(1, len(found.time_s)), POINTS, replace=False):
        yield Score("step point", float(right[k]), float(low[k]), float(high[k]))


def step_truth(plant: Plant, dt_s: float, *, finer: int = 20) -> dict[str, float]:
    """Figures of an endless step; none of what integrates."""
    if plant.gain is None:
        return {}
    slowest = float(np.min(-np.roots(plant.transfer.denominator).real))
    count = round((20.0 / slowest + 5.0 * float(plant.transfer.dead_time_s[0])) / dt_s * finer)
    curve = plant.step(dt_s / finer, count) / plant.gain
    time_s = dt_s / finer * np.arange(count)
    ten, ninety = (1e3 * float(time_s[np.argmax(curve >= share)]) for share in (0.1, 0.9))
    outside = np.flatnonzero(np.abs(curve - 1.0) > 0.05)
    return {
        "latency": ten,
        "rise": ninety - ten,
        "overshoot": 100.0 * max(float(curve.max()) - 1.0, 0.0),
        "settling": float(time_s[outside[-1]]),
        "final value": plant.gain,
    }
