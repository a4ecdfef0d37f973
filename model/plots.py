"""Step and frequency responses of a fitted model as matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from flysid.errors import UsageError
from flysid.escaping import picture_text

if TYPE_CHECKING:
    from flysid.dataset import FloatArray
    from flysid.model.base import Fitted


def plot_step(model: Fitted, output: int = 0, ax: Any = None) -> Any:
    """Unit steps of every input from rest, as long as six of the slowest time constants."""
    axes = ax if ax is not None else _axes(1)[0]
    samples = _length(model)
    t = model.dt_s * np.arange(samples)
    for j, signal in enumerate(model.inputs):
        axes.plot(t, _response(model, j, 1.0, samples)[:, output], label=picture_text(signal.name))
    axes.set_xlabel("time, s")
    axes.set_ylabel(picture_text(_label(model.outputs[output].name, model.outputs[output].unit)))
    axes.set_title(f"{model.structure}: unit steps from rest")
    axes.legend()
    return axes


def plot_bode(model: Fitted, output: int = 0, ax: Any = None) -> Any:
    """Magnitude and phase of every input, up to half the sample rate; of small signals about rest.

    Returns
    -------
    Two axes; `ax` gives them.
    """
    magnitude, phase = ax if ax is not None else _axes(2)
    frequency_hz, responses = bode(model, output)
    for signal, response in zip(model.inputs, responses, strict=True):
        gain_db = 20.0 * np.log10(np.maximum(np.abs(response), 1e-300))
        magnitude.semilogx(frequency_hz, gain_db, label=picture_text(signal.name))
        phase.semilogx(frequency_hz, np.degrees(np.unwrap(np.angle(response))))
    magnitude.set_ylabel(picture_text(f"{model.outputs[output].name}, dB"))
    magnitude.set_title(f"{model.structure}: frequency response")
    magnitude.legend()
    phase.set_ylabel("phase, deg")
    phase.set_xlabel("frequency, Hz")
    return magnitude, phase


def bode(
    model: Fitted, output: int = 0, *, padding: int = 8, height: float = 1e-3
) -> tuple[FloatArray, FloatArray]:
    """(F,) frequencies in Hz and (n_u, F) complex responses of small signals about rest.

    `height`: of a step from rest whose response is taken for the linear one, in units of the input.
    """
    samples = _length(model)
    padded = padding * samples
    frequency_hz = np.asarray(np.fft.rfftfreq(padded, model.dt_s)[1:], dtype=np.float64)
    found = []
    for j in range(len(model.inputs)):
        step = _response(model, j, height, samples)[:, output] / height
        found.append(np.fft.rfft(np.diff(step, prepend=0.0), padded)[1:])
    return frequency_hz, np.array(found)


def _response(model: Fitted, column: int, height: float, samples: int) -> FloatArray:
    """(N, n_y) what a step adds to the run from rest."""
    u = np.zeros((samples, len(model.inputs)))
    rest = model.simulate(u)
    u[:, column] = height
    return np.asarray(model.simulate(u) - rest)


def _length(model: Fitted, *, time_constants: float = 6.0, most: int = 20_000, fewest: int = 50) -> int:
    slowest = max((r.time_constant_s for r in model.rules() if np.isfinite(r.time_constant_s)), default=0.0)
    samples = round(time_constants * slowest / model.dt_s)
    return int(np.clip(samples, fewest + model.n_init, most))


def _axes(rows: int) -> Any:
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise UsageError("matplotlib is not installed", hint='pip install "flysid[plot]"') from error
    return plt.subplots(rows, sharex=True, squeeze=False)[1][:, 0]


def _label(name: str, unit: str) -> str:
    return f"{name}, {unit}" if unit else name
