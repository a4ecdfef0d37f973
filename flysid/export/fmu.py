"""A program as an FMU: co-simulation of FMI 2.0 or 3.0, with sources, and a binary where there is a compiler.

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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

from flysid.errors import FitError
from flysid.export.csource import c_files, render, values_of
from flysid.export.fmu_facts import Facts, as_xml, facts_of
from flysid.export.program import Program

EPOCH = (2000, 1, 1, 0, 0, 0)  # dates would make every archive another one
PLATFORMS = {2: "linux64", 3: "x86_64-linux"}
FMIVersion = Literal[2, 3]


def fmu_bytes(program: Program, name: str, *, version: FMIVersion = 2, binary: bool = True) -> bytes:
    """The FMU; the same bytes each time by the same compiler.

    `name`: model identifier, as `csource.identifier` makes it.
    `version`: of FMI.
    `binary`: compile it for this machine where it is a 64-bit Linux with a C compiler.
    Raises FitError: the compiler refuses its sources.
    """
    texts = c_files(program, name)
    sources = {f: texts[f] for f in (f"{name}.c", f"{name}.h")}
    facts = facts_of(program, name)
    convention = " ".join((__doc__ or "").split("\n\n", 1)[1].split())
    words = (f"{program.title}.", convention)
    return packed(sources, facts, values_of(program, name), words, version=version, binary=binary)


def packed(
    sources: Mapping[str, str],
    facts: Facts,
    values: Mapping[str, Any],
    paragraphs: Sequence[str],
    *,
    version: FMIVersion = 2,
    binary: bool = True,
) -> bytes:
    """The archive of a model whose C has `NAME_reset`, `NAME_output` and `NAME_advance`.

    `sources`: file -> text of that C.
    `values`: what the template of the interface names of the model.
    `paragraphs`: of its documentation.
    Raises FitError: the compiler refuses its sources.
    """
    name = facts.name
    identity = str(uuid.uuid5(uuid.NAMESPACE_URL, "".join(sources.values())))
    words = {"guid": identity, "dt_exact": repr(facts.dt_s), "version": version}
    texts = {**sources, f"fmi{version}.c": render({**values, **words}, "fmi.c.j2")}
    files = {f"sources/{f}": text.encode() for f, text in texts.items()}
    describe = _description if version == 2 else _newer_description
    files["modelDescription.xml"] = describe(facts, identity)
    if version == 3:
        files["sources/buildDescription.xml"] = _build(name)
    files["documentation/index.html"] = _documentation(name, paragraphs)
    compiler = shutil.which("cc") or shutil.which("gcc")
    if binary and compiler is not None:
        files[f"binaries/{PLATFORMS[version]}/{name}.so"] = _compile(compiler, texts)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(files):
            archive.writestr(zipfile.ZipInfo(path, EPOCH), files[path], zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _compile(compiler: str, sources: dict[str, str]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for file, text in sources.items():
            (place / file).write_text(text, "utf-8")
        options = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden", "-s")
        code = [file for file in sources if file.endswith(".c")]
        command = [compiler, *options, "-Wl,--build-id=none", "-o", "model.so", *code, "-lm"]
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        if done.returncode:
            raise FitError(
                f"the FMU's sources were not compiled: {done.stderr[:300]}",
                hint="give it another C compiler as cc",
            )
        return (place / "model.so").read_bytes()


def _description(facts: Facts, identity: str) -> bytes:
    """modelDescription.xml of FMI 2.0."""
    root = facts.root("2.0", guid=identity)
    root.set("numberOfEventIndicators", "0")
    can = ("canGetAndSetFMUstate", "canSerializeFMUstate", "canNotUseMemoryManagementFunctions")
    simulation = ElementTree.SubElement(
        root, "CoSimulation", {"modelIdentifier": facts.name} | dict.fromkeys(can, "true")
    )
    files = ElementTree.SubElement(simulation, "SourceFiles")
    for file in (f"{facts.name}.c", "fmi2.c"):
        ElementTree.SubElement(files, "File", {"name": file})
    facts.add_units(root)
    ElementTree.SubElement(root, "DefaultExperiment", {"stepSize": repr(facts.dt_s)})
    variables = ElementTree.SubElement(root, "ModelVariables")
    for at, v in enumerate(facts.variables):
        row = ElementTree.SubElement(
            variables, "ScalarVariable", {"name": v.name, "valueReference": str(at)} | v.kind
        )
        ElementTree.SubElement(row, "Real", ({"unit": v.unit} if v.unit else {}) | v.begins)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for group in ("Outputs", "InitialUnknowns"):
        rows = ElementTree.SubElement(structure, group)
        for at in facts.outputs:
            depends = " ".join(str(j + 1) for j in facts.depends(group == "InitialUnknowns"))
            ElementTree.SubElement(rows, "Unknown", {"index": str(at + 1), "dependencies": depends})
    return as_xml(root)


def _newer_description(facts: Facts, identity: str) -> bytes:
    """modelDescription.xml of FMI 3.0."""
    root = facts.root("3.0", instantiationToken=identity)
    can = {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
    step = {"canHandleVariableCommunicationStepSize": "false", "fixedInternalStepSize": repr(facts.dt_s)}
    ElementTree.SubElement(root, "CoSimulation", {"modelIdentifier": facts.name} | can | step)
    facts.add_units(root)
    ElementTree.SubElement(root, "DefaultExperiment", {"stepSize": repr(facts.dt_s)})
    variables = ElementTree.SubElement(root, "ModelVariables")
    for at, v in enumerate(facts.variables):
        unit = {"unit": v.unit} if v.unit else {}
        ElementTree.SubElement(
            variables, "Float64", {"name": v.name, "valueReference": str(at)} | v.kind | v.begins | unit
        )
    names = {v.name for v in facts.variables}
    clock = next(name for name in ("time", "simulation_time", "fmi_time") if name not in names)
    independent = {"causality": "independent", "variability": "continuous"}
    ElementTree.SubElement(
        variables, "Float64", {"name": clock, "valueReference": str(len(facts.variables))} | independent
    )
    structure = ElementTree.SubElement(root, "ModelStructure")
    for group in ("Output", "InitialUnknown"):
        for at in facts.outputs:
            depends = " ".join(map(str, facts.depends(group == "InitialUnknown")))
            ElementTree.SubElement(structure, group, {"valueReference": str(at), "dependencies": depends})
    return as_xml(root)


def _build(name: str) -> bytes:
    """sources/buildDescription.xml."""
    root = ElementTree.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    build = ElementTree.SubElement(root, "BuildConfiguration", {"modelIdentifier": name})
    files = ElementTree.SubElement(build, "SourceFileSet", {"language": "C99"})
    for file in (f"{name}.c", "fmi3.c"):
        ElementTree.SubElement(files, "SourceFile", {"name": file})
    ElementTree.SubElement(build, "Library", {"name": "m", "external": "true"})
    return as_xml(root)


def _documentation(name: str, paragraphs: Sequence[str]) -> bytes:
    from html import escape

    text = "".join(f"<p>{escape(words)}</p>" for words in paragraphs)
    return f"<!DOCTYPE html><title>{escape(name)}</title><h1>{escape(name)}</h1>{text}\n".encode()
