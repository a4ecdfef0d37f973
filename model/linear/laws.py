"""What every linear model does alike, however it is parametrised."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.arguments import as_record
from flysid.model.base import Rule
from flysid.model.capabilities import LinearModel
from flysid.model.freerun import saturate
from flysid.model.linear.uncertainty import draw_steps, free_run_band
from flysid.model.start import OneRule


class _Parametrised(LinearModel, Protocol):
    """What a linear model has of its own."""

    def _ahead(self, u: FloatArray, y: FloatArray, k: int) -> FloatArray: ...
    def _conclusion(self) -> str: ...
    def _known_covariance(self) -> FloatArray: ...
    def _move(self, step: FloatArray) -> LinearModel: ...


class LinearLaws(OneRule):
    """The laws of a linear model, from what its parametrisation predicts and how sure its numbers are."""

    def predict(self: _Parametrised, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) prediction from outputs at least k steps old; the first n_init + k - 1 rows are NaN.

        Raises
        ------
        UsageError : shapes do not fit, or k < 1.
        """
        u, y = as_record(self, u, y, k)
        first = self.n_init + k - 1
        out = np.full(y.shape, np.nan)
        if len(y) > first:
            found = self._ahead(u, y, k)[first:]
            is_finite = np.isfinite(found)
            if not is_finite.all():  # a forged model, or one far outside its data
                found = np.where(is_finite, found, saturate(found, self.output_limits))
            out[first:] = found
        return out

    def rules(self: _Parametrised) -> tuple[Rule, ...]:
        """One rule that always holds."""
        radius = float(np.abs(self.poles).max(initial=0.0))
        slow = -self.dt_s / np.log(radius) if 0 < radius < 1 else (0.0 if radius == 0 else np.inf)
        return (Rule("R1", "always", self._conclusion(), self.dc_gain, float(slow), radius, 1.0),)

    @property
    def is_stable(self: LinearModel) -> bool:
        """Every pole lies inside the unit circle."""
        return bool(np.abs(self.poles).max(initial=0.0) < 1.0)

    def simulation_band(
        self: _Parametrised, u: FloatArray, y0: FloatArray | None = None, *, draws: int = 200, seed: int = 0
    ) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), (N, n_y) each: pointwise 95 % band of the free run, the parameters being unsure.

        To first order in the parameters, which are drawn from their normal distribution.

        Raises
        ------
        UsageError : the model carries no covariance.
        """
        return free_run_band(self, self._move, self._known_covariance(), draws, seed, u=u, y0=y0)

    def draws(self: _Parametrised, count: int = 200, seed: int = 0) -> list[LinearModel]:
        """Models whose numbers are drawn from their normal distribution; some may be unstable.

        Raises
        ------
        UsageError : the model carries no covariance.
        """
        return [self._move(step) for step in draw_steps(self._known_covariance(), count, seed)]
