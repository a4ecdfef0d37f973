"""The name that `TS` had while it stood for rules over lags alone."""

from __future__ import annotations

import functools
import warnings
from dataclasses import dataclass

from flysid.model.ts import TS


@dataclass(frozen=True)
class BestTS(TS):
    """`TS` by its old name, which warns once.

    Parameters
    ----------
    rules, antecedents, most_rules, nk_hint, nk_least, search, flight_offsets : see `TS`.

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")
    ...     model = flysid.BestTS().fit(train)  # train: see `flysid.Dataset`; its plant is linear
    >>> len(model.rules())
    1
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        _warn()


@functools.cache
def _warn() -> None:
    warnings.warn("flysid.BestTS is flysid.TS now", FutureWarning, stacklevel=4)
