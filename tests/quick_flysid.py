"""`python -m tests.quick_flysid`: the command line with three models that take no time to fit.

For trials of what is written and how (`tests.fault_trials`), where the models do not matter.
"""

from __future__ import annotations

from flysid.cli import main
from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.model.line import Line
from flysid.model.mean import Mean
from flysid.validate.runs import fitting


def linear(*_: object) -> dict[str, Estimator]:
    """The only candidate for the baseline."""
    return {"arx": ARX(na=2, nb=2, nk=1)}


def estimators(*_: object) -> dict[str, Estimator]:
    """All models of a run."""
    return {"mean": Mean(), **linear(), "line": Line()}


INSTEAD = {"linear_rivals": linear, "estimators": estimators, "dead_times": lambda _: ()}


if __name__ == "__main__":
    for name, instead in INSTEAD.items():
        setattr(fitting, name, instead)
    main()
