"""The rigid body in free run, with exact derivatives by its numbers, its start and the wind.

A state is position (3), velocity (3), quaternion w x y z (4) and body rate (3). Steps are classical
Runge-Kutta steps of a sample, and derivatives are those of the very steps.
"""

from __future__ import annotations

import numpy as np

from flysid.compiling import njit
from flysid.sixdof.layout import ARM, BODY_DRAG, DAMPING, EFFECTS, INERTIA, LEAN, ROTOR_DRAG, THRUST, TRIM
from flysid.stretch import FloatArray

STATES = 13
GRAVITY = 9.81
WIND = 3
"""Derivatives by the wind stand behind those by numbers."""
_LEAST_SHARE = 1e-9


@njit(cache=True)
def _turned(q):  # type: ignore[no-untyped-def]
    """(3, 3) from body to world axes."""
    w, x, y, z = q
    r = np.empty((3, 3))
    r[0, 0] = w * w + x * x - y * y - z * z
    r[1, 1] = w * w - x * x + y * y - z * z
    r[2, 2] = w * w - x * x - y * y + z * z
    r[0, 1] = 2.0 * (x * y - w * z)
    r[0, 2] = 2.0 * (x * z + w * y)
    r[1, 0] = 2.0 * (x * y + w * z)
    r[1, 2] = 2.0 * (y * z - w * x)
    r[2, 0] = 2.0 * (x * z - w * y)
    r[2, 1] = 2.0 * (y * z + w * x)
    return r


@njit(cache=True)
def _turned_by(q):  # type: ignore[no-untyped-def]
    """(4, 3, 3) derivatives of `_turned` by w, x, y, z."""
    w, x, y, z = 2.0 * q
    by = np.empty((4, 3, 3))
    by[0] = np.array([[w, -z, y], [z, w, -x], [-y, x, w]])
    by[1] = np.array([[x, y, z], [y, -x, -w], [z, w, -x]])
    by[2] = np.array([[-y, x, w], [x, y, z], [-w, z, -y]])
    by[3] = np.array([[-z, -w, x], [w, -z, y], [x, y, z]])
    return by


