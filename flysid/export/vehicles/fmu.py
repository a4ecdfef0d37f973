"""A vehicle as an FMU: co-simulation with the steps of `FittedVehicle.simulate`, delay and lag included.

Inputs are the logged motor commands in the log's own unit, voltage and wind. Commands hold from sample to
sample, and motors are settled at the first ones. The state can be set before a run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from string import Template
from typing import Any

import numpy as np

from flysid.export.fmu import FMIVersion, packed
from flysid.export.fmu_facts import Facts, Variable
from flysid.export.vehicles.csource import vehicle_header
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import DELAY, LAG, POWER
from flysid.sixdof.rigid_body import STATES
from flysid.version import __version__

NAME = "vehicle_fmu"
STATE = (
    *((f"position_{axis}", "m") for axis in "xyz"),
    *((f"velocity_{axis}", "m/s") for axis in "xyz"),
    *((f"quaternion_{axis}", "1") for axis in "wxyz"),
    *((f"rate_{axis}", "rad/s") for axis in "xyz"),
)
LEVEL_PLACE = 6
"""Of the quaternion's w, which is 1 where a vehicle stands level."""

_HEADER = """\
#ifndef VEHICLE_FMU_H
#define VEHICLE_FMU_H
#include <stdint.h>

#include "vehicle.h"

#define VEHICLE_FMU_INPUTS (VEHICLE_MOTORS + 4U)
#define VEHICLE_FMU_OUTPUTS 13U
#define VEHICLE_FMU_MEMORY 13U
#define VEHICLE_FMU_QUEUE $queue

typedef struct {
  double cell[VEHICLE_FMU_OUTPUTS];          /* position, velocity, quaternion, rate */
  double motor[VEHICLE_MOTORS];              /* commands after delay and lag */
  double queue[VEHICLE_FMU_QUEUE][VEHICLE_MOTORS]; /* commands, the present one first */
  double given[VEHICLE_MOTORS + 4];          /* commands, voltage, wind */
  int flown;
} vehicle_fmu_state;

void vehicle_fmu_reset(vehicle_fmu_state *s);
void vehicle_fmu_output(vehicle_fmu_state *s, const double *u, double *y);
void vehicle_fmu_advance(vehicle_fmu_state *s);
#endif
"""

_SOURCE = """\
#include "vehicle_fmu.h"

#include <string.h>

/* Of either half of a sample: which commands act at its ends, and for how long the second does, s. */
static const int first_of[2] = {$first}, last_of[2] = {$last};
static const double rest_of[2] = {$rest};

void vehicle_fmu_reset(vehicle_fmu_state *s) {
  memset(s, 0, sizeof *s);
  s->cell[6] = 1.0;
}

void vehicle_fmu_output(vehicle_fmu_state *s, const double *u, double *y) {
  memcpy(s->given, u, sizeof s->given);
  memcpy(y, s->cell, sizeof s->cell);
}

static void move_motors(vehicle_fmu_state *s, int half, double *share) {
  const double fade = exp(-$half / $lag), late = exp(-rest_of[half] / $lag);
  for (int i = 0; i < VEHICLE_MOTORS; i++) {
    const double a = s->queue[first_of[half]][i], b = s->queue[last_of[half]][i];
    s->motor[i] = s->motor[i] * fade + a * (late - fade) + b * (1.0 - late);
    share[i] = vehicle_share(s->motor[i]);
  }
}

/* One Runge-Kutta step of a sample. */
void vehicle_fmu_advance(vehicle_fmu_state *s) {
  static const double part[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
  const double *const wind = s->given + VEHICLE_MOTORS + 1;
  const double volts = s->given[VEHICLE_MOTORS];
  const double factor = $factor;
  double share[3][VEHICLE_MOTORS], sum[13] = {0.0}, d[13] = {0.0}, y[13];
  const double *const at[4] = {share[0], share[1], share[1], share[2]};
  memmove(s->queue[1], s->queue[0], sizeof s->queue - sizeof s->queue[0]);
  for (int i = 0; i < VEHICLE_MOTORS; i++) {
    const double given = (s->given[i] - $zero) / $full;
    s->queue[0][i] = factor * (given > 1.0 ? 1.0 : given > 0.0 ? given : 0.0);
  }
  if (!s->flown) {
    for (int j = 1; j < VEHICLE_FMU_QUEUE; j++) memcpy(s->queue[j], s->queue[0], sizeof s->queue[0]);
    memcpy(s->motor, s->queue[0], sizeof s->motor);
    vehicle_unit(s->cell);
    s->flown = 1;
  }
  for (int i = 0; i < VEHICLE_MOTORS; i++) share[0][i] = vehicle_share(s->motor[i]);
  move_motors(s, 0, share[1]);
  move_motors(s, 1, share[2]);
  for (int k = 0; k < 4; k++) {
    for (int i = 0; i < 13; i++) y[i] = s->cell[i] + part[k] * $dt * d[i];
    vehicle_body(y, at[k], wind, d);
    for (int i = 0; i < 13; i++) sum[i] += weight[k] * d[i];
  }
  for (int i = 0; i < 13; i++) s->cell[i] += $dt / 6.0 * sum[i];
  vehicle_unit(s->cell);
}
"""


