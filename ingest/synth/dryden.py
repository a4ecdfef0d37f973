"""Wind: steady, Dryden turbulence at low altitude, and discrete gusts; MIL-F-8785C (1980), sec. 3.7.

Below 1000 ft, with h in feet and W20 the wind at 20 ft: L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2,
sigma_w = 0.1 W20, sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4. One-sided spectra in rad/s:

    Phi_u = sigma_u^2 (2 T_u / pi) / (1 + (T_u w)^2)                      T = L / V
    Phi_v = sigma_v^2 (T_v / pi) (1 + 3 (T_v w)^2) / (1 + (T_v w)^2)^2    Phi_w alike

Shaping filters are discretised exactly, noise included, and start in their stationary state, so that the
record has the right spectrum from the first sample and at any sample time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.constants import foot

from flysid.dataset import FloatArray
from flysid.errors import UsageError


@dataclass(frozen=True)
class Intensity:
    """Standard deviations (m/s) and time constants (s) of u (along the wind), v (across), w (up)."""

    sigma: tuple[float, float, float]
    tau_s: tuple[float, float, float]


@dataclass(frozen=True)
class Gust:
    """A 1 - cosine gust (sec. 3.7.1.3): builds up to `peak_m_s` over `rise_s`, and dies away as fast."""

    start_s: float
    rise_s: float
    peak_m_s: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not (self.start_s >= 0.0 and self.rise_s > 0.0 and np.isfinite(self.peak_m_s).all()):
            raise UsageError("a gust starts at 0 s or later, rises in some time and has a finite peak")


@dataclass(frozen=True)
class Wind:
    """Steady wind towards `towards_deg` (0 forward, 90 to the left), its turbulence, and gusts."""

    speed_m_s: float = 0.0
    towards_deg: float = 0.0
    turbulent: bool = True
    gusts: tuple[Gust, ...] = ()


def low_altitude(
    altitude_m: float, wind_20ft_m_s: float, airspeed_m_s: float, *, least_airspeed_m_s: float = 1.0
) -> Intensity:
    """MIL-F-8785C's low-altitude intensities and scales; altitudes from 10 to 1000 ft.

    `least_airspeed_m_s`: the wind carries the frozen field past a hovering vehicle, at least this fast.
    """
    feet = float(np.clip(altitude_m / foot, 10.0, 1000.0))
    shape = 0.177 + 0.000823 * feet
    sigma_w = 0.1 * wind_20ft_m_s
    sigma_u = sigma_w / shape**0.4
    length_w = feet * foot
    length_u = feet / shape**1.2 * foot
    speed = max(airspeed_m_s, least_airspeed_m_s)
    return Intensity((sigma_u, sigma_u, sigma_w), (length_u / speed, length_u / speed, length_w / speed))


def spectrum(intensity: Intensity, axis: int, omega_rad_s: npt.ArrayLike) -> FloatArray:
    """One-sided power spectral density of u (0), v (1) or w (2), (m/s)^2 per rad/s; integrates to sigma^2."""
    omega = np.asarray(omega_rad_s, dtype=np.float64)
    sigma = intensity.sigma[axis]
    tau = intensity.tau_s[axis]
    x = (tau * omega) ** 2
    if axis == 0:
        return np.asarray(sigma**2 * (2.0 * tau / np.pi) / (1.0 + x))
    return np.asarray(sigma**2 * (tau / np.pi) * (1.0 + 3.0 * x) / (1.0 + x) ** 2)


def turbulence(intensity: Intensity, n: int, dt_s: float, rng: np.random.Generator) -> FloatArray:
    """(n, 3) u, v, w of one realisation."""
    return np.column_stack(
        [
            _first_order(intensity.sigma[0], intensity.tau_s[0], dt_s, rng.standard_normal(n)),
            *(
                _second_order(intensity.sigma[i], intensity.tau_s[i], dt_s, rng.standard_normal((n, 2)))
                for i in (1, 2)
            ),
        ]
    )


def _first_order(sigma: float, tau_s: float, dt_s: float, noise: FloatArray) -> FloatArray:
    """Ornstein-Uhlenbeck process: x[k+1] = a x[k] + sigma sqrt(1 - a^2) n[k], stationary from the start."""
    keep = float(np.exp(-dt_s / tau_s))
    spread = float(np.sqrt(1.0 - keep * keep))
    x = np.array(noise)
    for k in range(1, len(x)):
        x[k] = keep * x[k - 1] + spread * noise[k]
    return sigma * x


def _second_order(sigma: float, tau_s: float, dt_s: float, noise: FloatArray) -> FloatArray:
    """Two equal lags and a lead; dimensionless time s = t / tau.

    x' = [[-2, -1], [1, 0]] x + [1, 0] n under unit white noise has the stationary covariance I/4, so that
    y = sqrt(3) x1 + x2, which is (1 + sqrt(3) s) / (1 + s)^2 of n, has variance (3 + 1) / 4 = 1.
    """
    step = dt_s / tau_s
    # the double pole at -1 has the exponential e^-s [[1 - s, -s], [s, 1 + s]]
    decay = np.exp(-step)
    move = decay * np.array([[1.0 - step, -step], [step, 1.0 + step]])
    # what noise adds over a step keeps the covariance P = I/4: Q = P - M P M'
    added = np.linalg.cholesky(0.25 * (np.eye(2) - move @ move.T))
    x = 0.5 * noise[0]
    y = np.empty(len(noise))
    for k in range(len(noise)):
        y[k] = np.sqrt(3.0) * x[0] + x[1]
        if k + 1 < len(noise):
            x = move @ x + added @ noise[k + 1]
    return sigma * y


def gust_m_s(gusts: Sequence[Gust], time_s: FloatArray) -> FloatArray:
    """(N, 3) sum of the gusts."""
    total = np.zeros((len(time_s), 3))
    for gust in gusts:
        inside = (time_s >= gust.start_s) & (time_s < gust.start_s + 2.0 * gust.rise_s)
        shape = 0.5 * (1.0 - np.cos(np.pi * (time_s - gust.start_s) / gust.rise_s)) * inside
        total += shape[:, None] * np.asarray(gust.peak_m_s)
    return total


def wind_field(wind: Wind, n: int, dt_s: float, altitude_m: float, rng: np.random.Generator) -> FloatArray:
    """(n, 3) air velocity, world axes x forward, y left, z up, m/s."""
    if not 0.0 <= wind.speed_m_s < 100.0:
        raise UsageError(f"a wind of {wind.speed_m_s:g} m/s", hint="between 0 and 100 m/s")
    angle = np.radians(wind.towards_deg)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    across = np.array([-np.sin(angle), np.cos(angle), 0.0])
    air = np.tile(wind.speed_m_s * along, (n, 1))
    if wind.turbulent and wind.speed_m_s > 0.0:
        intensity = low_altitude(altitude_m, wind.speed_m_s, wind.speed_m_s)
        u, v, w = turbulence(intensity, n, dt_s, rng).T
        air += u[:, None] * along + v[:, None] * across
        air[:, 2] += w
    return air + gust_m_s(wind.gusts, dt_s * np.arange(n, dtype=np.float64))
