"""What is left in the errors: whiteness, dependence on the input, coherence and frequency response.

All estimates pool segments and never pair samples across a segment's edge. Correlations are normalised; bands
are 99 %. The band of a one-step autocorrelation is the one of white noise, 2.58 / sqrt(N). A free-run error
is never white, so its cross-correlation with the input gets Bartlett's band,
2.58 sqrt(sum_j rho_e(j) rho_u(j) / N) (Bartlett 1955; Box & Jenkins 1976, section 11.1), which reduces to the
former where either is white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray

Z99 = NormalDist().inv_cdf(0.995)
BLIND = 0.5
"""Band of a correlation, beyond which a quarter of the error's power could follow the input unseen."""
OVERLAP = 1.0 + 2.0 / 36.0
"""Windows that overlap by half are correlated: 1 + 2 rho^2 with rho = 1/6 for Hann (Welch 1967)."""


@dataclass(frozen=True, eq=False)
class Correlation:
    """Correlation at `lags` (L,), in samples; positive lags: the input leads. `band` is the 99 % limit.

    Attributes
    ----------
    rho : (L,) between -1 and 1.
    band : largest |rho| that chance explains at one lag.
    causal : (L,) lags that the test looks at (autocorrelation: 1 and more; input: 0 and more).
    """

    lags: FloatArray
    rho: FloatArray
    band: float
    causal: FloatArray

    @property
    def tested(self) -> int:
        """Lags that count."""
        return int(np.count_nonzero(self.causal))

    @property
    def outside(self) -> int:
        """Lags that count and lie outside the band."""
        return int(np.count_nonzero((np.abs(self.rho) > self.band) & (self.causal > 0)))

    @property
    def blind(self) -> bool:
        """Passing the test says nothing: chance alone explains so much, or one side does not vary."""
        return self.band > BLIND or not self.rho.any()

    @property
    def fails(self) -> bool:
        """More than chance explains: too many lags outside (1 % plus three standard deviations, at least 2),
        or one outside a band that holds all of them together (Bonferroni)."""
        expected = 0.01 * self.tested
        if self.outside > max(1.0, expected + 3.0 * np.sqrt(0.99 * expected)):
            return True
        together = NormalDist().inv_cdf(1.0 - 0.005 / self.tested) / Z99
        return abs(self.peak[1]) > together * self.band

    @property
    def peak(self) -> tuple[int, float]:
        """(lag, rho) of the largest tested correlation."""
        i = int(np.argmax(np.where(self.causal > 0, np.abs(self.rho), -1.0)))
        return int(self.lags[i]), float(self.rho[i])


def autocorrelation(errors: Sequence[FloatArray], lags: int) -> Correlation:
    """Of the errors (N_i,) at lags 1 .. `lags`."""
    x = _centre(errors)
    rho = _pooled_products(x, x, lags)
    index = np.arange(1, lags + 1, dtype=np.float64)
    band = Z99 / np.sqrt(sum(len(s) for s in x))
    return Correlation(index, rho[lags + 1 :], float(band), np.ones(lags))


def cross_correlation(errors: Sequence[FloatArray], inputs: Sequence[FloatArray], lags: int) -> Correlation:
    """Of the errors e(k) with u(k - lag), lags -`lags` .. `lags`, with Bartlett's band."""
    e = _centre(errors)
    u = _centre(inputs)
    rho = _pooled_products(e, u, lags)
    longest = max(len(s) for s in e)
    rho_e, rho_u = (_pooled_products(x, x, longest - 1)[longest - 1 :] for x in (e, u))
    n = sum(len(s) for s in e)
    taper = 1.0 - np.arange(1, longest) / longest
    total = 1.0 + 2.0 * float(np.sum(taper * rho_e[1:] * rho_u[1:]))
    index = np.arange(-lags, lags + 1, dtype=np.float64)
    band = Z99 * np.sqrt(max(total, 1.0) / n)
    return Correlation(index, rho, float(min(band, 1.0)), (index >= 0).astype(np.float64))


def _centre(series: Sequence[FloatArray]) -> list[FloatArray]:
    """Without their common mean, and divided by the largest value: squares neither overflow nor vanish."""
    largest = _largest(series)
    mean = float(np.mean(np.concatenate([s / largest for s in series])))
    return [s / largest - mean for s in series]