def vehicle_fmu(vehicle: FittedVehicle, *, version: FMIVersion = 2, binary: bool = True) -> bytes:
    """The archive; the same bytes each time by the same compiler.

    `binary`: compile it for this machine where it is a 64-bit Linux with a C compiler.
    Raises FitError: the compiler refuses its sources.
    """
    sources = {
        f"{NAME}.c": Template(_SOURCE).substitute(_values(vehicle)),
        f"{NAME}.h": Template(_HEADER).substitute(queue=_queue(vehicle)),
        "vehicle.h": vehicle_header(vehicle),
    }
    values = {
        "name": NAME,
        "NAME": NAME.upper(),
        "made": f"Written by flysid {__version__}.",
        "memory": [name for name, _ in STATE],
        "memory_at": range(STATES),
        "memory_shift": np.zeros(STATES),
        "memory_scale": np.ones(STATES),
    }
    words = " ".join((__doc__ or "").split())
    return packed(sources, _facts(vehicle), values, (words,), version=version, binary=binary)


def _facts(vehicle: FittedVehicle) -> Facts:
    """What the standard wants described."""
    given = {"causality": "input", "variability": "discrete"}
    made = {"causality": "output", "variability": "discrete", "initial": "calculated"}
    held = {"causality": "local", "variability": "discrete", "initial": "exact"}
    inputs = [Variable(f"motor{i + 1}", "", given, {"start": "0"}) for i in range(vehicle.motors)]
    inputs.append(Variable("voltage", "V", given, {"start": "0"}))
    inputs += [Variable(f"wind_{axis}", "m/s", given, {"start": "0"}) for axis in "xyz"]
    outputs = [Variable(name, unit, made, {}) for name, unit in STATE]
    starts = [
        Variable(f"{name}(k)", unit, held, {"start": "1.0" if place == LEVEL_PLACE else "0.0"})
        for place, (name, unit) in enumerate(STATE)
    ]
    about = (
        f"A vehicle identified by flysid. Motor commands are those of the log: {vehicle.zero:g} stops, "
        f"{vehicle.zero + vehicle.full:g} is full scale. A voltage of 0 is the reference's."
    )
    places = range(len(inputs), len(inputs) + len(outputs))
    return Facts(NAME, about, vehicle.dt_s, (*inputs, *outputs, *starts), places, ())


def _switches(vehicle: FittedVehicle) -> list[tuple[int, int, float]]:
    """Of either half of a sample: first and last command that act, in samples ago; seconds since the last."""
    half = 0.5 * vehicle.dt_s
    late = float(vehicle.theta[DELAY]) / vehicle.dt_s
    found = []
    for j in (0, 1):
        first = math.floor(0.5 * j - late - 1e-9)
        last = math.ceil(0.5 * (j + 1) - late - 1e-9) - 1
        rest = half if last == first else (0.5 * (j + 1) - late - last) * vehicle.dt_s
        found.append((-first, -last, rest))
    return found


def _queue(vehicle: FittedVehicle) -> int:
    return 1 + max(first for first, _, _ in _switches(vehicle))


def _values(vehicle: FittedVehicle) -> Mapping[str, Any]:
    first, last, rest = zip(*_switches(vehicle), strict=True)
    volts = f"(volts > 0.0 ? pow(volts / {vehicle.reference_v!r}, {float(vehicle.theta[POWER])!r}) : 1.0)"
    return {
        "first": ", ".join(map(str, first)),
        "last": ", ".join(map(str, last)),
        "rest": ", ".join(map(repr, rest)),
        "half": repr(0.5 * vehicle.dt_s),
        "dt": repr(vehicle.dt_s),
        "lag": repr(float(vehicle.theta[LAG])),
        "zero": repr(vehicle.zero),
        "full": repr(vehicle.full),
        "factor": volts if np.isfinite(vehicle.reference_v) else "1.0 + 0.0 * volts",
    }
