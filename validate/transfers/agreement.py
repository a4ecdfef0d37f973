"""Where a model follows the frequency response that was measured: only there can it be trusted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.dataset import JITTER, Dataset
from flysid.errors import FlysidError
from flysid.model.frequency.continuous_transfer import Band, ContinuousTransfer, TransferEstimate
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.polynomials import DB, Z95, ComplexArray
from flysid.model.step_response import StepResponse, step_response
from flysid.showing import significant

NEAR_DB, NEAR_DEG = 1.0, 7.57
"""How far a model may be from the measured response inside a band that is called trusted: what counts alike
in Tischler and Remple (2012), eq. 11.4."""


def agree(measured: MeasuredResponse, source: int, model: ComplexArray) -> npt.NDArray[np.bool_]:
    """(F,) where the model (F,) is within NEAR_DB and NEAR_DEG of the measured response, beside its interval.

    By the median of three neighbours: one point alone may be chance.
    """
    tiny = np.finfo(float).tiny
    with np.errstate(all="ignore"):
        off = np.log(np.where(model == 0.0, tiny, model) / measured.response[:, source])
    width = measured.half_width()[:, source]
    gain = (np.abs(off.real) - width) * DB / NEAR_DB
    turn = np.degrees(np.abs(off.imag) - width) / NEAR_DEG
    far = np.nan_to_num(np.maximum(gain, turn), nan=-np.inf, neginf=-np.inf, posinf=np.inf)
    padded = np.pad(far, 1, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 3), axis=1) <= 1.0)


def cautions_beside(
    data: Dataset,
    transfer: ContinuousTransfer,
    measured: MeasuredResponse | None,
    pair: tuple[int, int],
    band: Band,
) -> Iterator[str]:
    """Cautions about a transfer function from an input to an output (`pair`: output, input).

    `measured`: the response that was measured in open loop; None where a loop is closed.
    """
    found = [jitter_caution(data, transfer)]
    if measured is not None:
        with suppress(FlysidError):  # a record that shows no step contradicts nothing
            step = step_response(data, *pair)
            found.append(response_caution(measured, pair[1], step))
            if transfer.carries_gain(band):
                found.append(gain_caution(transfer, step))
    yield from filter(None, found)


def jitter_caution(data: Dataset, transfer: ContinuousTransfer) -> str:
    """What the scatter of the inputs' stamps leaves of dead time and lags; "" where intervals are wider."""
    jitter_s = max((float(s.marks.get(JITTER, 0.0)) for s in data.segments), default=0.0)
    times = [transfer.dead_time, *(m.time_constant_s for m in transfer.modes)]
    known = [t.error for t in times if t is not None and t.error > 0.0]
    if not known or jitter_s <= min(known):
        return ""
    return (
        f"the stamps of the inputs scatter by +-{significant(1e3 * Z95 * jitter_s, 2)} ms (95 %): dead "
        "times and lags are known no better than that, however narrow their intervals"
    )


def gain_caution(transfer: ContinuousTransfer, step: StepResponse) -> str:
    """That a steady gain and the end of a step response exclude each other by more than NEAR_DB; else ""."""
    final = step.figures[-1]
    low, high = transfer.gain.interval
    if final.low is None or final.high is None or not np.isfinite([low, high]).all():
        return ""
    gap = max(low - final.high, final.low - high)
    if gap <= (10.0 ** (NEAR_DB / 20.0) - 1.0) * max(abs(transfer.gain.value), abs(final.value or 0.0)):
        return ""
    ends = f"{significant(low)} to {significant(high)}"
    return (
        f"two figures exclude each other: the steady gain above is {ends}, "
        f"and a step ends at {significant(final.low)} to {significant(final.high)} ('flysid step'). The "
        "response is not one linear response, or the record is too short for one of them: trust neither"
    )


def response_caution(measured: MeasuredResponse, source: int, step: StepResponse) -> str:
    """That a measured response and a step exclude each other where both are known; else "".

    Three neighbours have to part by more than what `agree` allows: one alone may be chance. The step knows
    nothing faster than its own samples.
    """
    if not step.is_settled:
        return ""
    known = (measured.trusted(source) > 0) & (measured.omega * step.time_s[1] < 0.5)
    at = np.flatnonzero(known)
    if len(at) < 3:
        return ""
    omega = measured.omega[at]
    g, relative = step.frequency_response(omega, measured.dt_s)
    seen = measured.response[at, source]
    off = np.log(g / seen)
    own = measured.half_width()[at, source]
    width = np.hypot(own, Z95 * relative)
    gain = (np.abs(off.real) - width) * DB / NEAR_DB
    turn = np.degrees(np.abs(off.imag) - width) / NEAR_DEG
    lasting = np.lib.stride_tricks.sliding_window_view(np.maximum(gain, turn), 3).min(axis=1)
    if lasting.max() <= 1.0:
        return ""
    k = int(np.argmax(lasting)) + 1
    return (
        f"two figures exclude each other: at {significant(omega[k])} rad/s the response is "
        f"{_point(seen[k], own[k])} ('flysid tf') and {_point(g[k], Z95 * relative[k])} ('flysid step'). It "
        "is not one linear response, or something else moves the output with the input: trust neither there"
    )


def _point(g: complex, width: float) -> str:
    """ "-3.1 +- 0.4 dB, -40 +- 3 degrees": a response with its half width, relative to it."""
    gain = f"{20.0 * np.log10(abs(g)):.1f} +- {significant(DB * width, 1)} dB"
    return f"{gain}, {np.degrees(np.angle(g)):.0f} +- {significant(np.degrees(width), 1)} degrees"


def transfer_figures(transfer: ContinuousTransfer, band: Band | None) -> dict[str, Any]:
    """Gain and modes with 95 % intervals, JSON types; None for what a trusted band does not carry."""

    def both(estimate: TransferEstimate | None, seen: bool) -> dict[str, float | None] | None:
        if estimate is None or not seen:
            return None
        values = (estimate.value, *estimate.interval)
        finite = [float(v) if np.isfinite(v) else None for v in values]
        return dict(zip(("value", "low", "high"), finite, strict=True))

    modes = []
    for m in transfer.modes:
        seen = band is not None and transfer.carries_mode(m, band)
        modes.append(
            {
                "pole": [m.pole.real, m.pole.imag],
                "frequency_rad_s": both(m.frequency_rad_s, seen),
                "damping": both(m.damping, seen),
                "time_constant_s": both(m.time_constant_s, seen),
            }
        )
    return {
        "gain": both(transfer.gain, band is not None and transfer.carries_gain(band)),
        "dead_time": both(transfer.dead_time, band is not None),
        "modes": modes,
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def measured_document(measured: MeasuredResponse, source: int) -> dict[str, Any]:
    """A measured response from one input, JSON types only."""
    width = measured.half_width()[:, source]
    return {
        "input": measured.inputs[source].name,
        "output": measured.output.name,
        "omega_rad_s": measured.omega.tolist(),
        "gain_db": measured.gain_db[:, source].tolist(),
        "gain_db_half_width": [_number(DB * w) for w in width],
        "phase_deg": measured.phase_deg[:, source].tolist(),
        "phase_deg_half_width": [_number(np.degrees(w)) for w in width],
        "coherence": measured.coherence[:, source].tolist(),
    }
