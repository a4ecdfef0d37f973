"""The channel of a whole vehicle: of a recipe's signals, those that logs hold, and motors that turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import DataError, RecipeError
from flysid.ingest.align.align import align
from flysid.ingest.align.recipe import ChannelSpec, Recipe
from flysid.ingest.align.signals import Log, find_source, load_signal
from flysid.stretch import FloatArray

CHANNEL = "vehicle"
MOTOR = "motor"
VOLTAGE = "voltage"
INSTRUMENTS = {
    "gyro": ("gyro_x", "gyro_y", "gyro_z"),
    "accelerometer": ("acc_x", "acc_y", "acc_z"),
    "attitude": ("q_w", "q_x", "q_y", "q_z"),
    "velocity": ("v_x", "v_y", "v_z"),
    "position": ("p_x", "p_y", "p_z"),
}
"""Signals of an instrument are used together or not at all."""


@dataclass(frozen=True)
class VehicleData:
    """The dataset of a vehicle, and what its logs lack."""

    dataset: Dataset
    lacking: tuple[str, ...]


def vehicle_data(logs: Sequence[Log], recipe: Recipe) -> VehicleData:
    """All that the logs hold of a vehicle, on one grid.

    `recipe`: names signals as `sixdof` does.
    Raises RecipeError: the recipe names no motors, or a log has no motor or no gyro. Raises DataError: no
    motor turns; motors of one log are not in another; a stretch is too short.
    """
    _require_alike(logs, recipe)
    motors = [name for name in recipe.signals if name.startswith(MOTOR) and _in_all(logs, recipe, name)]
    turning = [name for name in motors if any(_turns(log, recipe, name) for log in logs)]
    if not motors:
        raise RecipeError(
            "no commands of motors are logged",
            hint="log the motors' outputs at 50 Hz or more; 'flysid recipes sixdof' lists their names",
        )
    if len(turning) < 2:
        raise DataError("no motors turn in these logs", hint="a flight, not a bench test without propellers")
    lacking = []
    outputs: list[str] = []
    for instrument, names in INSTRUMENTS.items():
        if all(name in recipe.signals and _measured(logs, recipe, name) for name in names):
            outputs += names
        else:
            lacking.append(instrument)
    if "gyro" in lacking:
        raise RecipeError("no gyro is logged", hint="log body rates at 50 Hz or more")
    inputs = list(turning)
    if VOLTAGE in recipe.signals and _measured(logs, recipe, VOLTAGE):
        inputs.append(VOLTAGE)
    else:
        lacking.append(VOLTAGE)
    channel = ChannelSpec(tuple(inputs), tuple(outputs))
    found = align(logs, replace(recipe, channels={CHANNEL: channel}), CHANNEL, may_stand=True)
    return VehicleData(found.dataset, tuple(lacking))


def _in_all(logs: Sequence[Log], recipe: Recipe, name: str) -> bool:
    return all(find_source(recipe.signals[name].sources, log) is not None for log in logs)


def _require_alike(logs: Sequence[Log], recipe: Recipe) -> None:
    """DataError where a motor turns in one log and another does not hold it: these are two vehicles."""
    for name in (name for name in recipe.signals if name.startswith(MOTOR)):
        without = [log for log in logs if find_source(recipe.signals[name].sources, log) is None]
        turning = [log for log in logs if log not in without and _turns(log, recipe, name)]
        if without and turning:
            raise DataError(
                f"{name} turns in {turning[0].name}, and {without[0].name} does not log it",
                hint="fit vehicles with as many motors each apart",
            )


def _measured(logs: Sequence[Log], recipe: Recipe, name: str) -> bool:
    """All logs hold numbers of the signal."""
    return _in_all(logs, recipe, name) and all(len(_finite(log, recipe, name)) > 0 for log in logs)


def _turns(log: Log, recipe: Recipe, name: str) -> bool:
    """The command changes: an output that is not used stays where it is."""
    values = _finite(log, recipe, name)
    return bool(len(values) and np.ptp(values) > 0.0)


def _finite(log: Log, recipe: Recipe, name: str) -> FloatArray:
    """(N,) finite samples of a signal over all boots."""
    loaded = load_signal(name, recipe.signals[name], log)
    values = [boot.x for boot in loaded.boots.values()]
    joined = np.concatenate(values) if values else np.zeros(0)
    return np.asarray(joined[np.isfinite(joined)])
