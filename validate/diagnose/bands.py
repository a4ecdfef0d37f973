"""Where the parameters' uncertainty lets a model's frequency response and free run lie: pointwise 95 % bands.

They come from the training data and speak of noise alone; what a structure cannot express is not in them.
All are to first order: a draw of a slow rule's numbers may well be unstable and says nothing of the model.
Linear models have theirs from their parameters' covariance; of the responses of rules, draws of small steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.errors import FlysidError
from flysid.model.base import Fitted
from flysid.model.capabilities import FrequencyResponse, LinearModel
from flysid.model.polynomials import Z95, ComplexArray
from flysid.model.start import estimate_start, own_part, without
from flysid.validate.diagnose.responses import responses

if TYPE_CHECKING:
    from flysid.model.rules.rule_uncertainty import Uncertainty

DRAWS = 100
STEP = 0.01


@dataclass(frozen=True, eq=False)
class ResponseBand:
    """Of one rule: (F,) limits of the gain, and of the phase's turn from the nominal one, rad."""

    low: FloatArray
    high: FloatArray
    turn_low: FloatArray
    turn_high: FloatArray


@dataclass(frozen=True, eq=False)
class BandCurve:
    """(F,) response of one rule, and its band where the model offers one."""

    response: ComplexArray
    band: ResponseBand | None = None


def curves(
    model: Fitted, hz: FloatArray, place: tuple[int, int], sure: Uncertainty | None = None
) -> list[BandCurve]:
    """Response of every rule with its band; `place`: (output, input); `sure`: of a fuzzy one."""
    nominal = responses(model, hz, *place)
    bands: Sequence[ResponseBand | None] = [None] * len(nominal)
    if sure is not None:
        bands = _drawn_bands(nominal, sure, hz, place)
    elif (known := _first_order(model, hz)) is not None:
        bands = [_linear_band(known, place)]
    return [BandCurve(r, b) for r, b in zip(nominal, bands, strict=True)]


def _first_order(model: Fitted, hz: FloatArray) -> FrequencyResponse | None:
    """That of a linear model that knows its errors."""
    if not isinstance(model, LinearModel):
        return None
    try:
        with np.errstate(all="ignore"):  # a pole on the unit circle
            found = model.frequency_response(2.0 * np.pi * hz)
    except (FlysidError, np.linalg.LinAlgError):
        return None
    return found if np.isfinite(found.magnitude_error).any() else None


def _linear_band(r: FrequencyResponse, place: tuple[int, int]) -> ResponseBand:
    gain = np.abs(r.response[:, *place])
    reach = Z95 * r.magnitude_error[:, *place]
    turn = Z95 * r.phase_error[:, *place]
    return ResponseBand(np.maximum(gain - reach, 0.0), gain + reach, -turn, turn)


def _nearby(sure: Uncertainty) -> list[Fitted]:
    """Models whose numbers are `STEP` of a standard deviation away, in random directions."""
    return list(replace(sure, covariance=STEP**2 * sure.covariance).draws(DRAWS))


def _half_width(drawn: FloatArray) -> FloatArray:
    """1.96 standard deviations of what `drawn` (DRAWS, ...) deviates, for whole steps."""
    half: FloatArray = Z95 / STEP * np.sqrt(np.mean(drawn**2, axis=0))
    return half


def _drawn_bands(
    nominal: Sequence[ComplexArray], sure: Uncertainty, hz: FloatArray, place: tuple[int, int]
) -> list[ResponseBand | None]:
    """One band per rule; none where a draw has no response."""
    drawn = np.array([responses(m, hz, *place) for m in _nearby(sure)])
    found: list[ResponseBand | None] = []
    for r, own in enumerate(nominal):
        gain = np.abs(own)
        if not np.isfinite(drawn[:, r]).all() or not (gain > 0.0).all():
            found.append(None)
            continue
        reach = _half_width(np.abs(drawn[:, r]) - gain)
        turn = _half_width(np.angle(drawn[:, r] / own))
        found.append(ResponseBand(np.maximum(gain - reach, 0.0), gain + reach, -turn, turn))
    return found


def free_run_band(
    model: Fitted,
    segment: Segment,
    start: int,
    sure: Uncertainty | None = None,
    drifting: tuple[bool, ...] | None = None,
) -> tuple[FloatArray, FloatArray] | None:
    """(lower, upper), (N - start, n_y) each, of the free run that scores are made of; None where not known.

    Its first `start` samples give the starting state. With `drifting`, the segment has a constant or a drift
    of its own beside the model. Both as in `flysid.validate.compare.trials`.
    """
    own = own_part(model, segment, start, drifting)
    segment = without(segment, own)
    try:
        if sure is not None:
            low, high = sure.band_from_measured(segment.u, segment.y[:start])
        elif isinstance(model, LinearModel):
            y0 = estimate_start(model, segment.u[:start], segment.y[:start])
            low, high = model.simulation_band(segment.u, y0, draws=DRAWS)
        else:
            return None
    except (FlysidError, np.linalg.LinAlgError):
        return None
    return (low + own)[start:], (high + own)[start:]
