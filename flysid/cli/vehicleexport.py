"""What `flysid export VEHICLE --to TARGET` writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from flysid.cli.output import check_target, say

if TYPE_CHECKING:
    from flysid.sixdof.fitted import FittedVehicle

FILES: Mapping[str, str] = {
    "rotorpy": "vehicle_params.py",
    "casadi": "vehicle_model.py",
    "jax": "vehicle_model.py",
    "c": "vehicle.h",
    "sdf": "model.sdf",
}
"""Targets, and the file that is written where none is named."""


def is_vehicle(source: Path) -> bool:
    """Whether `flysid vehicle -o` wrote it."""
    from flysid.sixdof.fitted import FILE

    return source.name == FILE or (source / FILE).is_file()


def write_vehicle(
    source: Path, target: str, out: Path | None, mass_kg: float | None, arm_m: float | None, force: bool
) -> Path:
    """Write a vehicle for a target; returns the file.

    Raises
    ------
    UsageError : the file exists; mass or arm is not above zero. DataError, FormatError : no vehicle is there.
    """
    from flysid.export.vehicles.body import ARM_M, MASS_KG
    from flysid.export.vehicles.csource import vehicle_header
    from flysid.export.vehicles.portable import portable_source
    from flysid.export.vehicles.rotorpy import rotorpy_source
    from flysid.export.vehicles.sdf import sdf_model
    from flysid.files import write_atomically, writing_to
    from flysid.sixdof.fitted import load_vehicle

    vehicle = load_vehicle(source)
    path = out or Path(FILES[target])
    check_target(path, force)
    mass = MASS_KG if mass_kg is None else mass_kg
    arm = ARM_M if arm_m is None else arm_m
    writers: Mapping[str, Callable[[FittedVehicle], str]] = {
        "rotorpy": lambda v: rotorpy_source(v, mass, arm),
        "casadi": portable_source,
        "jax": portable_source,
        "c": vehicle_header,
        "sdf": lambda v: sdf_model(v, path.stem, mass, arm),
    }
    text = writers[target](vehicle)
    with writing_to(path):
        write_atomically(path, text.encode())
    if target in ("rotorpy", "sdf") and (mass_kg is None or arm_m is None):
        say(f"mass and arm are taken as {mass:g} kg and {arm:g} m: state them with --mass and --arm")
    return path
