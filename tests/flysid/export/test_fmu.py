"""FMUs against the models that they come from, by FMPy where it is installed, and by their own sources."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flysid.export.fmu import PLATFORMS, FMIVersion, fmu_bytes
from flysid.export.programs import program_of
from flysid.export.reference import run
from tests.flysid.export.compiled import gcc, needs_gcc
from tests.flysid.export.test_c import inputs
from tests.model_examples import fitted

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
pytestmark = needs_gcc


def slave(path: Path, place: Path, starts: Mapping[int, float] | None = None) -> Any:
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    told = fmpy.read_model_description(str(path))
    fmpy.extract(str(path), str(place))
    kind = FMU2Slave if told.fmiVersion == "2.0" else FMU3Slave
    model = told.coSimulation.modelIdentifier
    found = kind(guid=told.guid, unzipDirectory=str(place), modelIdentifier=model, instanceName="plant")
    found.instantiate()
    if told.fmiVersion == "2.0":
        found.setupExperiment(startTime=0.0)
        found.enterInitializationMode()
    else:
        found.enterInitializationMode(startTime=0.0)
    if starts:
        write = found.setReal if told.fmiVersion == "2.0" else found.setFloat64
        write(list(starts), list(starts.values()))
    found.exitInitializationMode()
    return found


def stepped(simulator: Any, u: np.ndarray, rows: range, dt_s: float) -> np.ndarray:
    """Outputs of some rows, each read before the step behind it."""
    second = hasattr(simulator, "setReal")
    found = []
    for k in rows:
        (simulator.setReal if second else simulator.setFloat64)([0], [u[k, 0]])
        found.append((simulator.getReal if second else simulator.getFloat64)([1]))
        simulator.doStep(k * dt_s, dt_s)
    return np.array(found)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    "name", ["ts", "oe", "ts_ss", "static ts", "statespace, late input", "multirotor", "polynarx"]
)
def test_an_fmu_is_valid_small_and_equals_the_program_exactly_from_rest_and_after_a_kept_state(
    name: str, version: FMIVersion, tmp_path: Path
) -> None:
    from fmpy.validation import validate_fmu

    program = program_of(fitted(name))
    path = tmp_path / "plant.fmu"
    path.write_bytes(fmu_bytes(program, "plant", version=version))
    assert path.read_bytes() == fmu_bytes(program, "plant", version=version)
    assert path.stat().st_size < 100_000
    assert validate_fmu(str(path)) == []
    simulator = slave(path, tmp_path / "unpacked")
    u = inputs(fitted(name), 300)
    expected = run(program, u)[0]

    def runs(rows: range) -> np.ndarray:
        return stepped(simulator, u, rows, program.dt_s)

    assert np.array_equal(runs(range(100)), expected[:100])
    kept = simulator.getFMUState()
    stored = simulator.serializeFMUState(kept)
    assert np.array_equal(runs(range(100, 200)), expected[100:200])
    simulator.setFMUState(kept)
    assert np.array_equal(runs(range(100, 200)), expected[100:200])
    simulator.setFMUState(simulator.deserializeFMUState(stored))
    assert np.array_equal(runs(range(100, 300)), expected[100:])
    simulator.reset()
    assert np.array_equal(runs(range(100)), expected[:100])
    with pytest.raises(Exception, match=r"DoStep"):
        simulator.doStep(0.0, 0.4 * program.dt_s)


def test_simulate_fmu_reads_an_output_one_sample_late_as_fmi_says(tmp_path: Path) -> None:
    program = program_of(fitted("ts"))
    path = tmp_path / "plant.fmu"
    path.write_bytes(fmu_bytes(program, "plant"))
    u = inputs(fitted("ts"), 200)
    h = program.dt_s
    given = np.array([(k * h, u[k, 0]) for k in range(len(u))], dtype=[("time", "f8"), ("u", "f8")])
    given.dtype.names = ("time", program.inputs[0].name)
    found = fmpy.simulate_fmu(
        str(path), stop_time=(len(u) - 1) * h, output_interval=h, step_size=h, input=given
    )
    told = np.array([row[1] for row in found])
    assert np.array_equal(told, run(program, u)[0][: len(told), 0])


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["ts", "oe", "statespace, late input"])
def test_a_run_starts_from_any_past_that_is_set(name: str, version: FMIVersion, tmp_path: Path) -> None:
    program = program_of(fitted(name))
    path = tmp_path / "plant.fmu"
    path.write_bytes(fmu_bytes(program, "plant", version=version))
    u = inputs(fitted(name), 200)
    memory = run(program, u[:80])[1]
    simulator = slave(path, tmp_path / "unpacked")
    places = list(range(2, 2 + len(memory)))
    (simulator.setReal if version == 2 else simulator.setFloat64)(places, list(memory))
    found = (simulator.getReal if version == 2 else simulator.getFloat64)(places)
    assert np.allclose(found, memory, rtol=1e-14, atol=1e-14)
    assert np.array_equal(
        stepped(simulator, u, range(80, 200), program.dt_s), run(program, u[80:], memory)[0]
    )


@pytest.mark.parametrize("version", [2, 3])
def test_it_builds_from_its_own_sources(version: FMIVersion, tmp_path: Path) -> None:
    path = tmp_path / "plant.fmu"
    path.write_bytes(fmu_bytes(program_of(fitted("ts")), "plant", version=version))
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    sources = tmp_path / "sources"
    flags = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror")
    gcc(
        *flags,
        "-ffp-contract=off",
        "-shared",
        "-fPIC",
        "-o",
        tmp_path / "again.so",
        *sources.glob("*.c"),
        "-lm",
    )
    assert (tmp_path / "binaries" / PLATFORMS[version] / "plant.so").is_file()


def test_without_a_binary_only_the_sources_are_inside(tmp_path: Path) -> None:
    path = tmp_path / "plant.fmu"
    path.write_bytes(fmu_bytes(program_of(fitted("ts")), "plant", binary=False))
    with zipfile.ZipFile(path) as archive:
        assert not [name for name in archive.namelist() if name.startswith("binaries")]
        assert "sources/fmi2.c" in archive.namelist()
