"""A run for each vehicle of a fleet.

Takagi-Sugeno models do not come from sums over flights: each run is what `flysid fit --vehicle V` makes, one
after another here, or one a worker of a cluster.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from flysid.errors import FlysidError
from flysid.files import replacing_folder
from flysid.ingest.align.recipe import recipe_text
from flysid.ingest.lake.chosen_flights import Selection, select
from flysid.ingest.lake.lake import Lake, mirror
from flysid.progress import part, tell
from flysid.validate.runs.fitting import fit_run
from flysid.validate.runs.run import FitSettings, Run, open_run

if TYPE_CHECKING:
    from flysid.fleet.cluster import Cluster


@dataclass(frozen=True)
class VehicleFit:
    """A vehicle's run to be made.

    `lake`: with the vehicle's flights alone.
    `recipe`: its text.
    `settings`: of the run, with the vehicle as its selection.
    """

    lake: Lake
    recipe: str
    settings: FitSettings

    @property
    def vehicle(self) -> str:
        return self.settings.selection.vehicle


def fit_vehicles(
    lake: Lake,
    recipe: str,
    output: Path,
    settings: FitSettings,
    vehicles: Sequence[str],
    jobs: int = 1,
    cluster: Cluster | None = None,
) -> dict[str, Run | str]:
    """A run for each vehicle, as `flysid fit --vehicle` makes it, or why there is none.

    `output`: a folder per vehicle is made in it (`folder_of`); those that are there already are replaced.
    `settings`: of every run; its selection is replaced by the vehicle's.
    `jobs`: channels at a time on this machine.
    `cluster`: makes the runs instead of this machine; the lake must have an address.
    """
    done: dict[str, Run | str] = {}
    fits: list[VehicleFit] = []
    text, _ = recipe_text(recipe)
    for vehicle in vehicles:
        selection = Selection(vehicle=vehicle)
        try:
            fits.append(VehicleFit(select(lake, selection), text, replace(settings, selection=selection)))
        except FlysidError as error:
            done[vehicle] = error.message
    runs = (
        _made_here(fits, recipe, output, jobs) if cluster is None else _made_elsewhere(fits, output, cluster)
    )
    return done | dict(runs)


def _made_here(
    fits: Sequence[VehicleFit], recipe: str, output: Path, jobs: int
) -> Iterator[tuple[str, Run | str]]:
    for i, fit in enumerate(fits):
        with part(i / len(fits), (i + 1) / len(fits)):
            try:
                target = output / folder_of(fit.vehicle)
                yield fit.vehicle, fit_run(fit.lake, recipe, target, fit.settings, jobs=jobs)
            except FlysidError as error:
                yield fit.vehicle, error.message


def _made_elsewhere(
    fits: Sequence[VehicleFit], output: Path, cluster: Cluster
) -> Iterator[tuple[str, Run | str]]:
    done = 0
    for fit, files in cluster.each(run_files, fits, _parts_of):
        done += 1
        tell(f"{done} of {len(fits)} vehicles", share=done / len(fits))
        if files is None or isinstance(files, str):
            yield fit.vehicle, files or "the processes that fitted it were killed"
            continue
        target = output / folder_of(fit.vehicle)
        with replacing_folder(target) as folder:
            for name, content in files.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(content)
        yield fit.vehicle, open_run(target)


def _parts_of(fit: VehicleFit) -> list[str]:
    return ["run", fit.recipe, repr(fit.settings), *(facts.sha256 for facts in fit.lake.facts)]


def run_files(fit: VehicleFit) -> Mapping[str, bytes] | str:
    """The files of a vehicle's run, made where only the lake's address is known; or why there is none."""
    lake = replace(fit.lake, folder=mirror(fit.lake.address, fit.lake.facts))
    with tempfile.TemporaryDirectory(prefix="flysid-run-") as scratch:
        run = Path(scratch) / "run"
        recipe = Path(scratch) / "recipe.toml"
        recipe.write_text(fit.recipe, "utf-8")
        try:
            fit_run(lake, str(recipe), run, fit.settings)
        except FlysidError as error:
            return error.message
        files = [path for path in run.rglob("*") if path.is_file()]
        return {path.relative_to(run).as_posix(): path.read_bytes() for path in files}


def folder_of(vehicle: str) -> str:
    """The folder of a vehicle's run: its name, with a digest where a folder cannot have all of it."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", vehicle).strip("-.") or "no-name"
    return plain if plain == vehicle else f"{plain}-{hashlib.sha256(vehicle.encode()).hexdigest()[:6]}"
