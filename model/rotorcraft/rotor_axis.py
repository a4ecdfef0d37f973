"""The equations of one axis, with the derivatives of every prediction by every parameter.

    x_i = command over its largest in training, times (voltage / mean voltage)^volts where one is measured
    lag dn_i/dt = x_i(t - delay) - n_i           motors
    g(t) = sum_i torque_i ((1 - curve) n_i + curve n_i^2)
    dy/dt = g(t) + trim - damping y              a body rate; or y = g(t) + trim, an acceleration

Commands are held from row to row, so that motors and torques are exact at any delay. One step ahead, an
innovation e = y - prediction corrects the rate by `hold` e and the trim by `drift` e a sample: disturbances
of torque that wander, as wind and a falling battery do (Ljung, System Identification, 1999, 4.3 and 10.1:
prediction errors, which feedback does not bend). Without both it is the free run.

Parameters stand in the order of `NAMES`, then one torque per command, then `volts` where voltage is measured.
"""

from __future__ import annotations

import math

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray

NAMES = ("lag", "delay", "curve", "damping", "trim", "hold", "drift")
LAG, DELAY, CURVE, DAMPING, TRIM, HOLD, DRIFT = range(len(NAMES))
FIRST = len(NAMES)
"""Where the torques begin."""


@njit(cache=True)
def _move(n, n_lag, n_delay, target, h, grows, lag, sums):  # type: ignore[no-untyped-def]
    """Motor speed after h seconds towards a target, and its derivatives by lag and delay.

    sums (2, 3) grows by the integrals of n and n^2 and by their derivatives; `grows` is dh / d delay.
    """
    fade = math.exp(-h / lag)
    apart = n - target
    s = lag * (1.0 - fade)
    q = 0.5 * lag * (1.0 - fade * fade)
    s_lag = 1.0 - fade - fade * h / lag
    q_lag = 0.5 * (1.0 - fade * fade) - fade * fade * h / lag
    sums[0, 0] += target * h + apart * s
    sums[1, 0] += target * target * h + 2.0 * target * apart * s + apart * apart * q
    by_lag = n_lag * s + apart * s_lag
    sums[0, 1] += by_lag
    sums[1, 1] += 2.0 * target * by_lag + 2.0 * apart * n_lag * q + apart * apart * q_lag
    end = target + apart * fade
    sums[0, 2] += n_delay * s + grows * end
    sums[1, 2] += 2.0 * target * n_delay * s + 2.0 * apart * n_delay * q + grows * end * end
    end_lag = n_lag * fade + apart * fade * h / (lag * lag)
    return end, end_lag, n_delay * fade - grows * apart * fade / lag


@njit(cache=True)
def _carry(n, by, target, target_by, h, lag, sums):  # type: ignore[no-untyped-def]
    """The derivative `by` of a motor's speed, h seconds later, by what moves its target only.

    sums (2,) grows by the derivatives of the integrals of n and n^2.
    """
    fade = math.exp(-h / lag)
    apart = n - target
    apart_by = by - target_by
    s = lag * (1.0 - fade)
    q = 0.5 * lag * (1.0 - fade * fade)
    sums[0] += target_by * h + apart_by * s
    sums[1] += 2.0 * (
        target * target_by * h + (target_by * apart + target * apart_by) * s + apart * apart_by * q
    )
    return target_by + apart_by * fade


