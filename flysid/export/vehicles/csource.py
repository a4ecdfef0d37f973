"""A vehicle as C99: one header with the numbers, a derivative and a step; no memory, nothing but math.h."""

from __future__ import annotations

from collections.abc import Iterable
from string import Template

from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import ARM, BODY_DRAG, CURVE, DAMPING, INERTIA, LAG, LEAN, ROTOR_DRAG, THRUST, TRIM
from flysid.sixdof.rigid_body import GRAVITY

TEMPLATE = """\
/* A vehicle identified by flysid. State: position 3, velocity 3, quaternion w x y z, body rate 3, motors.
   Axes are forward, left, up; the world's z points up. Inputs are the logged motor commands as shares of
   full scale, (command - $zero) / $full, after a delay of $delay s that is the caller's to add. */
#ifndef FLYSID_VEHICLE_H
#define FLYSID_VEHICLE_H
#include <math.h>

#define VEHICLE_MOTORS $motors
#define VEHICLE_STATES (13 + VEHICLE_MOTORS)

static const double vehicle_rotor_drag[3] = {$rotor_drag};
static const double vehicle_body_drag[3] = {$body_drag};
static const double vehicle_trim[3] = {$trim};
static const double vehicle_damping[3] = {$damping};
static const double vehicle_effects[3][VEHICLE_MOTORS] = {{$roll}, {$pitch}, {$yaw}};

/* d[13] of position, velocity, quaternion and rate, from x[13] and shares of full thrust. */
static inline void vehicle_body(const double *x, const double *share, const double *wind, double *d) {
  const double thrust = $thrust, ry = $ry, rz = $rz;
  const double w = x[6], p = x[7], q = x[8], s = x[9];
  const double r[3][3] = {
      {w * w + p * p - q * q - s * s, 2.0 * (p * q - w * s), 2.0 * (p * s + w * q)},
      {2.0 * (p * q + w * s), w * w - p * p + q * q - s * s, 2.0 * (q * s - w * p)},
      {2.0 * (p * s - w * q), 2.0 * (q * s + w * p), w * w - p * p - q * q + s * s}};
  double a[3], f[3], turn[3], lift = 0.0, spin = 0.0, hub[2] = {0.0, 0.0};
  for (int k = 0; k < 3; k++) {
    a[k] = 0.0;
    for (int j = 0; j < 3; j++) a[k] += r[j][k] * (x[3 + j] - wind[j]);
    turn[k] = vehicle_trim[k];
  }
  for (int i = 0; i < VEHICLE_MOTORS; i++) {
    const double root = sqrt(share[i] > 1e-9 ? share[i] : 1e-9);
    lift += share[i];
    spin += root;
    for (int k = 0; k < 3; k++) turn[k] += vehicle_effects[k][i] * share[i];
    for (int k = 0; k < 2; k++) hub[k] += vehicle_effects[k][i] * root / thrust;
    const double roll = vehicle_effects[0][i], pitch = ry * vehicle_effects[1][i];
    const double met = $arm / thrust * root, tipping = roll * x[10] + pitch * x[11];
    turn[0] -= met * vehicle_rotor_drag[2] * roll * tipping;
    turn[1] -= met * vehicle_rotor_drag[2] * vehicle_effects[1][i] * tipping;
    turn[2] -= met / rz * x[12]
               * (vehicle_rotor_drag[0] * roll * roll + vehicle_rotor_drag[1] * pitch * pitch);
  }
  const double speed = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
  for (int k = 0; k < 3; k++) {
    f[k] = -(vehicle_rotor_drag[k] * spin + vehicle_body_drag[k] * speed) * a[k];
    turn[k] -= vehicle_damping[k] * spin * x[10 + k];
  }
  f[2] += thrust * lift;
  for (int j = 0; j < 3; j++) {
    d[j] = x[3 + j];
    d[3 + j] = r[j][0] * f[0] + r[j][1] * f[1] + r[j][2] * f[2];
  }
  d[5] -= $gravity;
  d[6] = -0.5 * (p * x[10] + q * x[11] + s * x[12]);
  d[7] = 0.5 * (w * x[10] + q * x[12] - s * x[11]);
  d[8] = 0.5 * (w * x[11] - p * x[12] + s * x[10]);
  d[9] = 0.5 * (w * x[12] + p * x[11] - q * x[10]);
  d[10] = turn[0] + (ry - rz) * x[11] * x[12] + $lean_roll * spin * a[1]
          - vehicle_rotor_drag[2] * hub[0] * a[2];
  d[11] = turn[1] + (rz - 1.0) / ry * x[12] * x[10] + $lean_pitch * spin * a[0]
          - vehicle_rotor_drag[2] * hub[1] * a[2];
  d[12] = turn[2] + (1.0 - ry) / rz * x[10] * x[11]
          + vehicle_rotor_drag[1] * ry / rz * hub[1] * a[1] + vehicle_rotor_drag[0] / rz * hub[0] * a[0];
}

/* What a motor lifts at a command after lag, as a share of full thrust. */
static inline double vehicle_share(double command) {
  const double curve = $curve;
  return (1.0 - curve) * command + curve * command * command;
}

static inline void vehicle_unit(double *x) {
  const double length = sqrt(x[6] * x[6] + x[7] * x[7] + x[8] * x[8] + x[9] * x[9]);
  for (int i = 6; i < 10; i++) x[i] /= length;
}

static inline void vehicle_derivative(const double *x, const double *u, const double *wind, double *d) {
  double share[VEHICLE_MOTORS];
  for (int i = 0; i < VEHICLE_MOTORS; i++) {
    share[i] = vehicle_share(x[13 + i]);
    d[13 + i] = (u[i] - x[13 + i]) / $lag;
  }
  vehicle_body(x, share, wind, d);
}

/* x moves on by dt seconds: one Runge-Kutta step, the quaternion brought back to length 1. */
static inline void vehicle_step(double *x, const double *u, const double *wind, double dt) {
  static const double part[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
  double sum[VEHICLE_STATES] = {0.0}, d[VEHICLE_STATES] = {0.0}, y[VEHICLE_STATES];
  for (int k = 0; k < 4; k++) {
    for (int i = 0; i < VEHICLE_STATES; i++) y[i] = x[i] + part[k] * dt * d[i];
    vehicle_derivative(y, u, wind, d);
    for (int i = 0; i < VEHICLE_STATES; i++) sum[i] += weight[k] * d[i];
  }
  for (int i = 0; i < VEHICLE_STATES; i++) x[i] += dt / 6.0 * sum[i];
  vehicle_unit(x);
}
#endif
"""


