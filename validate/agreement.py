"""Where a model follows the frequency response that was measured: only there can it be trusted."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.model.frequency.continuous_transfer import Band, ContinuousTransfer, TransferEstimate
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.polynomials import DB, ComplexArray

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