@njit(cache=True)
def _derivative(state, share, share_by, theta, wind, wanted):  # type: ignore[no-untyped-def]
    """dx/dt; where `wanted`, its derivatives by the state (13, 13) and by numbers and wind (13, P + 3)."""
    m = share.shape[0]
    n = theta.shape[0]
    rate = state[10:13]
    q = state[6:10]
    r = _turned(q)
    air = state[3:6] - wind
    w = r.T @ air
    speed = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    lift = 0.0
    spin = 0.0
    for i in range(m):
        lift += share[i]
        spin += np.sqrt(max(share[i], _LEAST_SHARE))
    force = np.empty(3)
    for k in range(3):
        force[k] = -(theta[ROTOR_DRAG + k] * spin + theta[BODY_DRAG + k] * speed) * w[k]
    force[2] += theta[THRUST] * lift
    d = np.empty(STATES)
    d[0:3] = state[3:6]
    d[3:6] = r @ force
    d[5] -= GRAVITY
    d[6] = 0.5 * (-q[1] * rate[0] - q[2] * rate[1] - q[3] * rate[2])
    d[7] = 0.5 * (q[0] * rate[0] + q[2] * rate[2] - q[3] * rate[1])
    d[8] = 0.5 * (q[0] * rate[1] - q[1] * rate[2] + q[3] * rate[0])
    d[9] = 0.5 * (q[0] * rate[2] + q[1] * rate[1] - q[2] * rate[0])
    ry = theta[INERTIA]
    rz = theta[INERTIA + 1]
    couple = np.array([ry - rz, (rz - 1.0) / ry, (1.0 - ry) / rz])
    hub = np.zeros(2)  # drag acts at the hubs: where rotors differ in speed, it turns
    for k in range(2):
        for i in range(m):
            hub[k] += theta[EFFECTS + k * m + i] * np.sqrt(max(share[i], _LEAST_SHARE))
    per = 1.0 / theta[THRUST] if theta[THRUST] > 0.0 else 0.0
    turn = np.zeros((3, 3))  # of angular acceleration by w
    turn[0, 1] = theta[LEAN] * spin
    turn[1, 0] = theta[LEAN + 1] * spin
    turn[0, 2] = -per * theta[ROTOR_DRAG + 2] * hub[0]
    turn[1, 2] = -per * theta[ROTOR_DRAG + 2] * hub[1]
    turn[2, 1] = per * ry / rz * theta[ROTOR_DRAG + 1] * hub[1]
    turn[2, 0] = per / rz * theta[ROTOR_DRAG] * hub[0]
    rolls = 0.0  # sums of effects times effects, of roll and pitch, weighted with rotor speeds
    both = 0.0
    pitches = 0.0
    for i in range(m):
        root = np.sqrt(max(share[i], _LEAST_SHARE))
        rolls += root * theta[EFFECTS + i] ** 2
        both += root * theta[EFFECTS + i] * theta[EFFECTS + m + i]
        pitches += root * theta[EFFECTS + m + i] ** 2
    met = np.zeros((3, 3))  # of angular acceleration by the rate, if arm is 1: the air that hubs meet
    met[0, 0] = -per * theta[ROTOR_DRAG + 2] * rolls
    met[0, 1] = -per * theta[ROTOR_DRAG + 2] * ry * both
    met[1, 0] = -per * theta[ROTOR_DRAG + 2] * both
    met[1, 1] = -per * theta[ROTOR_DRAG + 2] * ry * pitches
    met[2, 2] = -per / rz * (theta[ROTOR_DRAG] * rolls + theta[ROTOR_DRAG + 1] * ry * ry * pitches)
    arm = theta[ARM]
    damped = met @ rate
    for k in range(3):
        total = theta[TRIM + k] - theta[DAMPING + k] * spin * rate[k] + arm * damped[k]
        for j in range(3):
            total += turn[k, j] * w[j]
        for i in range(m):
            total += theta[EFFECTS + k * m + i] * share[i]
        d[10 + k] = total + couple[k] * rate[(k + 1) % 3] * rate[(k + 2) % 3]
    a = np.zeros((STATES, STATES))
    b = np.zeros((STATES, n + 3))
    if not wanted:
        return d, a, b
    turn_by = _turned_by(q)
    shape = np.zeros((3, 3))  # of force by w
    for k in range(3):
        shape[k, k] -= theta[ROTOR_DRAG + k] * spin + theta[BODY_DRAG + k] * speed
        if speed > 0.0:
            for j in range(3):
                shape[k, j] -= theta[BODY_DRAG + k] * w[k] * w[j] / speed
    w_by_v = r.T
    force_by_v = shape @ w_by_v
    world = r @ force_by_v
    for k in range(3):
        a[k, 3 + k] = 1.0
        for j in range(3):
            a[3 + k, 3 + j] = world[k, j]
            b[3 + k, n + j] = -world[k, j]
    turned = turn @ w_by_v
    for k in range(3):
        for j in range(3):
            a[10 + k, 3 + j] = turned[k, j]
            b[10 + k, n + j] = -turned[k, j]
    for c in range(4):
        w_by = turn_by[c].T @ air
        moved = turn_by[c] @ force + r @ (shape @ w_by)
        swung = turn @ w_by
        for k in range(3):
            a[3 + k, 6 + c] = moved[k]
            a[10 + k, 6 + c] = swung[k]
    a[6, 7:10] = -0.5 * rate
    a[7:10, 6] = 0.5 * rate
    a[7, 8] = 0.5 * rate[2]
    a[7, 9] = -0.5 * rate[1]
    a[8, 7] = -0.5 * rate[2]
    a[8, 9] = 0.5 * rate[0]
    a[9, 7] = 0.5 * rate[1]
    a[9, 8] = -0.5 * rate[0]
    a[6, 10:13] = -0.5 * q[1:4]
    a[7, 10] = 0.5 * q[0]
    a[7, 11] = -0.5 * q[3]
    a[7, 12] = 0.5 * q[2]
    a[8, 10] = 0.5 * q[3]
    a[8, 11] = 0.5 * q[0]
    a[8, 12] = -0.5 * q[1]
    a[9, 10] = -0.5 * q[2]
    a[9, 11] = 0.5 * q[1]
    a[9, 12] = 0.5 * q[0]
    for k in range(3):
        one = (k + 1) % 3
        other = (k + 2) % 3
        for j in range(3):
            a[10 + k, 10 + j] = arm * met[k, j]
        a[10 + k, 10 + k] -= theta[DAMPING + k] * spin
        b[10 + k, ARM] = damped[k]
        a[10 + k, 10 + one] += couple[k] * rate[other]
        a[10 + k, 10 + other] += couple[k] * rate[one]
        b[10 + k, TRIM + k] = 1.0
        b[10 + k, DAMPING + k] = -spin * rate[k]
        for i in range(m):
            b[10 + k, EFFECTS + k * m + i] = share[i]
        for j in range(3):
            b[3 + j, ROTOR_DRAG + k] = -r[j, k] * spin * w[k]
            b[3 + j, BODY_DRAG + k] = -r[j, k] * speed * w[k]
    for j in range(3):
        b[3 + j, THRUST] = r[j, 2] * lift
    b[10, LEAN] = spin * w[1]
    b[11, LEAN + 1] = spin * w[0]
    yawing = turn[2, 0] * w[0] + turn[2, 1] * w[1]
    b[10, ROTOR_DRAG + 2] = -per * hub[0] * w[2]
    b[11, ROTOR_DRAG + 2] = -per * hub[1] * w[2]
    b[12, ROTOR_DRAG + 1] = per * ry / rz * hub[1] * w[1]
    b[12, ROTOR_DRAG] = per / rz * hub[0] * w[0]
    b[10, THRUST] = -per * turn[0, 2] * w[2]
    b[11, THRUST] = -per * turn[1, 2] * w[2]
    b[12, THRUST] = -per * yawing
    drag = per * arm * theta[ROTOR_DRAG + 2]
    ahead = per * arm / rz * theta[ROTOR_DRAG] * rate[2]
    aside = per * arm / rz * theta[ROTOR_DRAG + 1] * ry * ry * rate[2]
    b[10, ROTOR_DRAG + 2] -= per * arm * (rolls * rate[0] + ry * both * rate[1])
    b[11, ROTOR_DRAG + 2] -= per * arm * (both * rate[0] + ry * pitches * rate[1])
    b[12, ROTOR_DRAG] -= per * arm / rz * rolls * rate[2]
    b[12, ROTOR_DRAG + 1] -= per * arm / rz * ry * ry * pitches * rate[2]
    for k in range(3):
        b[10 + k, THRUST] -= per * arm * damped[k]
    for i in range(m):
        root = np.sqrt(max(share[i], _LEAST_SHARE))
        one = theta[EFFECTS + i]
        other = theta[EFFECTS + m + i]
        b[10, EFFECTS + i] -= drag * root * (2.0 * one * rate[0] + ry * other * rate[1])
        b[11, EFFECTS + i] -= drag * root * other * rate[0]
        b[12, EFFECTS + i] -= 2.0 * ahead * root * one
        b[10, EFFECTS + m + i] -= drag * root * ry * one * rate[1]
        b[11, EFFECTS + m + i] -= drag * root * (one * rate[0] + 2.0 * ry * other * rate[1])
        b[12, EFFECTS + m + i] -= 2.0 * aside * root * other
        b[10, EFFECTS + i] -= per * theta[ROTOR_DRAG + 2] * w[2] * root
        b[12, EFFECTS + i] += per / rz * theta[ROTOR_DRAG] * w[0] * root
        b[11, EFFECTS + m + i] -= per * theta[ROTOR_DRAG + 2] * w[2] * root
        b[12, EFFECTS + m + i] += per * ry / rz * theta[ROTOR_DRAG + 1] * w[1] * root
    roll = rate[1] * rate[2]
    pitch = rate[2] * rate[0]
    yaw = rate[0] * rate[1]
    b[10, INERTIA] = roll - drag * both * rate[1]
    b[11, INERTIA] = -(rz - 1.0) / (ry * ry) * pitch - drag * pitches * rate[1]
    b[12, INERTIA] = -yaw / rz + turn[2, 1] * w[1] / ry - 2.0 * aside * pitches / ry
    b[10, INERTIA + 1] = -roll
    b[11, INERTIA + 1] = pitch / ry
    b[12, INERTIA + 1] = -(1.0 - ry) / (rz * rz) * yaw - (yawing + arm * damped[2]) / rz
    by_spin = np.empty(3)
    for k in range(3):
        by_spin[k] = -theta[ROTOR_DRAG + k] * w[k]
    by_spin = r @ by_spin
    for c in range(share_by.shape[0]):  # the numbers of the chain stand first
        for i in range(m):
            ds = share_by[c, i]
            root = 0.5 * ds / np.sqrt(share[i]) if share[i] > _LEAST_SHARE else 0.0
            for j in range(3):
                b[3 + j, c] += theta[THRUST] * r[j, 2] * ds + by_spin[j] * root
            for k in range(3):
                b[10 + k, c] += theta[EFFECTS + k * m + i] * ds - theta[DAMPING + k] * rate[k] * root
            one = theta[EFFECTS + i]
            other = theta[EFFECTS + m + i]
            tipping = one * rate[0] + ry * other * rate[1]
            b[10, c] -= drag * root * one * tipping
            b[11, c] -= drag * root * other * tipping
            b[12, c] -= root * (ahead * one * one + aside * other * other)
            left = per * one * root
            back = per * other * root
            b[10, c] += theta[LEAN] * root * w[1] - left * theta[ROTOR_DRAG + 2] * w[2]
            b[11, c] += theta[LEAN + 1] * root * w[0] - back * theta[ROTOR_DRAG + 2] * w[2]
            b[12, c] += back * ry / rz * theta[ROTOR_DRAG + 1] * w[1]
            b[12, c] += left / rz * theta[ROTOR_DRAG] * w[0]
    return d, a, b


