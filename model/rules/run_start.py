"""What a free run starts from, told from measured samples: the most likely start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.likely_start import Prior, initial_states
from flysid.model.rules.regressor_layout import Layout
from flysid.model.start import full_window

_REST = 20  # rows of zeros that put hidden states to rest


@dataclass(frozen=True, eq=False)
class LikelyStart:
    """The most likely start, whose lags or hidden states training has an expectation of.

    Attributes
    ----------
    prior : what training says about starts.
    samples : measured samples that start a simulation.
    """

    prior: Prior
    samples: int

    def settled(self, dt_s: float) -> int:  # noqa: ARG002
        """Samples after which predictions may lean on a free run."""
        return self.samples

    def rest(self, layout: Layout) -> int:
        """Rows of zeros before a run from rest; as many as put hidden states to rest."""
        return _REST + self.samples if layout.hidden else layout.depth

    def write(self, layout: Layout, par: Parameters, W: FloatArray, known: int) -> None:
        """Put the start into W (N, n + n_u), of which the outputs of `known` rows are measured.

        At rest (`known` 0) hidden states are searched for, and lags are known: zeros.
        """
        d = layout.depth
        if len(W) < d or not (known or layout.hidden):
            return
        rows = max(min(known or self.rest(layout), len(W)) - layout.uncompared, 1)
        W[layout.uncompared : d, : layout.n] = initial_states(layout, [W], par, self.prior, rows)[0]

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        prior = self.prior
        return {
            "prior": {"mean": prior.mean.tolist(), "root": prior.root.tolist(), "weight": prior.weight},
            "n_init": self.samples,
        }


@dataclass(frozen=True, eq=False)
class MeasuredStart:
    """The first outputs as measured, and what is known of their error: rules over lags, as 0.1.0 wrote them.

    Attributes
    ----------
    gain : (samples n_y, samples (n_y + n_u) + 1) correction of the first rows, normalised.
    samples : measured ones that start a simulation, as many as the rules look back.
    """

    gain: FloatArray
    samples: int

    def settled(self, dt_s: float) -> int:
        """Samples after which predictions may lean on a free run."""
        return full_window(self.samples, dt_s)

    def rest(self, layout: Layout) -> int:  # noqa: ARG002
        """Rows of zeros before a run from rest."""
        return self.samples

    def write(self, layout: Layout, par: Parameters, W: FloatArray, known: int) -> None:  # noqa: ARG002
        """Put the start into W (N, n + n_u), of which the outputs of `known` rows are measured: corrected.

        At rest (`known` 0) and in a record that ends with them they stand.
        """
        d = self.samples
        if d <= known and d < len(W):
            n_y = layout.n_y
            window = np.append(W[:d].ravel(), 1.0)
            W[:d, :n_y] += (self.gain @ window).reshape(d, n_y)

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {"initial_gain": self.gain.tolist()}


RunStart = MeasuredStart | LikelyStart
