"""Where the measured response of a closed loop is not the plant's but that of its controller, -1 / C.

Long regressions both ways (of the output on past inputs, of the input on the present and past output, each
with its own past; Ljung, 1999, 13.4: the direct method with a rich model of the noise) tell plant and
controller apart roughly, without a reference. A response that lies nearer to -1 / C than to the plant follows
the controller.
"""

from __future__ import annotations

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.polynomials import ComplexArray

ORDER = 20


def controller_bands(
    data: Dataset, output: int, measured: MeasuredResponse, *, near: float = 0.5
) -> list[tuple[float, float]]:
    """Bands (rad/s) in which the response of a single input follows -1 / controller; none where segments are
    too short to tell.

    `near`: in ln: 4.3 dB, or 29 degrees.

    Example
    -------
    >>> controller_bands(data, 0, measure_response(data))  # doctest: +SKIP
    [(0.6, 3.3), (80.8, 1005.3)]
    """
    if len(data.inputs) != 1:
        return []
    pairs = [np.column_stack([s.u[:, 0], s.y[:, output]]) for s in data.segments if len(s) > 6 * ORDER]
    if not pairs:
        return []
    mean = np.concatenate(pairs).mean(axis=0)
    scale = np.concatenate(pairs).std(axis=0)
    scaled = [(p - mean) / scale for p in pairs]
    back = np.exp(-1j * measured.omega * data.dt_s)[:, None] ** np.arange(ORDER + 1)
    unit = scale[1] / scale[0]
    plant = _response(scaled, (1, 0), 1, back) * unit
    law = _response(scaled, (0, 1), 0, back) / unit  # what the input makes of the output: -C
    seen = measured.response[:, 0]
    to_law = np.abs(np.log(seen * law))
    follows = (to_law < near) & (to_law < np.abs(np.log(seen / plant)))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], follows.astype(np.int8), [0]])))
    runs = [(measured.omega[a], measured.omega[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(float(low), float(high)) for low, high in runs if low < high]


def _response(
    pairs: list[FloatArray], roles: tuple[int, int], first_lag: int, back: ComplexArray
) -> ComplexArray:
    """(F,) of driven over driving; `roles` are their columns, `first_lag` the driving one's first."""
    driven, driving = roles
    rows = []
    goals = []
    for pair in pairs:
        n = len(pair)
        own = [pair[ORDER - k : n - k, driven] for k in range(1, ORDER + 1)]
        other = [pair[ORDER - k : n - k, driving] for k in range(first_lag, ORDER + 1)]
        rows.append(np.stack(own + other, axis=1))
        goals.append(pair[ORDER:, driven])
    matrix = np.concatenate(rows)
    theta = np.linalg.lstsq(matrix.T @ matrix, matrix.T @ np.concatenate(goals), rcond=1e-12)[0]
    bottom = 1.0 - back[:, 1:] @ theta[:ORDER]
    return np.asarray(back[:, first_lag:] @ theta[ORDER:] / bottom)