@njit(cache=True)
def _run(start, start_by, halves, halves_by, dt, theta, wind, wanted):  # type: ignore[no-untyped-def]
    """(N, 13) states, and (N, 13, C) derivatives, C = numbers, wind, whatever moves the start."""
    rows = (halves.shape[0] + 1) // 2
    columns = start_by.shape[1]
    states = np.empty((rows, STATES))
    found = np.zeros((rows if wanted else 1, STATES, columns))
    x = start.copy()
    s = start_by.copy()
    states[0] = x
    if wanted:
        found[0] = s
    for row in range(rows - 1):
        first = 2 * row
        d1, a1, b1 = _derivative(x, halves[first], halves_by[:, first], theta, wind, wanted)
        x2 = x + 0.5 * dt * d1
        d2, a2, b2 = _derivative(x2, halves[first + 1], halves_by[:, first + 1], theta, wind, wanted)
        x3 = x + 0.5 * dt * d2
        d3, a3, b3 = _derivative(x3, halves[first + 1], halves_by[:, first + 1], theta, wind, wanted)
        x4 = x + dt * d3
        d4, a4, b4 = _derivative(x4, halves[first + 2], halves_by[:, first + 2], theta, wind, wanted)
        x = x + dt / 6.0 * (d1 + 2.0 * d2 + 2.0 * d3 + d4)
        if wanted:
            known = b1.shape[1]
            k1 = a1 @ s
            k1[:, :known] += b1
            k2 = a2 @ (s + 0.5 * dt * k1)
            k2[:, :known] += b2
            k3 = a3 @ (s + 0.5 * dt * k2)
            k3[:, :known] += b3
            k4 = a4 @ (s + dt * k3)
            k4[:, :known] += b4
            s = s + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        length = np.sqrt(x[6] * x[6] + x[7] * x[7] + x[8] * x[8] + x[9] * x[9])
        unit = x[6:10] / length
        x[6:10] = unit
        if wanted:
            inner = unit @ s[6:10]
            for i in range(4):
                s[6 + i] = (s[6 + i] - unit[i] * inner) / length
            found[row + 1] = s
        states[row + 1] = x
    return states, found


