"""What a free run starts from, told from measured samples: the one way in which models of rules differ.

Rules over lags start from the first outputs, corrected for their noise (`MeasuredStart`). Hidden states are
not measured: the most likely state is searched for (`LikelyStart`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.noise import output_error_ahead
from flysid.model.rules.kernel import Parameters, predict
from flysid.model.rules.realisation import Prior, initial_states
from flysid.model.rules.recursion import unheld
from flysid.model.rules.regressor_layout import Layout
from flysid.model.start import estimate_start

_REST = 20  # rows of zeros that put hidden states to rest


class Running(Protocol):
    """What a start asks of the model that it is of."""

    @property
    def layout(self) -> Layout: ...
    @property
    def parameters(self) -> Parameters: ...
    @property
    def noise(self) -> FloatArray | None: ...
    @property
    def n_init(self) -> int: ...
    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray: ...
    def run(self, u: FloatArray, y0: FloatArray) -> FloatArray: ...
    def outputs_of(self, W: FloatArray) -> FloatArray: ...


@dataclass(frozen=True, eq=False)
class MeasuredStart:
    """The first outputs as measured, and what is known of their error.

    Attributes
    ----------
    gain : (samples n_y, samples (n_y + n_u) + 1) correction, see `judging.initial_state_gain`.
    samples : measured ones that start a simulation, as many as the rules look back.
    structure : what model files call a model that starts so.
    """

    gain: FloatArray
    samples: int
    structure: ClassVar[str] = "ts"

    @property
    def rest(self) -> int:
        """Rows of zeros before a run from rest."""
        return self.samples

    def write(self, model: Running, W: FloatArray, known: int) -> None:
        """Put the start into W (N, n + n_u), of which the outputs of `known` rows are measured: corrected.

        At rest (`known` 0) and in a record that ends with them they stand.
        """
        d = self.samples
        if d <= known and d < len(W):
            n_y = model.layout.n_y
            window = np.append(W[:d].ravel(), 1.0)
            W[:d, :n_y] += (self.gain @ window).reshape(d, n_y)

    def free(self, model: Running) -> Parameters:
        """The parameters of a free run: one stable rule is cut off at the limits afterwards."""
        return unheld(model.layout.lags, model.parameters)

    def followed(self, model: Running, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n_y) free run from the start that suits the first outputs y (M, n_y) best."""
        return model.simulate(u, estimate_start(model, u[: len(y)], y))

    def soon(self, model: Running, u: FloatArray, y: FloatArray, k: int) -> FloatArray:
        """(N, n_y) predictions k steps ahead from lags as measured; NaN where there is none yet."""
        layout = model.layout
        return layout.outputs_of(predict(layout.stack(u, y), layout.depth, k, layout.lags, model.parameters))

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {"initial_gain": self.gain.tolist()}


@dataclass(frozen=True, eq=False)
class LikelyStart:
    """The most likely state before the first computed row.

    Attributes
    ----------
    prior : what training says about states.
    samples : measured samples that start a simulation.
    """

    prior: Prior
    samples: int
    structure: ClassVar[str] = "ts_ss"

    @property
    def rest(self) -> int:
        """As many as put hidden states to rest."""
        return _REST + self.samples

    def write(self, model: Running, W: FloatArray, known: int) -> None:
        """Search for the state, from zeros where nothing is measured."""
        layout = model.layout
        d = layout.depth
        if len(W) >= d:
            rows = max(min(known or self.rest, len(W)) - d + 1, 1)
            W[d - 1, : layout.n] = initial_states(layout, [W], model.parameters, self.prior, rows)[0, 0]

    def free(self, model: Running) -> Parameters:
        """Limits hold: they may be ends of travel."""
        return model.parameters

    def followed(self, model: Running, u: FloatArray, y: FloatArray) -> FloatArray:
        """From the most likely state given all these outputs."""
        return model.outputs_of(model.run(u, y))

    def soon(self, model: Running, u: FloatArray, y: FloatArray, k: int) -> FloatArray:
        """The free run, and what the noise model foresees of its error."""
        ahead = np.full(y.shape, np.nan)
        begin = self.samples + k - 1
        if begin < len(y):
            free = self.followed(model, u, y[: self.samples])
            foreseen = free if model.noise is None else output_error_ahead(free, y, model.noise, k)
            ahead[begin:] = foreseen[begin:]
        return ahead

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        prior = self.prior
        return {
            "prior": {
                "mean": prior.mean.tolist(),
                "inverse": prior.inverse.tolist(),
                "weight": prior.weight,
            },
            "n_init": self.samples,
        }


RunStart = MeasuredStart | LikelyStart
