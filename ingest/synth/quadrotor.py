"""Compiled equations of motion of a quadcopter with its inner loop, and their Runge-Kutta integration.

Axes: world x forward, y to the left, z up; body the same at rest. Angles turn in the order Z (psi), X (phi),
Y (theta), as in the paper's equation (8), so that positive theta drives along +x and positive phi along -y.

State (26): 0-2 position; 3-5 velocity; 6-8 phi, theta, psi; 9-11 body rates p, q, r (these twelve are the
paper's); 12-15 rotor speeds; 16, 17 tilt references theta, phi; 18, 19 slow parts of the velocity assist,
forward and right; 20-23 climb reference, equation (12) in controllable canonical form; 24 integral of the
climb error; 25 battery charge used, as a fraction.
Input (7): theta_in, phi_in (rad), vz_in (m/s, up), yaw rate (rad/s, to the left), wind x, y, z (m/s, world).

SI units throughout. Effects are switched by values of `Physics`; see `rigid_body` for parameters and sources.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flysid.compiling import njit

STATES = 26
ROTORS = 4
INPUTS = 7


class Physics(NamedTuple):
    """Every number of the equations. Compiled code takes `packed()`: a record compiles four times faster.

    `m`, `g`, `l`: mass, gravity, arm.
    `load`, `lift`, `rotor_1`: true mass over m; thrust of all rotors, and of the front one beside, over what
        their speed should give. The inner loop knows of none.
    `ixx`, `iyy`, `izz`: moments of inertia. `k_f`, `k_m`: thrust and torque per squared rotor speed.
    `drag_x`, `drag_y`, `drag_z`: linear (blade) drag per mass, 1/s. `quad_xy`, `quad_z`: quadratic, 1/m.
    `gyro`: 1 with gyroscopic torques. `j_rotor`: inertia of one rotor.
    `ground_radius`: rotor radius of the ground effect, 0 for none.
    `motor_tau`: motor lag, 0 for none. `rotor_min`, `rotor_max`: rotor speeds.
    `drain`: charge used per second of hover. `sag`, `droop`: voltage lost with charge and with load.
    `rotor_hover`: rotor speed of hover.
    `tilt_max`, `climb_max`: limits of the commands.
    `tilt_hold`: 1 when thrust is raised against tilt.
    `pitch_gain`, `pitch_tau`, `pitch_kp`, `pitch_ki`, `pitch_leak`: longitudinal loop; roll_... : lateral
        loop.
    `assist_max`: largest tilt of the velocity assist.
    `att_w`, `att_z`, `yaw_k`: attitude loop. `climb_kp`, `climb_ki`, `climb_i_max`, `climb_lead`: climb loop.
    `c0`, `c1`, `c2`, `a0`, `a1`, `a2`, `a3`: equation (12), numerator and denominator from the constant up.
    """

    m: float
    load: float
    lift: float
    rotor_1: float
    g: float
    l: float  # noqa: E741
    ixx: float
    iyy: float
    izz: float
    k_f: float
    k_m: float
    drag_x: float
    drag_y: float
    drag_z: float
    quad_xy: float
    quad_z: float
    gyro: float
    j_rotor: float
    ground_radius: float
    motor_tau: float
    rotor_min: float
    rotor_max: float
    drain: float
    sag: float
    droop: float
    rotor_hover: float
    tilt_max: float
    climb_max: float
    tilt_hold: float
    pitch_gain: float
    pitch_tau: float
    pitch_kp: float
    pitch_ki: float
    pitch_leak: float
    roll_gain: float
    roll_tau: float
    roll_kp: float
    roll_ki: float
    roll_leak: float
    assist_max: float
    att_w: float
    att_z: float
    yaw_k: float
    climb_kp: float
    climb_ki: float
    climb_i_max: float
    climb_lead: float
    c0: float
    c1: float
    c2: float
    a0: float
    a1: float
    a2: float
    a3: float

    def packed(self) -> np.void:
        """The same as a NumPy record."""
        dtype = np.dtype([(name, np.float64) for name in self._fields])
        record: np.void = np.array([tuple(self)], dtype=dtype)[0]
        return record


@njit(cache=True)
def airframe(x, w1, w2, w3, w4, wx, wy, wz, f, out):  # type: ignore[no-untyped-def]
    """out[:12] = rates of the rigid body at rotor speeds w1..w4 in wind; (8), (9) and the effects."""
    sp = math.sin(x[6])
    cp = math.cos(x[6])
    st = math.sin(x[7])
    ct = math.cos(x[7])
    ss = math.sin(x[8])
    cs = math.cos(x[8])
    r11 = cs * ct - sp * ss * st
    r12 = -cp * ss
    r13 = cs * st + ct * sp * ss
    r21 = ct * ss + cs * sp * st
    r22 = cp * cs
    r23 = ss * st - cs * ct * sp
    r31 = -cp * st
    r32 = sp
    r33 = cp * ct
    s1 = f.lift * f.rotor_1 * w1 * w1
    s2 = f.lift * w2 * w2
    s3 = f.lift * w3 * w3
    s4 = f.lift * w4 * w4
    lift = f.k_f * (s1 + s2 + s3 + s4) / (f.m * f.load)
    if f.ground_radius > 0.0:  # Cheeseman and Bennett (1955), no nearer than one radius
        ratio = f.ground_radius / (4.0 * max(x[2], f.ground_radius))
        lift /= 1.0 - ratio * ratio
    vx = x[3] - wx
    vy = x[4] - wy
    vz = x[5] - wz
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    dx = -(f.drag_x + f.quad_xy * speed) * (r11 * vx + r21 * vy + r31 * vz)
    dy = -(f.drag_y + f.quad_xy * speed) * (r12 * vx + r22 * vy + r32 * vz)
    dz = -(f.drag_z + f.quad_z * speed) * (r13 * vx + r23 * vy + r33 * vz) + lift
    out[0], out[1], out[2] = x[3], x[4], x[5]
    out[3] = r11 * dx + r12 * dy + r13 * dz
    out[4] = r21 * dx + r22 * dy + r23 * dz
    out[5] = r31 * dx + r32 * dy + r33 * dz - f.g
    p = x[9]
    q = x[10]
    r = x[11]
    turn = (ct * r - st * p) / cp
    out[6] = ct * p + st * r
    out[7] = q - sp * turn
    out[8] = turn
    spin = f.j_rotor * (w2 + w4 - w1 - w3)
    mx = f.l * f.k_f * (s2 - s4) - f.gyro * ((f.izz - f.iyy) * q * r + q * spin)
    my = f.l * f.k_f * (s3 - s1) - f.gyro * ((f.ixx - f.izz) * r * p - p * spin)
    mz = f.k_m * (s1 - s2 + s3 - s4) - f.gyro * (f.iyy - f.ixx) * p * q
    out[9] = mx / f.ixx
    out[10] = my / f.iyy
    out[11] = mz / f.izz


@njit(cache=True)
def _clip(value, bound):  # type: ignore[no-untyped-def]
    return min(max(value, -bound), bound)


@njit(cache=True)
def _told(square, f):  # type: ignore[no-untyped-def]
    """Commanded speed of a motor, within its limits."""
    return min(max(math.sqrt(max(square, 0.0)), f.rotor_min), f.rotor_max)


@njit(cache=True)
def rates(x, u, f, out):  # type: ignore[no-untyped-def]
    """out (30,) = dx/dt of vehicle and inner loop at input u, then the commanded motor speeds."""
    ss = math.sin(x[8])
    cs = math.cos(x[8])
    ahead = cs * x[3] + ss * x[4]
    right = ss * x[3] - cs * x[4]
    # tilt references: shaped command less the velocity assist, whose authority is limited
    lean = math.tanh((f.pitch_kp * ahead + f.pitch_ki * x[18]) / f.assist_max) * f.assist_max
    bank = math.tanh((f.roll_kp * right + f.roll_ki * x[19]) / f.assist_max) * f.assist_max
    out[16] = (f.pitch_gain * _clip(u[0], f.tilt_max) - lean - x[16]) / f.pitch_tau
    out[17] = (f.roll_gain * _clip(u[1], f.tilt_max) - bank - x[17]) / f.roll_tau
    out[18] = ahead - f.pitch_leak * x[18]
    out[19] = right - f.roll_leak * x[19]
    # climb reference: equation (12)
    climb = _clip(u[2], f.climb_max)
    out[20] = climb - f.a3 * x[20] - f.a2 * x[21] - f.a1 * x[22] - f.a0 * x[23]
    out[21], out[22], out[23] = x[20], x[21], x[22]
    error = f.c2 * x[21] + f.c1 * x[22] + f.c0 * x[23] - x[5]
    wound = (x[24] > f.climb_i_max and error > 0.0) or (x[24] < -f.climb_i_max and error < 0.0)
    out[24] = 0.0 if wound else error
    wanted = f.c2 * out[21] + f.c1 * out[22] + f.c0 * out[23]
    jerk = f.c2 * out[20] + f.c1 * out[21] + f.c0 * out[22]
    want = f.g + wanted + f.climb_lead * jerk + f.climb_kp * error + f.climb_ki * x[24]
    if f.tilt_hold > 0.0:
        want /= max(math.cos(x[6]) * math.cos(x[7]), 0.5)
    # attitude loop and mixer: equation (9) solved for the squared speeds
    w2 = f.att_w * f.att_w
    damp = 2.0 * f.att_z * f.att_w
    mx = f.ixx * (w2 * (x[17] - x[6]) + damp * (out[17] - x[9])) / (2.0 * f.l * f.k_f)
    my = f.iyy * (w2 * (x[16] - x[7]) + damp * (out[16] - x[10])) / (2.0 * f.l * f.k_f)
    mz = f.izz * f.yaw_k * (u[3] - x[11]) / (4.0 * f.k_m)
    base = f.m * max(want, 0.0) / (4.0 * f.k_f)
    load = (x[12] ** 3 + x[13] ** 3 + x[14] ** 3 + x[15] ** 3) / (4.0 * f.rotor_hover**3)
    out[25] = f.drain * load
    volts = 1.0 - f.sag * x[25] - f.droop * (load - 1.0)
    out[26] = _told(base - my + mz, f)
    out[27] = _told(base + mx - mz, f)
    out[28] = _told(base + my + mz, f)
    out[29] = _told(base - mx - mz, f)
    n1 = volts * out[26]
    n2 = volts * out[27]
    n3 = volts * out[28]
    n4 = volts * out[29]
    if f.motor_tau > 0.0:
        out[12], out[13] = (n1 - x[12]) / f.motor_tau, (n2 - x[13]) / f.motor_tau
        out[14], out[15] = (n3 - x[14]) / f.motor_tau, (n4 - x[15]) / f.motor_tau
        airframe(x, x[12], x[13], x[14], x[15], u[4], u[5], u[6], f, out)
    else:
        out[12:16] = 0.0
        airframe(x, n1, n2, n3, n4, u[4], u[5], u[6], f, out)


@njit(cache=True)
def integrate(x, inputs, f, dt, hold, record):  # type: ignore[no-untyped-def]
    """Classical Runge-Kutta of order 4 at step dt; x (26,) is moved to the end.

    Each row of inputs (M, 7) is held for `hold` steps; record (M * hold // every, 30) takes the state before
    every `every`-th step, and what the motors are told then, with every = M * hold // len(record).
    """
    n = x.size
    every = inputs.shape[0] * hold // record.shape[0]
    k1 = np.empty(n + 4)
    k2 = np.empty(n + 4)
    k3 = np.empty(n + 4)
    k4 = np.empty(n + 4)
    y = np.empty(n)
    step = 0
    for row in range(inputs.shape[0]):
        u = inputs[row]
        for _ in range(hold):
            rates(x, u, f, k1)
            if step % every == 0:
                record[step // every, :n] = x
                record[step // every, n:] = k1[n:]
            for i in range(n):
                y[i] = x[i] + 0.5 * dt * k1[i]
            rates(y, u, f, k2)
            for i in range(n):
                y[i] = x[i] + 0.5 * dt * k2[i]
            rates(y, u, f, k3)
            for i in range(n):
                y[i] = x[i] + dt * k3[i]
            rates(y, u, f, k4)
            for i in range(n):
                x[i] += dt / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
            step += 1