@njit(cache=True)
def run(x, by, y, theta, dt, integrates, resting, out, slopes):  # type: ignore[no-untyped-def]
    """out (N, 3) = predictions, their trims, and torque since the row before; slopes (N, P) = derivatives.

    Empty `slopes` (0, P) leave the derivatives out. Row 0 is y[0]. Motors begin at the first command, which
    held before, or at rest after no command. `by` (N, n) are the commands' derivatives by the last
    parameter, or (0, n) where the voltage is not measured.
    """
    rows, count = x.shape
    volts = 7 + count if len(by) > 0 and len(slopes) > 0 else -1
    known = theta.size if len(slopes) else 0
    lag = theta[0]
    delay = theta[1]
    curve = theta[2]
    damping = theta[3]
    hold = theta[5]
    drift = theta[6]
    whole = math.floor(delay / dt)
    past = delay - whole * dt  # of a row, in which the command before still holds
    if damping * dt > 1e-8:
        fade = math.exp(-damping * dt)
        reach = (1.0 - fade) / damping
        reach_damping = (dt * fade - reach) / damping
    else:
        fade = 1.0 - damping * dt
        reach = dt * (1.0 - 0.5 * damping * dt)
        reach_damping = -0.5 * dt * dt
    n = np.zeros(count)
    n_lag = np.zeros(count)
    n_delay = np.zeros(count)
    sums = np.empty((2, 3))
    n_by = np.zeros(count)
    by_sums = np.zeros(2)
    earlier = np.zeros(count)  # the command before the first row
    earlier_by = np.zeros(count)
    if not resting:
        for i in range(count):  # a slice's assignment takes a second longer to compile
            earlier[i] = x[0, i]
            n[i] = x[0, i]
            if volts >= 0:
                earlier_by[i] = by[0, i]
                n_by[i] = by[0, i]
    dg = np.zeros(theta.size)
    g = 0.0
    for i in range(count):
        dg[2] += theta[7 + i] * (n[i] * n[i] - n[i])
        dg[7 + i] = (1.0 - curve) * n[i] + curve * n[i] * n[i]
        g += theta[7 + i] * dg[7 + i]
        if volts >= 0:
            dg[volts] += theta[7 + i] * (1.0 - curve + 2.0 * curve * n[i]) * n_by[i]
    trim = theta[4]
    rate = y[0] if integrates else g + trim
    d_rate = np.zeros(theta.size)
    d_trim = np.zeros(theta.size)
    d_trim[4] = 1.0
    if not integrates:
        d_rate += dg
        d_rate[4] += 1.0
    for k in range(rows):
        out[k, 0] = rate
        out[k, 1] = trim
        out[k, 2] = g
        for j in range(known):
            slopes[k, j] = d_rate[j]
        if k + 1 == rows:
            break
        e = 0.0
        if hold != 0.0 or drift != 0.0 or known > 0:
            e = y[k] - rate
        dg[:] = 0.0
        g = 0.0
        now = x[k - whole] if k >= whole else earlier
        then = x[k - whole - 1] if k > whole else earlier
        for i in range(count):
            sums[:] = 0.0
            if volts >= 0:
                by_sums[:] = 0.0
                now_by = by[k - whole, i] if k >= whole else earlier_by[i]
                then_by = by[k - whole - 1, i] if k > whole else earlier_by[i]
                halfway = then[i] + (n[i] - then[i]) * math.exp(-past / lag)
                n_by[i] = _carry(n[i], n_by[i], then[i], then_by, past, lag, by_sums)
                n_by[i] = _carry(halfway, n_by[i], now[i], now_by, dt - past, lag, by_sums)
            a, b, c = _move(n[i], n_lag[i], n_delay[i], then[i], past, 1.0, lag, sums)
            n[i], n_lag[i], n_delay[i] = _move(a, b, c, now[i], dt - past, -1.0, lag, sums)
            torque = theta[7 + i]
            if integrates:  # the torque's mean over the row
                sums /= dt
                by_sums /= dt
            else:
                by_sums[0] = n_by[i]
                by_sums[1] = 2.0 * n[i] * n_by[i]
                sums[0, 0] = n[i]
                sums[0, 1] = n_lag[i]
                sums[0, 2] = n_delay[i]
                sums[1, 0] = n[i] * n[i]
                sums[1, 1] = 2.0 * n[i] * n_lag[i]
                sums[1, 2] = 2.0 * n[i] * n_delay[i]
            f = (1.0 - curve) * sums[0, 0] + curve * sums[1, 0]
            g += torque * f
            dg[0] += torque * ((1.0 - curve) * sums[0, 1] + curve * sums[1, 1])
            dg[1] += torque * ((1.0 - curve) * sums[0, 2] + curve * sums[1, 2])
            dg[2] += torque * (sums[1, 0] - sums[0, 0])
            dg[7 + i] = f
            if volts >= 0:
                dg[volts] += torque * ((1.0 - curve) * by_sums[0] + curve * by_sums[1])
        if integrates:
            held = rate + hold * e
            wandered = trim + drift * e / dt
            push = g + wandered
            for j in range(known):
                d_e = -d_rate[j]
                d_held = d_rate[j] + hold * d_e
                d_trim[j] += drift * d_e / dt
                if j == 5:
                    d_held += e
                if j == 6:
                    d_trim[j] += e / dt
                d_rate[j] = fade * d_held + reach * (dg[j] + d_trim[j])
                if j == 3:
                    d_rate[j] += -dt * fade * held + reach_damping * push
            trim = wandered
            rate = fade * held + reach * push
        else:
            for j in range(known):
                d_trim[j] -= hold * d_rate[j]
                if j == 5:
                    d_trim[j] += e
                d_rate[j] = dg[j] + d_trim[j]
            trim += hold * e
            rate = g + trim