def _largest(series: Sequence[FloatArray]) -> float:
    return max(max(float(np.max(np.abs(s))) for s in series), 1e-300)


def _pooled_products(a: Sequence[FloatArray], b: Sequence[FloatArray], lags: int) -> FloatArray:
    """(2 lags + 1,) sum a(k) b(k - lag) over segments, divided by the norms; 0 where a norm is 0."""
    total = np.zeros(2 * lags + 1)
    for x, z in zip(a, b, strict=True):
        size = 1 << (2 * len(x)).bit_length()
        product = np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(z, size)), size)
        reach = min(lags, len(x) - 1)
        total[lags : lags + reach + 1] += product[: reach + 1]
        if reach:
            total[lags - reach : lags] += product[-reach:]
    norm = np.sqrt(sum(float(x @ x) for x in a) * sum(float(z @ z) for z in b))
    if norm <= 0.0:
        return np.zeros_like(total)
    rho: FloatArray = total / norm
    return rho


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """Empirical response from one input to one output.

    Attributes
    ----------
    hz : (F,) frequencies above 0.
    response : (F,) complex gain, output unit per input unit (Welch's H1 estimate).
    coherence : (F,) 0 to 1.
    averages : windows that the estimate averages, as if they were independent.
    """

    hz: FloatArray
    response: npt.NDArray[np.complex128]
    coherence: FloatArray
    averages: float = 1.0

    @property
    def relative_error(self) -> FloatArray:
        """(F,) standard error of the gain over the gain, and of the phase in rad (Bendat & Piersol, 2010)."""
        share = np.maximum(self.coherence, 1e-12)
        error: FloatArray = np.sqrt((1.0 - share) / (2.0 * share * self.averages))
        return error

    @property
    def largest(self) -> float:
        """The largest coherence, averaged over three neighbours: one line alone may be chance."""
        smooth = np.convolve(self.coherence, np.full(3, 1.0 / 3.0), mode="same")
        return float(smooth.max())

    @property
    def explained_to_hz(self) -> float | None:
        """The highest frequency at which the input explains more than half of the output, or None."""
        known = np.flatnonzero(np.convolve(self.coherence, np.full(3, 1.0 / 3.0), mode="same") > 0.5)
        return float(self.hz[known[-1]]) if len(known) else None


def spectrum(
    inputs: Sequence[FloatArray], outputs: Sequence[FloatArray], dt_s: float
) -> ResidualSpectrum | None:
    """Welch's (1967) estimate with Hann windows that overlap by half; None with fewer than 3 windows."""
    total = sum(len(u) for u in inputs)
    width = 1 << int(np.log2(max(total / 8.0, 1.0)))
    width = min(width, 4096, 1 << int(np.log2(max(max(len(u) for u in inputs), 1))))
    window = np.hanning(width)
    unit_u = _largest(inputs)
    unit_y = _largest(outputs)
    inputs = [u / unit_u for u in inputs]
    outputs = [y / unit_y for y in outputs]
    uu = np.zeros(width // 2 + 1)
    yy = np.zeros(width // 2 + 1)
    uy = np.zeros(width // 2 + 1, dtype=np.complex128)
    count = 0
    for u, y in zip(inputs, outputs, strict=True):
        for start in range(0, len(u) - width + 1, max(width // 2, 1)):
            fu, fy = (np.fft.rfft((x - x.mean()) * window) for x in (u[start:][:width], y[start:][:width]))
            uu = uu + np.abs(fu) ** 2
            yy = yy + np.abs(fy) ** 2
            uy = uy + np.conj(fu) * fy
            count = count + 1
    if count < 3 or width < 16:
        return None
    uu = uu[1:-1]
    yy = yy[1:-1]
    uy = uy[1:-1]
    hz = np.fft.rfftfreq(width, dt_s)[1:-1]
    keep = (uu > 1e-12 * uu.max()) & (yy > 0.0) if uu.max() > 0 else np.zeros(len(uu), dtype=bool)
    if not keep.any():
        return None
    coherence = np.abs(uy[keep]) ** 2 / (uu[keep] * yy[keep])
    gain = uy[keep] / uu[keep] * (unit_y / unit_u)
    return ResidualSpectrum(hz[keep], gain, np.minimum(coherence, 1.0), max(1.0, count / OVERLAP))
