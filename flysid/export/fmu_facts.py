"""What both versions of FMI state about a program: its variables and what depends on what."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

from flysid.dataset import Signal
from flysid.escaping import one_line
from flysid.export.program import Program
from flysid.version import __version__


@dataclass(frozen=True)
class Variable:
    """A variable; its value reference is its place.

    `kind`: causality, variability, initial.
    `begins`: its start value, where it has one.
    """

    name: str
    unit: str
    kind: dict[str, str]
    begins: dict[str, str]


@dataclass(frozen=True)
class Facts:
    """A model as the standard wants it described.

    `variables`: inputs, outputs, and what a run starts from.
    `outputs`: places of the outputs.
    `through`: places of the inputs that the outputs depend on at once.
    """

    name: str
    about: str
    dt_s: float
    variables: tuple[Variable, ...]
    outputs: range
    through: tuple[int, ...]

    def depends(self, initially: bool) -> tuple[int, ...]:
        """What an output depends on: in a run on inputs alone, at its start on the start as well."""
        return self.through + (tuple(range(self.outputs.stop, len(self.variables))) if initially else ())

    def root(self, version: str, **identity: str) -> ElementTree.Element:
        """The document's first element; what identifies the model has a name of its own in each version."""
        head = {"fmiVersion": version, "modelName": self.name} | identity
        head |= {"description": self.about, "generationTool": f"flysid {__version__}"}
        return ElementTree.Element("fmiModelDescription", head | {"variableNamingConvention": "flat"})

    def add_units(self, root: ElementTree.Element) -> None:
        """UnitDefinitions, where there is a unit."""
        units = sorted({v.unit for v in self.variables if v.unit})
        if units:
            definitions = ElementTree.SubElement(root, "UnitDefinitions")
            for unit in units:
                ElementTree.SubElement(definitions, "Unit", {"name": unit})


def facts_of(program: Program, name: str) -> Facts:
    """The variables of a program, no two of one name."""
    n_u = len(program.inputs)
    n_y = len(program.outputs)
    direct = {c - program.n for c, lag in program.asked() if lag == 0 and c >= program.n}
    about = (
        f"{program.title}, one step every {program.dt_s:.9g} s. Reading an output computes it from the "
        "inputs as they stand; from rest: inputs and outputs were zero. A model of past flights."
    )
    taken: set[str] = set()

    def variable(label: str, signal: Signal, kind: dict[str, str], **begins: str) -> Variable:
        label = "".join(c if c.isprintable() else "_" for c in label) or "signal"
        while label in taken:
            label += "_"
        taken.add(label)
        return Variable(label, one_line(signal.unit), {**kind, "variability": "discrete"}, begins)

    made = {"causality": "output", "initial": "calculated"}
    held = {"causality": "local", "initial": "exact"}
    rest = program.remembered(program.start)
    rows = [variable(s.name, s, {"causality": "input"}, start="0") for s in program.inputs]
    rows += [variable(s.name, s, made) for s in program.outputs]
    rows += [
        variable(f"{program.signals[c].name}(k-{lag})", program.signals[c], held, start=repr(float(value)))
        for (c, lag), value in zip(program.memory, rest, strict=True)
    ]
    return Facts(name, about, float(program.dt_s), tuple(rows), range(n_u, n_u + n_y), tuple(sorted(direct)))


def as_xml(root: ElementTree.Element) -> bytes:
    """The document, indented."""
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root) + b"\n"
