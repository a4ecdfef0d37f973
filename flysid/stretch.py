"""Stretch: consecutive samples of one flight, as far as what works on segments needs to know them."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class Stretch(Protocol):
    """Consecutive samples of a flight: (N, n_u) inputs, (N, n_y) outputs, time of the first in ns."""

    @property
    def u(self) -> FloatArray: ...
    @property
    def y(self) -> FloatArray: ...
    @property
    def t0_ns(self) -> int: ...
    @property
    def flight(self) -> str: ...