def vehicle_header(vehicle: FittedVehicle) -> str:
    """`vehicle.h`, as text."""
    theta = vehicle.theta
    roll, pitch, yaw = layout.effects(theta).tolist()
    values = {
        "rotor_drag": _list(theta[ROTOR_DRAG : ROTOR_DRAG + 3].tolist()),
        "body_drag": _list(theta[BODY_DRAG : BODY_DRAG + 3].tolist()),
        "damping": _list(theta[DAMPING : DAMPING + 3].tolist()),
        "lean_pitch": _number(theta[LEAN + 1]),
        "lean_roll": _number(theta[LEAN]),
        "gravity": _number(GRAVITY),
        "arm": _number(theta[ARM]),
        "thrust": _number(theta[THRUST]),
        "motors": str(vehicle.motors),
        "curve": _number(theta[CURVE]),
        "pitch": _list(pitch),
        "delay": f"{theta[layout.DELAY]:.4g}",
        "trim": _list(theta[TRIM : TRIM + 3].tolist()),
        "roll": _list(roll),
        "zero": f"{vehicle.zero:g}",
        "full": f"{vehicle.full:g}",
        "yaw": _list(yaw),
        "lag": _number(theta[LAG]),
        "ry": _number(theta[INERTIA]),
        "rz": _number(theta[INERTIA + 1]),
    }
    return Template(TEMPLATE).substitute(values)


def _number(value: float) -> str:
    """A double that C reads back as the same."""
    text = repr(float(value))
    return text if any(c in text for c in ".en") else f"{text}.0"


def _list(values: Iterable[float]) -> str:
    return ", ".join(_number(value) for value in values)
