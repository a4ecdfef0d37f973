"""Where the measured response of a closed loop is not the plant's but that of its controller, -1 / C.

Long regressions both ways (of the output on past inputs, of the input on the present and past output, each
with its own past; Ljung, 1999, 13.4: the direct method with a rich model of the noise) tell plant and
controller apart roughly, without a reference. A measured response is a mixture of both, by what moved the
input: near -1 / C it is the controller's; where it is not near the plant it is not the plant's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset, FloatArray
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.linear.iv_stages import LONG_ORDER
from flysid.model.polynomials import ComplexArray


@dataclass(frozen=True, eq=False)
class LoopView:
    """Whose the measured response of a single input is, where a loop may be closed.

    `plants`: (F,) it is the plant's, as far as the regressions tell.
    `controllers`: (F,) it is -1 / controller, and nearer to that than to the plant; never both.
    `beyond_doubt`: (F,) that, and not near the plant: without noise, open loops are near both.
    """

    plants: npt.NDArray[np.bool_]
    controllers: npt.NDArray[np.bool_]
    beyond_doubt: npt.NDArray[np.bool_]

    def follows(self, measured: MeasuredResponse) -> list[tuple[float, float]]:
        """Bands (rad/s) in which the response is the controller's."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.controllers.astype(np.int8), [0]])))
        pairs = zip(edges[::2], edges[1::2], strict=True)
        runs = [(float(measured.omega[a]), float(measured.omega[b - 1])) for a, b in pairs]
        return [(low, high) for low, high in runs if low < high]

    def seen(self, measured: MeasuredResponse) -> bool:
        """Where the coherence counts, some of the response is the controller's beyond doubt."""
        return bool((self.beyond_doubt & (measured.trusted() > 0)).any())


def view_loop(
    data: Dataset, output: int, measured: MeasuredResponse, *, near: float = 0.5
) -> LoopView | None:
    """Whose the response is, by frequency; None of several inputs, or where segments are too short to tell.

    `near`: in ln: 4.3 dB, or 29 degrees.

    >>> measured = measure_response(data)  # doctest: +SKIP
    >>> view_loop(data, 0, measured).follows(measured)  # doctest: +SKIP
    [(0.6, 3.3), (80.8, 1005.3)]
    """
    if len(data.inputs) != 1:
        return None
    pairs = [np.column_stack([s.u[:, 0], s.y[:, output]]) for s in data.segments if len(s) > 6 * LONG_ORDER]
    if not pairs:
        return None
    mean = np.concatenate(pairs).mean(axis=0)
    scale = np.concatenate(pairs).std(axis=0)
    scaled = [(p - mean) / scale for p in pairs]
    back = np.exp(-1j * measured.omega * data.dt_s)[:, None] ** np.arange(LONG_ORDER + 1)
    unit = scale[1] / scale[0]
    plant = _response(scaled, (1, 0), 1, back) * unit
    law = _response(scaled, (0, 1), 0, back) / unit  # what the input makes of the output: -C
    seen = measured.response[:, 0]
    to_law = np.abs(np.log(seen * law))
    to_plant = np.abs(np.log(seen / plant))
    controllers = (to_law < near) & (to_law < to_plant)
    close = to_plant < near
    return LoopView(close & ~controllers, controllers, controllers & ~close)


def _response(
    pairs: list[FloatArray], roles: tuple[int, int], first_lag: int, back: ComplexArray
) -> ComplexArray:
    """(F,) of driven over driving; `roles` are their columns, `first_lag` the driving one's first."""
    driven, driving = roles
    rows = []
    goals = []
    for pair in pairs:
        n = len(pair)
        own = [pair[LONG_ORDER - k : n - k, driven] for k in range(1, LONG_ORDER + 1)]
        other = [pair[LONG_ORDER - k : n - k, driving] for k in range(first_lag, LONG_ORDER + 1)]
        rows.append(np.stack(own + other, axis=1))
        goals.append(pair[LONG_ORDER:, driven])
    matrix = np.concatenate(rows)
    theta = np.linalg.lstsq(matrix.T @ matrix, matrix.T @ np.concatenate(goals), rcond=1e-12)[0]
    bottom = 1.0 - back[:, 1:] @ theta[:LONG_ORDER]
    return np.asarray(back[:, first_lag:] @ theta[LONG_ORDER:] / bottom)
