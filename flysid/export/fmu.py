"""A program as an FMU: FMI 2.0 co-simulation with its sources inside, and a binary where there is a compiler.

The convention of samples. flysid's y(k) belongs to u(k) at the same time t_k; FMI's output after a step from
t_k stands at t_k + h. An output is therefore computed when it is read, from the inputs as they stand: after
the step with u(k), reading gives y(k+1). Where every input acts a sample late or later that is exact whatever
is set before; where y depends on the present u, the dependency is declared: set u(k+1) before y is read.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
import uuid
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from flysid.dataset import Signal
from flysid.errors import FitError
from flysid.export.csource import asked, c_files, rendered
from flysid.export.program import Program
from flysid.version import __version__

EPOCH = (2000, 1, 1, 0, 0, 0)  # dates would make every archive another one
PLATFORM = "linux64"


def fmu_bytes(program: Program, name: str, *, binary: bool = True) -> bytes:
    """The FMU; the same bytes each time by the same compiler.

    Parameters
    ----------
    name : model identifier, as `csource.identifier` makes it.
    binary : compile it for this machine where it is a 64-bit Linux with a C compiler.

    Raises
    ------
    FitError : the compiler refuses its sources.
    """
    texts = c_files(program, name)
    sources = {f: texts[f] for f in (f"{name}.c", f"{name}.h")}
    identity = str(uuid.uuid5(uuid.NAMESPACE_URL, "".join(sources.values())))
    words = {"guid": identity, "dt_exact": repr(float(program.dt_s))}
    sources["fmi2.c"] = rendered("fmi2.c.j2", program, name, words)
    files = {f"sources/{f}": text.encode() for f, text in sources.items()}
    files["modelDescription.xml"] = _description(program, name, identity)
    files["documentation/index.html"] = _documentation(program, name)
    compiler = shutil.which("cc") or shutil.which("gcc")
    if binary and compiler is not None:
        files[f"binaries/{PLATFORM}/{name}.so"] = _compiled(compiler, name, sources)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(files):
            archive.writestr(zipfile.ZipInfo(path, EPOCH), files[path], zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _compiled(compiler: str, name: str, sources: dict[str, str]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for file, text in sources.items():
            (place / file).write_text(text, "utf-8")
        options = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden", "-s")
        command = [compiler, *options, "-Wl,--build-id=none", "-o", "model.so", f"{name}.c", "fmi2.c", "-lm"]
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        if done.returncode:
            raise FitError(
                f"the FMU's sources were not compiled: {done.stderr[:300]}",
                hint="give it another C compiler as cc",
            )
        return (place / "model.so").read_bytes()


def _description(program: Program, name: str, identity: str) -> bytes:
    """modelDescription.xml of FMI 2.0."""
    inputs, outputs = _names(program)
    direct = sorted({c - program.n for c, lag in asked(program) if lag == 0 and c >= program.n})
    about = (
        f"{program.title}, one step every {program.dt_s:.9g} s. Reading an output computes it from the "
        "inputs as they stand; from rest: inputs and outputs were zero. A model of past flights."
    )
    head = {
        "fmiVersion": "2.0",
        "modelName": name,
        "guid": identity,
        "description": about,
        "generationTool": f"flysid {__version__}",
        "variableNamingConvention": "flat",
        "numberOfEventIndicators": "0",
    }
    root = ElementTree.Element("fmiModelDescription", head)
    can = ("canGetAndSetFMUstate", "canSerializeFMUstate", "canNotUseMemoryManagementFunctions")
    simulation = ElementTree.SubElement(
        root, "CoSimulation", {"modelIdentifier": name} | dict.fromkeys(can, "true")
    )
    files = ElementTree.SubElement(simulation, "SourceFiles")
    for file in (f"{name}.c", "fmi2.c"):
        ElementTree.SubElement(files, "File", {"name": file})
    units = sorted({s.unit for s in (*program.inputs, *program.outputs) if s.unit})
    if units:
        definitions = ElementTree.SubElement(root, "UnitDefinitions")
        for unit in units:
            ElementTree.SubElement(definitions, "Unit", {"name": unit})
    ElementTree.SubElement(root, "DefaultExperiment", {"stepSize": repr(float(program.dt_s))})
    variables = ElementTree.SubElement(root, "ModelVariables")
    for at, (label, signal) in enumerate(zip(inputs, program.inputs, strict=True)):
        _variable(variables, at, label, signal, {"causality": "input", "variability": "discrete"}, start="0")
    for at, (label, signal) in enumerate(zip(outputs, program.outputs, strict=True), len(inputs)):
        kind = {"causality": "output", "variability": "discrete", "initial": "calculated"}
        _variable(variables, at, label, signal, kind)
    structure = ElementTree.SubElement(root, "ModelStructure")
    through = " ".join(str(j + 1) for j in direct)
    for group in ("Outputs", "InitialUnknowns"):
        rows = ElementTree.SubElement(structure, group)
        for at in range(len(inputs), len(inputs) + len(outputs)):
            ElementTree.SubElement(rows, "Unknown", {"index": str(at + 1), "dependencies": through})
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root) + b"\n"


def _variable(variables: Any, at: int, label: str, signal: Signal, kind: dict[str, str], **real: str) -> None:
    row = ElementTree.SubElement(
        variables, "ScalarVariable", {"name": label, "valueReference": str(at)} | kind
    )
    ElementTree.SubElement(row, "Real", ({"unit": signal.unit} if signal.unit else {}) | real)


def _names(program: Program) -> tuple[list[str], list[str]]:
    """Names of inputs and outputs, no two alike, without line breaks."""
    taken: list[str] = []
    for signal in (*program.inputs, *program.outputs):
        label = "".join(c if c.isprintable() else "_" for c in signal.name) or "signal"
        while label in taken:
            label += "_"
        taken.append(label)
    return taken[: len(program.inputs)], taken[len(program.inputs) :]


def _documentation(program: Program, name: str) -> bytes:
    from html import escape

    convention = " ".join((__doc__ or "").split("\n\n", 1)[1].split())
    text = f"<!DOCTYPE html><title>{escape(name)}</title><h1>{escape(name)}</h1>"
    return (text + f"<p>{escape(program.title)}.</p><p>{escape(convention)}</p>\n").encode()
