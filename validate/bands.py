"""Where the parameters' uncertainty lets a model's frequency response and free run lie: pointwise 95 % bands.

They come from the training data and speak of noise alone; what a structure cannot express is not in them.
Linear models have theirs from their parameters' covariance, to first order; TS from draws of its numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.errors import FlysidError
from flysid.model.base import Fitted
from flysid.model.linear.model import FittedLinear
from flysid.model.linear.uncertainty import FrequencyResponse
from flysid.model.start import estimate_start
from flysid.validate.responses import ComplexArray, responses

DRAWS = 100
LEVEL = (2.5, 97.5)
Z95 = 1.959963984540054


class Drawn(Protocol):
    """What a fuzzy model's fit tells of its numbers, rules over lags or over states."""

    def draws(self, count: int = ..., seed: int = ...) -> Sequence[Fitted]:
        """Models whose numbers are drawn from their distribution; the same ones for the same seed."""
        ...

    def simulation_band(self, u: FloatArray, y0: FloatArray | None = ...) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), (N, n_y) each, of the free run."""
        ...


@dataclass(frozen=True, eq=False)
class ResponseBand:
    """Of one rule: (F,) limits of the gain, and of the phase's turn from the nominal one, rad."""

    low: FloatArray
    high: FloatArray
    turn_low: FloatArray
    turn_high: FloatArray


@dataclass(frozen=True, eq=False)
class Curve:
    """(F,) response of one rule, and its band where the model offers one."""

    response: ComplexArray
    band: ResponseBand | None = None


def curves(model: Fitted, hz: FloatArray, place: tuple[int, int], sure: Drawn | None = None) -> list[Curve]:
    """Response of every rule with its band; `place`: (output, input); `sure`: what a TS model's fit tells."""
    from flysid.model.fuzzy.model import FittedTS

    nominal = responses(model, hz, *place)
    bands: Sequence[ResponseBand | None] = [None] * len(nominal)
    if sure is not None and isinstance(model, FittedTS):  # draws of hidden states are wild
        bands = _drawn_bands(nominal, sure, hz, place)
    elif (known := _first_order(model, hz)) is not None:
        bands = [_linear_band(known, place)]
    return [Curve(r, b) for r, b in zip(nominal, bands, strict=True)]


def _first_order(model: Fitted, hz: FloatArray) -> FrequencyResponse | None:
    from flysid.model.linear import uncertainty
    from flysid.model.subspace import bands
    from flysid.model.subspace.model import FittedStateSpace

    omega = 2.0 * np.pi * hz
    try:
        with np.errstate(all="ignore"):  # a pole on the unit circle
            if isinstance(model, FittedLinear) and model.free and np.isfinite(model.covariance).all():
                return uncertainty.frequency_response(model, omega)
            if isinstance(model, FittedStateSpace) and len(model.covariance):
                return bands.frequency_response(model, omega)
    except (FlysidError, np.linalg.LinAlgError):
        return None
    return None


def _linear_band(r: FrequencyResponse, place: tuple[int, int]) -> ResponseBand:
    gain = np.abs(r.response[:, *place])
    reach, turn = Z95 * r.magnitude_error[:, *place], Z95 * r.phase_error[:, *place]
    return ResponseBand(np.maximum(gain - reach, 0.0), gain + reach, -turn, turn)


def _drawn_bands(
    nominal: Sequence[ComplexArray], sure: Drawn, hz: FloatArray, place: tuple[int, int]
) -> list[ResponseBand | None]:
    """One band per rule; none where a draw has no response."""
    drawn = np.array([responses(m, hz, *place) for m in sure.draws(DRAWS)])
    found: list[ResponseBand | None] = []
    for r, own in enumerate(nominal):
        if not np.isfinite(drawn[:, r]).all() or not np.isfinite(own).all():
            found.append(None)
            continue
        low, high = np.percentile(np.abs(drawn[:, r]), LEVEL, axis=0)
        back, forth = np.percentile(np.angle(drawn[:, r] / np.where(own == 0.0, 1.0, own)), LEVEL, axis=0)
        found.append(ResponseBand(low, high, back, forth))
    return found


def free_run_band(
    model: Fitted, segment: Segment, start: int, sure: Drawn | None = None
) -> tuple[FloatArray, FloatArray] | None:
    """(lower, upper), (N - start, n_y) each, of the free run that scores are made of; None where not known.

    Its first `start` samples give the starting state, as in `flysid.validate.trials`.
    """
    from flysid.model.linear import uncertainty
    from flysid.model.subspace import bands
    from flysid.model.subspace.model import FittedStateSpace

    try:
        y0 = estimate_start(model, segment.u[:start], segment.y[:start])
        if sure is not None:
            low, high = sure.simulation_band(segment.u, y0)
        elif isinstance(model, FittedLinear):
            low, high = uncertainty.simulation_band(model, segment.u, y0, draws=DRAWS)
        elif isinstance(model, FittedStateSpace):
            low, high = bands.simulation_band(model, segment.u, y0, draws=DRAWS)
        else:
            return None
    except (FlysidError, np.linalg.LinAlgError):
        return None
    return low[start:], high[start:]