def driven(x: FloatArray, theta: FloatArray, volts: FloatArray | None) -> FloatArray:
    """(N, n) commands as the motors feel them; volts (N,) are logarithms of the voltage over its mean.

    Row by row in memory, whatever came: `run` is then compiled once.
    """
    return np.ascontiguousarray(x if volts is None else x * np.exp(theta[-1] * volts)[:, None])


def predictions(
    x: FloatArray,
    y: FloatArray,
    theta: FloatArray,
    dt: float,
    integrates: bool,
    volts: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """(N,) one step ahead, and (N, P) derivatives by every parameter."""
    out = np.empty((len(x), 3))
    slopes = np.empty((len(x), len(theta)))
    felt = driven(x, theta, volts)
    by = felt[:0] if volts is None else felt * volts[:, None]
    run(felt, by, y, theta, dt, integrates, False, out, slopes)
    return out[:, 0], slopes


def _row_by_row(
    x: FloatArray,
    y: FloatArray,
    theta: FloatArray,
    dt: float,
    integrates: bool,
    volts: FloatArray | None,
) -> FloatArray:
    """(N, 3) output, trim and torque of the one-step predictor."""
    out = np.empty((len(x), 3))
    felt = driven(x, theta, volts)
    run(felt, felt[:0], y, theta, dt, integrates, False, out, np.empty((0, len(theta))))
    return out


def wandering_trim(
    x: FloatArray,
    y: FloatArray,
    theta: FloatArray,
    dt: float,
    integrates: bool,
    volts: FloatArray | None = None,
) -> FloatArray:
    """(N,) the trim as the one-step predictor corrects it, row by row."""
    return _row_by_row(x, y, theta, dt, integrates, volts)[:, 1]


def steps_ahead(
    x: FloatArray,
    y: FloatArray,
    theta: FloatArray,
    dt: float,
    integrates: bool,
    k: int,
    volts: FloatArray | None = None,
) -> FloatArray:
    """(N,) k steps ahead; the first k rows mean nothing."""
    out = _row_by_row(x, y, theta, dt, integrates, volts)
    fade, reach = what_a_row_keeps(theta, dt)
    trim = out[: len(x) - k + 1, 1]
    ahead = out[: len(x) - k + 1, 0]
    for step in range(1, k):
        torque = out[step : step + len(ahead), 2]
        ahead = fade * ahead + reach * (torque + trim) if integrates else torque + trim
    return np.concatenate([np.zeros(k - 1), ahead])


def free_run(
    x: FloatArray,
    first: float,
    theta: FloatArray,
    dt: float,
    integrates: bool,
    resting: bool,
    volts: FloatArray | None = None,
) -> FloatArray:
    """(N,) from the first output on, the inputs alone."""
    alone = theta.copy()
    alone[[HOLD, DRIFT]] = 0.0
    out = np.empty((len(x), 3))
    felt = driven(x, alone, volts)
    slopes = np.empty((0, len(theta)))
    run(felt, felt[:0], np.full(1, first), alone, dt, integrates, resting, out, slopes)
    return out[:, 0]


def what_a_row_keeps(theta: FloatArray, dt: float) -> tuple[float, float]:
    """What is left of a rate after a row, and what a torque adds in one."""
    damping = float(theta[DAMPING])
    return math.exp(-damping * dt), -math.expm1(-damping * dt) / damping if damping > 0.0 else dt


def forgets(theta: FloatArray, dt: float, integrates: bool) -> bool:
    """Whether the one-step predictor forgets its start, or holds it where nothing corrects the trim."""
    if not integrates:
        return bool(abs(1.0 - theta[HOLD]) <= 1.0)
    fade, reach = what_a_row_keeps(theta, dt)
    wandering = theta[DRIFT] / dt
    closed = np.array([[fade * (1.0 - theta[HOLD]) - reach * wandering, reach], [-wandering, 1.0]])
    return bool(np.abs(np.linalg.eigvals(closed)).max() < 1.0 + (0.0 if wandering else 1e-9))