def run(
    start: FloatArray, halves: FloatArray, dt_s: float, theta: FloatArray, wind: FloatArray | None = None
) -> FloatArray:
    """(N, 13) states in free run.

    Parameters
    ----------
    start : (13,) state at the first sample.
    halves : (2N - 1, motors) thrust shares, see `actuators.shares`.
    wind : (3,) m/s, where the air moves to; None: it is calm.
    """
    calm = np.zeros(3) if wind is None else wind
    none = np.zeros((0, *halves.shape))
    states, _ = _run(start, np.zeros((STATES, 0)), halves, none, dt_s, theta, calm, False)
    return np.asarray(states)


def run_with_slopes(
    start: FloatArray,
    start_by: FloatArray,
    halves: FloatArray,
    halves_by: FloatArray,
    dt_s: float,
    theta: FloatArray,
    wind: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """As `run`, and exact derivatives.

    Parameters
    ----------
    start_by : (13, S) derivatives of the start by S numbers of its own.
    halves_by : (4, 2N - 1, motors) derivatives of the shares by the numbers of `actuators.CHAIN`.

    Returns
    -------
    (N, 13) states; (N, 13, P + 3 + S) derivatives by numbers, wind and the start's numbers.
    """
    first = np.hstack([np.zeros((STATES, len(theta) + WIND)), start_by])
    states, slopes = _run(start, first, halves, np.ascontiguousarray(halves_by), dt_s, theta, wind, True)
    return np.asarray(states), np.asarray(slopes)
