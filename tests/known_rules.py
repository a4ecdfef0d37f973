"""The rules of a known model, whole or nearly equal, as the search for rules sees them."""

from __future__ import annotations

from bench.ts_intervals import experiment
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.growth import skip_refining
from flysid.model.rules.refit import as_problem
from flysid.model.rules.regressor_layout import runs_of
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.stages import Stage
from flysid.model.ts import TS


def context_of(truth: FittedTS) -> SearchContext:
    """One record of the model to fit and another to check."""
    layout = truth.layout
    return SearchContext(
        TS(), experiment(truth, 1), experiment(truth, 2), layout.shift, layout.scale, truth.n_init + 10
    )


def stage_of(context: SearchContext, truth: FittedTS, share: float) -> Stage:
    """The true rules, `share` of the way to being equal, unrefined."""
    theta = (1.0 - share) * truth.parameters.theta + share * truth.parameters.theta.mean(axis=0)
    runs = runs_of(truth.layout, context.fit_part.segments, context.least)
    return skip_refining(*as_problem(truth.layout, truth.parameters._replace(theta=theta), runs))
