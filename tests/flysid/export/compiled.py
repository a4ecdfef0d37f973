"""Exported C, compiled and run from Python."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.export.csource import c_files
from flysid.export.program import Program

WARNINGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow"),
    *("-pedantic", "-Wvla", "-Werror"),
)
NAME = "plant"
HARNESS = """
#include "plant.c"
void run(const {real} *u, {real} *y, long rows, const {real} *memory);
void run(const {real} *u, {real} *y, long rows, const {real} *memory)
{{
    plant_state s;
    plant_reset(&s);
    {start}
    for (long k = 0; k < rows; k++) {{
        plant_step(&s, &u[k * {n_u}], &y[k * {n_y}]);
    }}
}}
"""
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


def gcc(*arguments: str | Path) -> None:
    """Raises AssertionError with gcc's words where it fails or warns."""
    done = subprocess.run(["gcc", *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr


def write_c(program: Program, folder: Path, *, single: bool = False) -> Path:
    """The files of an export."""
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in c_files(program, NAME, 0.0 if single else None).items():
        (folder / file).write_text(text)
    return folder


def run_in_c(
    program: Program,
    u: FloatArray,
    folder: Path,
    flags: Sequence[str] = ("-O2", "-ffp-contract=off"),
    memory: FloatArray | None = None,
    *,
    single: bool = False,
) -> FloatArray:
    """(N, n_y) outputs of the compiled export along u (N, n_u), from rest or from a memory."""
    write_c(program, folder, single=single)
    real, kind = ("float", np.float32) if single else ("double", np.float64)
    words = {
        "real": real,
        "n_u": len(program.inputs),
        "n_y": len(program.outputs),
        "start": "plant_set_state(&s, memory);" if memory is not None else "(void)memory;",
    }
    (folder / "harness.c").write_text(HARNESS.format(**words))
    library = folder / f"plant-{abs(hash((tuple(flags), memory is None, single)))}.so"
    gcc(*WARNINGS, *flags, "-shared", "-fPIC", "-o", library, folder / "harness.c", "-lm")
    given = np.ascontiguousarray(u, dtype=kind)
    start = np.ascontiguousarray([] if memory is None else memory, dtype=kind)
    found = np.empty((len(u), len(program.outputs)), dtype=kind)
    run = ctypes.CDLL(str(library)).run
    run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long, ctypes.c_void_p]
    run.restype = None
    run(given.ctypes.data, found.ctypes.data, len(u), start.ctypes.data)
    return found.astype(np.float64)
