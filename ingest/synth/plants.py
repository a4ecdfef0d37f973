"""The AR.Drone's inner loops as transfer functions: the paper's equations (10), (11) and (12).

Fitted to flight data by Martin (2012), printed by the paper on Takagi-Sugeno identification of the AR.Drone.
Inputs are what the manufacturer's inner loop takes: theta_in and phi_in in degrees (forward and right are
positive) and vz_in in m/s (up positive). Outputs are velocities in m/s: vx forward, vy to the right, vz up.

Plants are flown with a zero-order hold: a command holds until the next one, as a digital link holds it. On
a grid of dt_s this is exact, no integration scheme: x[k+1] = exp(A dt) x[k] + (int_0^dt exp(A s) ds) B u[k].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.ingest.synth.manoeuvres import paper_training, paper_validation
from flysid.sharing import once

if TYPE_CHECKING:
    import control

Hold = Literal["zero", "first"]


@dataclass(frozen=True)
class Loop:
    """One inner loop: output over input as polynomials in s, highest power first.

    `numerator`, `denominator`: coefficients as the paper prints them.
    `input`, `output`: names of the signals.
    `input_unit`, `output_unit`: their units.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    input: str
    output: str
    input_unit: str
    output_unit: str = "m/s"

    @property
    def gain(self) -> float:
        """Steady output per unit of input, G(0)."""
        return self.numerator[-1] / self.denominator[-1]

    def response(self, omega_rad_s: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        """G(j omega), complex, in output units per input unit."""
        s = 1j * np.asarray(omega_rad_s, dtype=np.float64)
        value = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(value, dtype=np.complex128)

    def transfer_function(self) -> control.TransferFunction:
        """The loop for python-control."""
        import control

        return control.TransferFunction(
            list(self.numerator), list(self.denominator), inputs=[self.input], outputs=[self.output]
        )


LOOPS: Mapping[str, Loop] = {
    "longitudinal": Loop((0.7995,), (1.0, 4.1881, 7.1429), "theta_in", "vx", "deg"),  # (10)
    "lateral": Loop((116.24, 67.2488), (1000.0, 982.664, 301.338), "phi_in", "vy", "deg"),  # (11)
    "vertical": Loop(
        (17.6902, 37.7142, 422.62), (1.0, 11.6091, 68.394, 257.0, 684.244), "vz_in", "vz", "m/s"
    ),  # (12)
}


SIGNALS: Mapping[str, Callable[[npt.ArrayLike], FloatArray]] = {
    "training": paper_training,
    "validation": paper_validation,
}


def loop_named(name: str) -> Loop:
    """The loop of that name; raises UsageError for any other."""
    try:
        return LOOPS[name]
    except KeyError:
        raise UsageError(f"no loop {name!r}", hint="one of " + ", ".join(LOOPS)) from None


def fly(
    plant: Loop | control.TransferFunction,
    u: npt.ArrayLike,
    dt_s: float,
    *,
    hold: Hold = "zero",
    x0: npt.ArrayLike | None = None,
) -> FloatArray:
    """Response of a continuous plant to sampled commands.

    Parameters
    ----------
    plant : a Loop or a proper continuous SISO python-control TransferFunction.
    u : (N,) commands.
    dt_s : sample time, seconds.
    hold : "zero": u[k] acts on [k dt, (k+1) dt); "first": straight lines between the samples.
    x0 : (n,) state of the controllable canonical form at k = 0; rest when None.

    Returns
    -------
    (N,) outputs; y[k] is taken at k dt. Held commands act on y[k] through the direct term only.
    """
    if not (np.isfinite(dt_s) and dt_s > 0):
        raise UsageError(f"the sample time must be positive, not {dt_s!r} s")
    a, b, c, d = _canonical(*_polynomials(plant))
    ad, bd, ramp = _held(a, b, dt_s)
    u = np.asarray(u, dtype=np.float64)
    x = np.zeros(len(b)) if x0 is None else np.asarray(x0, dtype=np.float64)
    if hold == "first" and len(u):  # in z = x - ramp u the step needs no later command
        x = x - ramp * u[0]
        bd = bd + ad @ ramp - ramp
        d = d + float(c @ ramp)
    y = np.empty(len(u))
    for k, uk in enumerate(u):
        y[k] = c @ x + d * uk
        x = ad @ x + bd * uk
    return y


def _polynomials(plant: Loop | control.TransferFunction) -> tuple[FloatArray, FloatArray]:
    if isinstance(plant, Loop):
        return np.array(plant.numerator), np.array(plant.denominator)
    if (plant.ninputs, plant.noutputs) != (1, 1):
        raise UsageError(f"one input and one output are needed, not {plant.ninputs} and {plant.noutputs}")
    if plant.dt not in (0, None):
        raise UsageError("the plant is discrete already", hint="give its continuous transfer function")
    return np.asarray(plant.num[0][0], dtype=np.float64), np.asarray(plant.den[0][0], dtype=np.float64)


def _canonical(
    numerator: FloatArray, denominator: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Controllable canonical form (A, B, C, D) of a proper transfer function."""
    num = np.trim_zeros(numerator, "f")
    den = np.trim_zeros(denominator, "f")
    n = len(den) - 1
    if len(num) > n + 1:
        raise UsageError("the transfer function is not proper: it differentiates its input")
    num = np.concatenate([np.zeros(n + 1 - len(num)), num]) / den[0]
    den = den / den[0]
    a = np.eye(n, k=-1)
    a[:1] = -den[1:]
    b = np.zeros(n)
    b[:1] = 1.0
    return a, b, num[1:] - num[0] * den[1:], float(num[0])


def _held(a: FloatArray, b: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(Ad, Bd, Cd): x[k+1] = Ad x[k] + Bd u[k] + Cd (u[k+1] - u[k]), by one exponential (Van Loan, 1978)."""
    from scipy.linalg import expm

    n = len(b)
    block = np.zeros((n + 2, n + 2))
    block[:n, :n] = a * dt_s
    block[:n, n] = b * dt_s
    block[n, n + 1] = 1.0
    exponential = expm(block)
    return exponential[:n, :n], exponential[:n, n], exponential[:n, n + 1]


def paper_experiment(
    loop: str,
    signal: str = "training",
    *,
    duration_s: float = 400.0,
    dt_s: float = 0.01,
    noise: float = 0.0,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The paper's experiment on one loop: signal (13) or (14) flown through (10), (11) or (12) from rest.

    Parameters
    ----------
    loop : "longitudinal", "lateral" or "vertical".
    signal : "training" (13) or "validation" (14).
    duration_s, dt_s : length and sample time; the paper has T = 0.01 s.
    noise : standard deviation of white measurement noise on the output, m/s.
    seed : of that noise; another loop or signal draws other noise from the same seed.

    Returns
    -------
    u, y, y_true : (N,) input, measured output, output without noise.
    """
    if signal not in SIGNALS:
        raise UsageError(f"no signal {signal!r}", hint="one of " + ", ".join(SIGNALS))
    u, y_true = (part.copy() for part in _flown(loop, signal, duration_s, dt_s))
    rng = np.random.default_rng([seed, list(LOOPS).index(loop), list(SIGNALS).index(signal)])
    return u, y_true + noise * rng.standard_normal(len(u)), y_true


@once(lambda *given: given)
def _flown(loop: str, signal: str, duration_s: float, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """(N,) commands and outputs without noise."""
    u = SIGNALS[signal](dt_s * np.arange(round(duration_s / dt_s)))
    return u, fly(loop_named(loop), u, dt_s, hold="first")
