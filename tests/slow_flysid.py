"""`python -m tests.slow_flysid`: the command line with linear models at once and a `ts` that takes a minute.

For trials of interrupts. The models are replaced on import, in workers too. The interrupt is heard even where
the tests run behind a shell's `&`, which makes all that they start deaf to it.
"""

from __future__ import annotations

import signal
import time
from dataclasses import dataclass

from flysid.cli import main
from flysid.dataset import Dataset
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.validate.runs import fitting
from tests import quick_flysid


@dataclass(frozen=True)
class Slow:
    """ARX, after a minute."""

    def fit(self, train: Dataset, validation: Dataset | None = None) -> Fitted:
        time.sleep(60.0)
        return ARX(na=2, nb=2, nk=1).fit(train, validation)


def estimators(*_: object) -> dict[str, Estimator]:
    """Quick models and a slow one."""
    return quick_flysid.estimators() | {"ts": Slow()}


setattr(fitting, "linear_rivals", quick_flysid.linear)  # noqa: B010 - mypy
setattr(fitting, "estimators", estimators)  # noqa: B010
setattr(fitting, "dead_times", lambda _: ())  # noqa: B010

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    main()
