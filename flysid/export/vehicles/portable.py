"""A vehicle as Python that needs neither flysid nor a certain array library: for CasADi, JAX and NumPy.

The module that is written holds the numbers, a derivative and a Runge-Kutta step, which take the library's
own arrays. For CasADi it makes a `casadi.Function`, which has gradients. The state is position, velocity,
quaternion w x y z, body rate and motor commands after their lag. Inputs are shares of full scale after the
delay.
"""

from __future__ import annotations

from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import (
    ARM,
    BODY_DRAG,
    CURVE,
    DAMPING,
    INERTIA,
    LAG,
    LEAN,
    POWER,
    ROTOR_DRAG,
    THRUST,
    TRIM,
)
from flysid.sixdof.rigid_body import GRAVITY

TEMPLATE = '''"""A vehicle identified by flysid.

The state is position 3, velocity 3, quaternion w x y z 4, body rate 3, motors {motors}. Axes are forward,
left, up; the world's z points up. Inputs are the logged motor commands as shares of full scale, which are
(command - {zero!r}) / {full!r}, after a delay of {delay!r} s that is the caller's to add.
They are meant at {volts}; at another voltage they act by the ratio of voltages to the
power of {power!r}.
"""

MOTORS = {motors}
DELAY_S = {delay!r}
LAG_S = {lag!r}
CURVE = {curve!r}
THRUST = {thrust!r}
ROTOR_DRAG = {rotor_drag!r}
BODY_DRAG = {body_drag!r}
TRIM = {trim!r}
DAMPING = {damping!r}
LEAN = {lean!r}
INERTIA = {inertia!r}
ARM = {arm!r}
ROLL = {roll!r}
PITCH = {pitch!r}
YAW = {yaw!r}
GRAVITY = {gravity!r}
TINY = 1e-9


def derivative(x, u, wind=(0.0, 0.0, 0.0), *, sqrt, stack, smallest=max):
    """dx/dt; sqrt, stack (of a list of numbers) and smallest (the larger of two) are the array library's."""
    qw, qx, qy, qz = x[6], x[7], x[8], x[9]
    wx, wy, wz = x[10], x[11], x[12]
    rows = (
        (qw * qw + qx * qx - qy * qy - qz * qz, 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)),
        (2.0 * (qx * qy + qw * qz), qw * qw - qx * qx + qy * qy - qz * qz, 2.0 * (qy * qz - qw * qx)),
        (2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), qw * qw - qx * qx - qy * qy + qz * qz),
    )
    air = [x[3 + j] - wind[j] for j in range(3)]
    a = [sum(rows[j][k] * air[j] for j in range(3)) for k in range(3)]
    speed = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + TINY * TINY)
    share = [(1.0 - CURVE) * x[13 + i] + CURVE * x[13 + i] * x[13 + i] for i in range(MOTORS)]
    root = [sqrt(smallest(s, TINY)) for s in share]
    spin = sum(root)
    force = [-(ROTOR_DRAG[k] * spin + BODY_DRAG[k] * speed) * a[k] for k in range(3)]
    force[2] = force[2] + THRUST * sum(share)
    moved = [sum(rows[j][k] * force[k] for k in range(3)) for j in range(3)]
    moved[2] = moved[2] - GRAVITY
    ry, rz = INERTIA
    hub_roll = sum(ROLL[i] * root[i] for i in range(MOTORS)) / THRUST
    hub_pitch = sum(PITCH[i] * root[i] for i in range(MOTORS)) / THRUST
    roll = TRIM[0] - DAMPING[0] * spin * wx + (ry - rz) * wy * wz
    roll = roll + LEAN[0] * spin * a[1] - ROTOR_DRAG[2] * hub_roll * a[2]
    pitch = TRIM[1] - DAMPING[1] * spin * wy + (rz - 1.0) / ry * wz * wx
    pitch = pitch + LEAN[1] * spin * a[0] - ROTOR_DRAG[2] * hub_pitch * a[2]
    yaw = TRIM[2] - DAMPING[2] * spin * wz + (1.0 - ry) / rz * wx * wy
    yaw = yaw + ROTOR_DRAG[1] * ry / rz * hub_pitch * a[1] + ROTOR_DRAG[0] / rz * hub_roll * a[0]
    tipping = [ROLL[i] * wx + ry * PITCH[i] * wy for i in range(MOTORS)]
    met = ARM / THRUST
    roll = roll - met * ROTOR_DRAG[2] * sum(root[i] * ROLL[i] * tipping[i] for i in range(MOTORS))
    pitch = pitch - met * ROTOR_DRAG[2] * sum(root[i] * PITCH[i] * tipping[i] for i in range(MOTORS))
    spread = [ROTOR_DRAG[0] * ROLL[i] ** 2 + ROTOR_DRAG[1] * (ry * PITCH[i]) ** 2 for i in range(MOTORS)]
    yaw = yaw - met / rz * wz * sum(root[i] * spread[i] for i in range(MOTORS))
    turns = [
        -0.5 * (qx * wx + qy * wy + qz * wz),
        0.5 * (qw * wx + qy * wz - qz * wy),
        0.5 * (qw * wy - qx * wz + qz * wx),
        0.5 * (qw * wz + qx * wy - qy * wx),
    ]
    swung = [
        roll + sum(ROLL[i] * share[i] for i in range(MOTORS)),
        pitch + sum(PITCH[i] * share[i] for i in range(MOTORS)),
        yaw + sum(YAW[i] * share[i] for i in range(MOTORS)),
    ]
    motors = [(u[i] - x[13 + i]) / LAG_S for i in range(MOTORS)]
    return stack([x[3], x[4], x[5], *moved, *turns, *swung, *motors])


def step(x, u, dt, wind=(0.0, 0.0, 0.0), **library):
    """The state after dt seconds: one Runge-Kutta step, the quaternion brought back to length 1."""
    k1 = derivative(x, u, wind, **library)
    k2 = derivative(x + 0.5 * dt * k1, u, wind, **library)
    k3 = derivative(x + 0.5 * dt * k2, u, wind, **library)
    k4 = derivative(x + dt * k3, u, wind, **library)
    y = x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    length = library["sqrt"](y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
    parts = [y[i] / length if 6 <= i < 10 else y[i] for i in range(13 + MOTORS)]
    return library["stack"](parts)


def numpy_library():
    """What `derivative` and `step` take for NumPy's arrays."""
    import numpy as np

    return {{"sqrt": np.sqrt, "stack": np.array, "smallest": np.maximum}}


def jax_library():
    """What `derivative` and `step` take for JAX's arrays."""
    import jax.numpy as jnp

    return {{"sqrt": jnp.sqrt, "stack": jnp.stack, "smallest": jnp.maximum}}


def casadi_library():
    """What `derivative` and `step` take for CasADi's symbols."""
    import casadi

    return {{"sqrt": casadi.sqrt, "stack": lambda parts: casadi.vertcat(*parts), "smallest": casadi.fmax}}


def casadi_function(dt=None):
    """casadi.Function of (x, u): the derivative, or the state dt seconds later."""
    import casadi

    x = casadi.SX.sym("x", 13 + MOTORS)
    u = casadi.SX.sym("u", MOTORS)
    library = casadi_library()
    y = derivative(x, u, **library) if dt is None else step(x, u, dt, **library)
    return casadi.Function("vehicle", [x, u], [y], ["x", "u"], ["y"])
'''


def portable_source(vehicle: FittedVehicle) -> str:
    """The module, as text."""
    theta = vehicle.theta
    roll, pitch, yaw = (tuple(row) for row in layout.effects(theta).tolist())

    def numbers(start: int, length: int) -> tuple[float, ...]:
        return tuple(float(x) for x in theta[start : start + length])

    return TEMPLATE.format(
        motors=vehicle.motors,
        zero=vehicle.zero,
        full=vehicle.full,
        volts=f"{vehicle.reference_v:.4g} V"
        if vehicle.reference_v == vehicle.reference_v
        else "the reference's",
        power=float(theta[POWER]),
        delay=float(theta[layout.DELAY]),
        lag=float(theta[LAG]),
        curve=float(theta[CURVE]),
        thrust=float(theta[THRUST]),
        rotor_drag=numbers(ROTOR_DRAG, 3),
        body_drag=numbers(BODY_DRAG, 3),
        trim=numbers(TRIM, 3),
        damping=numbers(DAMPING, 3),
        lean=numbers(LEAN, 2),
        inertia=numbers(INERTIA, 2),
        arm=float(theta[ARM]),
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        gravity=GRAVITY,
    )
