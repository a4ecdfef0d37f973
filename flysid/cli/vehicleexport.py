"""What `flysid export VEHICLE --to TARGET` writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from flysid.cli.output import check_target, say

if TYPE_CHECKING:
    from flysid.export.fmu import FMIVersion
    from flysid.sixdof.fitted import FittedVehicle

FILES: Mapping[str, str] = {
    "rotorpy": "vehicle_params.py",
    "casadi": "vehicle_model.py",
    "jax": "vehicle_model.py",
    "onnx": "vehicle.onnx",
    "c": "vehicle.h",
    "fmu": "vehicle.fmu",
    "sdf": "model.sdf",
    "px4-sih": "vehicle.params",
    "ardupilot": "frame.json",
    "jsbsim": "vehicle.xml",
    "betaflight": "vehicle_betaflight.c",
}
"""Targets, and the file that is written where none is named."""
IN_METRES = ("rotorpy", "sdf", "px4-sih", "ardupilot", "jsbsim")
"""Targets that want a mass and an arm."""


def is_vehicle(source: Path) -> bool:
    """Whether `flysid vehicle -o` wrote it."""
    from flysid.sixdof.fitted import FILE

    return source.name == FILE or (source / FILE).is_file()


def write_vehicle(
    source: Path,
    target: str,
    out: Path | None,
    mass_kg: float | None,
    arm_m: float | None,
    force: bool,
    fmi: FMIVersion = 2,
) -> Path:
    """Write a vehicle for a target; returns the file.

    `fmi`: version of an FMU.
    Raises UsageError: the file exists; mass or arm is not above zero; the target has no such vehicle.
    Raises StoreError: no vehicle is in the file.
    """
    from flysid.export.vehicles.body import ARM_M, MASS_KG
    from flysid.files import write_atomically, writing_to
    from flysid.sixdof.fitted import load_vehicle

    vehicle = load_vehicle(source)
    path = out or Path(FILES[target])
    check_target(path, force)
    mass = MASS_KG if mass_kg is None else mass_kg
    placed_m = vehicle.arm_m if arm_m is None else arm_m
    arm = ARM_M if placed_m is None else placed_m
    in_metres = target in IN_METRES
    content = _in_metres(vehicle, target, path.stem, mass, arm) if in_metres else _plain(vehicle, target, fmi)
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)
    if in_metres and (mass_kg is None or placed_m is None):
        say(f"mass and arm are taken as {mass:g} kg and {arm:g} m: state them with --mass and --arm")
    return path


def _in_metres(vehicle: FittedVehicle, target: str, name: str, mass: float, arm: float) -> bytes:
    """The file of a target whose vehicles have a mass and arms."""
    from flysid.export.vehicles.ardupilot import frame_file
    from flysid.export.vehicles.jsbsim import jsbsim_aircraft
    from flysid.export.vehicles.px4 import sih_file
    from flysid.export.vehicles.rotorpy import rotorpy_source
    from flysid.export.vehicles.sdf import sdf_model

    writers: Mapping[str, Callable[[], str]] = {
        "rotorpy": lambda: rotorpy_source(vehicle, mass, arm),
        "sdf": lambda: sdf_model(vehicle, name, mass, arm),
        "px4-sih": lambda: sih_file(vehicle, mass, arm),
        "ardupilot": lambda: frame_file(vehicle, mass, arm),
        "jsbsim": lambda: jsbsim_aircraft(vehicle, name, mass, arm),
    }
    return writers[target]().encode()


def _plain(vehicle: FittedVehicle, target: str, fmi: FMIVersion) -> bytes:
    """The file of a target that takes accelerations by commands as they are."""
    from flysid.export.vehicles.betaflight import betaflight_source
    from flysid.export.vehicles.csource import vehicle_header
    from flysid.export.vehicles.fmu import vehicle_fmu
    from flysid.export.vehicles.onnx import vehicle_onnx
    from flysid.export.vehicles.portable import portable_source

    if target == "onnx":
        return vehicle_onnx(vehicle)
    if target == "fmu":
        return vehicle_fmu(vehicle, version=fmi)
    write = {"c": vehicle_header, "betaflight": betaflight_source}.get(target, portable_source)
    return write(vehicle).encode()
