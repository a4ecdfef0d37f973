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
    data: Dataset, transfer: ContinuousTransfer, pair: tuple[int, int], band: Band, is_open: bool
) -> Iterator[str]:
    """What is to be said beside a transfer function from an input to an output (`pair`: output, input)."""
    found = [jitter_caution(data, transfer)]
    if is_open and transfer.carries_gain(band):
        with suppress(FlysidError):  # a record that shows no step contradicts nothing
            found.append(gain_caution(transfer, step_response(data, *pair)))
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


def parting(coherent: Band | None, band: Band) -> str:
    """What ends a band beside the coherence; "" where nothing does."""
    if coherent is None or coherent == band:
        return ""
    low, high = coherent
    return (
        f" and the model follows the measurement (coherent from {low:.3g} to {high:.3g} rad/s, but beyond "
        f"the band the two part by more than {NEAR_DB:g} dB or {NEAR_DEG:g} degrees)"
    )


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
