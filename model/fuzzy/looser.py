"""Rules let go: a chosen model refined once more with less weight on its rules being alike.

Growth holds rules together, which keeps its steps sane, and every stage keeps the hold that it grew with.
That hold is a share of the mean square error, so it weighs as much as a share of the samples: where these are
thousands it binds rules more than anything that is known of the plant. What is grown needs it no longer.
"""

from __future__ import annotations

import numpy as np

from flysid.model.fuzzy.choice import Candidate
from flysid.model.fuzzy.grow import refine, with_ridge
from flysid.model.fuzzy.workshop import Workshop

_RIDGES = (1e-3, 1e-4)  # of the mean square error: a tenth, a hundredth of what growth asks for
_GAIN = 5e-4  # of the validation mean square: less than this is no reason to let go


def let_go(workshop: Workshop, chosen: Candidate) -> Candidate:
    """The model with its rules held together less, as long as its validation free run gets better.

    It is judged on the held-out part that its stage has not seen, not on those of other folds.
    """
    if chosen.stage.rules == 1:
        return chosen
    held = best = workshop.judge(chosen.stage)
    for share in _RIDGES:
        stage = refine(with_ridge(best.stage, share * held.stage.cost), workshop.settings.iterations, 1e-6)
        if not np.isfinite(stage.cost):
            break
        freed = workshop.judge(stage)
        if freed.mean >= (1.0 - _GAIN) * best.mean or freed.stable < held.stable:
            break
        best = freed
    return chosen if best is held else best
