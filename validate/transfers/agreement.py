"""Where a model follows the frequency response that was measured: only there can it be trusted, and no better
than it follows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.frequency.continuous_transfer import Band, ContinuousTransfer, TransferEstimate
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.polynomials import DB, Z95, ComplexArray
from flysid.model.step_response import StepResponse, step_response
from flysid.showing import significant
from flysid.validate.transfers.stamps import Stamps

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
    gain = (np.abs(off.real) - measured.half_width()[:, source]) * DB / NEAR_DB
    turn = np.degrees(np.abs(off.imag) - measured.phase_half_width()[:, source]) / NEAR_DEG
    far = np.nan_to_num(np.maximum(gain, turn), nan=-np.inf, neginf=-np.inf, posinf=np.inf)
    padded = np.pad(far, 1, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 3), axis=1) <= 1.0)


def misfit(
    measured: MeasuredResponse, source: int, model: ComplexArray, among: npt.NDArray[np.bool_]
) -> FloatArray:
    """(F,) how far the model (F,) is off in ln |G| and rad, as the measured response shows it.

    The mean square of what parts the two, beyond the scatter of the measured points, over an octave to both
    sides: a model of too low an order, or of a plant that is not linear, errs by that much more than its own
    parameters know. Points of the trusted band count, `among` (F,) those that are the plant's; 0 where there
    are none.
    """
    counts = measured.trusted(source, among)
    with np.errstate(all="ignore"):
        off = np.log(model / measured.response[:, source])
        excess = 0.5 * (off.real**2 + off.imag**2) - measured.error[:, source] ** 2
    known = (counts > 0.0) & np.isfinite(excess)
    x = np.log(measured.omega)
    near = (np.abs(x[:, None] - x) <= np.log(2.0)) & known
    mean = near @ np.where(known, excess, 0.0) / np.maximum(near.sum(axis=1), 1)
    return np.asarray(np.sqrt(np.maximum(mean, 0.0)))


def cautions_beside(
    data: Dataset,
    transfer: ContinuousTransfer,
    measured: MeasuredResponse | None,
    pair: tuple[int, int],
    band: Band,
    stamps: Stamps,
) -> Iterator[str]:
    """Cautions about a transfer function from an input to an output (`pair`: output, input).

    `measured`: the response that was measured in open loop; None where a loop is closed.
    """
    found = [jitter_caution(stamps.jitter_s, transfer), stamps.caution(band[1])]
    if measured is not None:
        with suppress(FlysidError):  # a record that shows no step contradicts nothing
            step = step_response(data, *pair)
            found.append(response_caution(measured, pair[1], step))
            if transfer.carries_gain(band):
                found.append(gain_caution(transfer, step))
    yield from filter(None, found)


def jitter_caution(jitter_s: float, transfer: ContinuousTransfer) -> str:
    """What the scatter of the inputs' stamps leaves of lags; "" where intervals are wider."""
    times = [transfer.dead_time, *(m.time_constant_s for m in transfer.modes)]
    known = [t.error for t in times if t is not None and t.error > 0.0]
    if not known or jitter_s <= min(known):
        return ""
    return (
        f"the stamps of the inputs scatter by +-{significant(1e3 * Z95 * jitter_s, 2)} ms (95 %). The "
        "intervals of phase and dead time hold that; lags are known no better, however narrow their intervals"
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
    turned = measured.phase_half_width()[at, source]
    gain = (np.abs(off.real) - np.hypot(own, Z95 * relative)) * DB / NEAR_DB
    turn = np.degrees(np.abs(off.imag) - np.hypot(turned, Z95 * relative)) / NEAR_DEG
    lasting = np.lib.stride_tricks.sliding_window_view(np.maximum(gain, turn), 3).min(axis=1)
    if lasting.max() <= 1.0:
        return ""
    k = int(np.argmax(lasting)) + 1
    return (
        f"two figures exclude each other: at {significant(omega[k])} rad/s the response is "
        f"{_point(seen[k], own[k])} ('flysid tf') and {_point(g[k], Z95 * relative[k])} ('flysid step'). It "
        "is not one linear response, or something else moves the output with the input: trust neither there"
    )


def in_a_loop(band: Band | None, follows: Sequence[Band]) -> str:
    """What can be trusted of a response that was measured in a closed loop, without what drives it."""
    where = " and ".join(f"{low:.3g} to {high:.3g}" for low, high in follows)
    law = "where it reacts to the output the measured response is -1/controller"
    law += f": so from {where} rad/s" if where else ""
    said = f"no band can be trusted: a loop is closed, and {law}"
    if band is not None:
        said = (
            f"a loop is closed, and {law}. Trust it from {band[0]:.3g} to {band[1]:.3g} rad/s "
            f"({band[0] / 2 / np.pi:.2g} to {band[1] / 2 / np.pi:.2g} Hz) only, where the coherence is above "
            "0.6 and the loop does not bend it"
        )
    return f"{said}. Name what drives the loop: --reference FIELD"


def _point(g: complex, width: float) -> str:
    """ "-3.1 +- 0.4 dB, -40 +- 3 degrees": a response with its half width, relative to it."""
    gain = f"{20.0 * np.log10(abs(g)):.1f} +- {significant(DB * width, 1)} dB"
    return f"{gain}, {np.degrees(np.angle(g)):.0f} +- {significant(np.degrees(width), 1)} degrees"


def transfer_figures(transfer: ContinuousTransfer, band: Band | None) -> dict[str, Any]:
    """Gain and modes with 95 % intervals, JSON types; None for what a trusted band does not carry.

    A dead time that was set, or left out, was not estimated: it has a value and no interval.
    """

    def both(estimate: TransferEstimate | None, seen: bool) -> dict[str, float | None] | None:
        if estimate is None or not seen:
            return None
        ends = estimate.interval if estimate.error > 0.0 else (np.nan, np.nan)
        values = (estimate.value, *ends)
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


def response_rows(
    measured: MeasuredResponse, source: int, phase_deg: FloatArray, model: tuple[ComplexArray, FloatArray]
) -> Iterator[tuple[str, ...]]:
    """Rows of a Bode table, intervals as half widths at 95 %.

    `phase_deg`: (F,) measured; `model`: (F,) its response, and its phase in degrees.
    """
    width = measured.half_width()[:, source]
    turn = measured.phase_half_width()[:, source]
    for k, omega in enumerate(measured.omega):
        yield (
            f"{omega:.4g}",
            f"{omega / 2 / np.pi:.3g}",
            f"{measured.gain_db[k, source]:.2f}",
            _width(DB * width[k]),
            f"{phase_deg[k]:.1f}",
            _width(np.degrees(turn[k])),
            f"{measured.coherence[k, source]:.2f}",
            f"{20 * np.log10(max(abs(model[0][k]), 1e-300)):.2f}",
            f"{model[1][k]:.1f}",
        )


def _width(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) and value < 1000 else "-"


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def measured_document(measured: MeasuredResponse, source: int) -> dict[str, Any]:
    """A measured response from one input, JSON types only."""
    width = measured.half_width()[:, source]
    turn = measured.phase_half_width()[:, source]
    return {
        "input": measured.inputs[source].name,
        "output": measured.output.name,
        "omega_rad_s": measured.omega.tolist(),
        "gain_db": measured.gain_db[:, source].tolist(),
        "gain_db_half_width": [_number(DB * w) for w in width],
        "phase_deg": measured.phase_deg[:, source].tolist(),
        "phase_deg_half_width": [_number(np.degrees(w)) for w in turn],
        "coherence": measured.coherence[:, source].tolist(),
    }
