"""One step of a model as an ONNX graph in float32, and a small JSON that says what its numbers are.

Rows of `u` are a batch: `x` (B, m) and `u` (B, n_u) become `x_next` and `y`. The memory x is normalised, so
that float32 keeps its digits; the JSON holds the shift and scale of every entry. A model without a memory
has neither x nor x_next.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.errors import UsageError
from flysid.export.program import Memberships, Program
from flysid.export.programs import Member, limits_of
from flysid.export.wording import title_of, value_name
from flysid.version import __version__

FORMAT = "flysid-onnx"
VERSION = 1
_OPSET = 18  # the first in which every reduction takes its axes as an input
_IR = 8  # the representation that came with it

Name = str
"""Of a value in a graph."""


def onnx_bytes(members: Sequence[Member], name: str) -> bytes:
    """The graph of one step.

    `members`: one, or those of an ensemble.
    `name`: of the graph.
    Raises UsageError: the package onnx is not installed.
    """
    graph = Graph()
    ends = np.cumsum([0, *(len(m.program.memory) for m in members)])
    memories = []
    outputs = []
    for (program, share), (first, last) in zip(members, pairwise(ends.tolist()), strict=True):
        own = graph.add("Gather", "x", graph.places(range(first, last)), axis=1) if last > first else ""
        after, y = _step(graph, program, own)
        memories += [after] if after else []
        outputs.append(graph.add("Mul", y, graph.numbers(share)) if len(members) > 1 else y)
    graph.name_output("y", "Sum", outputs)
    if memories:
        graph.name_output("x_next", "Concat", memories, axis=1)
    first_program = members[0].program
    sizes = {"u": len(first_program.inputs), "y": len(first_program.outputs)}
    if memories:
        sizes |= {"x": int(ends[-1]), "x_next": int(ends[-1])}
    return graph.to_bytes(name, sizes, title_of(members))


def names_json(members: Sequence[Member], loss: float | None) -> str:
    """What the graph's numbers are: names, units, shift and scale.

    `loss`: what float32 adds to the free run's error on the training data, as a share of its RMSE; None where
        it was not tried.
    """
    first = members[0].program
    low, high = limits_of(members)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "title": title_of(members),
        "made": f"flysid {__version__}",
        "dt_s": first.dt_s,
        "u": [{"name": s.name, "unit": s.unit} for s in first.inputs],
        "y": [
            {"name": s.name, "unit": s.unit, "low": a, "high": b}
            for s, a, b in zip(first.outputs, low.tolist(), high.tolist(), strict=True)
        ],
        "x": [entry for member in members for entry in _entries(member.program)],
        "physical": "x * scale + shift",
        "float32_loss": loss,
    }
    return json.dumps(document, allow_nan=False, indent=1, ensure_ascii=False) + "\n"


def _entries(program: Program) -> list[dict[str, Any]]:
    return [
        {
            "name": value_name(program, (column, lag)),
            "unit": program.signals[column].unit,
            "shift": float(program.shift[column]),
            "scale": float(program.scale[column]),
            "rest": float(program.start[program.cell(column, lag)]),
        }
        for column, lag in program.memory
    ]


class Graph:
    """Nodes and constants, each under a name of its own.

    Raises UsageError: the package onnx is not installed.
    """

    def __init__(self) -> None:
        if importlib.util.find_spec("onnx") is None:
            raise UsageError("the package onnx is not installed", hint='pip install "flysid[mpc]"')
        from onnx import helper, numpy_helper

        self._make = helper
        self._tensor = numpy_helper.from_array
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, operation: str, *inputs: Name, **attributes: Any) -> Name:
        """A node of one output, and the name of that."""
        return self.name_output(f"v{len(self._nodes)}", operation, inputs, **attributes)

    def name_output(self, name: Name, operation: str, inputs: Sequence[Name], **attributes: Any) -> Name:
        """A node whose output has this name."""
        self._nodes.append(self._make.make_node(operation, list(inputs), [name], **attributes))
        return name

    def numbers(self, values: npt.ArrayLike) -> Name:
        """A constant array in float32."""
        return self._constant(np.asarray(values, dtype=np.float32))

    def places(self, values: Sequence[int] | range | npt.NDArray[np.int64]) -> Name:
        """Constant indices, axes or sizes."""
        return self._constant(np.array(values, dtype=np.int64))

    def _constant(self, values: npt.NDArray[Any]) -> Name:
        name = f"c{len(self._constants)}"
        self._constants.append(self._tensor(values, name))
        return name

    def limited(self, value: Name, low: Name, high: Name) -> Name:
        """The value inside its limits; `low` where it is not a number."""
        above = self.add("Greater", value, low)
        return self.add("Where", above, self.add("Min", value, high), low)

    def to_bytes(self, name: str, sizes: dict[Name, int], words: str) -> bytes:
        """The model's file; `sizes` of its inputs (x, u) and outputs."""
        from onnx import TensorProto, checker

        values = {
            key: self._make.make_tensor_value_info(key, TensorProto.FLOAT, ["batch", size])
            for key, size in sizes.items()
        }
        inputs = [values[key] for key in ("x", "u") if key in values]
        outputs = [values[key] for key in ("x_next", "y") if key in values]
        graph = self._make.make_graph(self._nodes, name, inputs, outputs, self._constants, words)
        model = self._make.make_model(
            graph,
            producer_name="flysid",
            producer_version=__version__,
            ir_version=_IR,
            opset_imports=[self._make.make_opsetid("", _OPSET)],
        )
        checker.check_model(model, full_check=True)
        return bytes(model.SerializeToString())


def _step(graph: Graph, program: Program, x: Name) -> tuple[Name, Name]:
    """The next memory ("" where there is none) and the outputs of one program."""
    n = program.n
    n_u = len(program.inputs)
    n_y = len(program.outputs)
    shifted = graph.add("Sub", "u", graph.numbers(program.shift[n:]))
    now = graph.add("Div", shifted, graph.numbers(program.scale[n:]))
    known = [_ones(graph), now, *([x] if x else [])]
    place = {0: 0}  # of a cell, its column among what is known
    place |= {program.newest[n + j]: 1 + j for j in range(n_u)}
    remembered = {pair: 1 + n_u + k for k, pair in enumerate(program.memory)}
    place |= {program.cell(*pair): column for pair, column in remembered.items()}
    cells = _work(graph, program, graph.add("Concat", *known, axis=1), place)

    def columns(wanted: Sequence[int] | npt.NDArray[np.int64]) -> Name:
        return graph.add("Gather", cells, graph.places([place[int(cell)] for cell in wanted]), axis=1)

    s = _conclude(graph, program, columns)
    s = graph.limited(s, graph.numbers(program.limits[0]), graph.numbers(program.limits[1]))
    outputs = graph.add("Gather", s, graph.places(range(n_y)), axis=1)
    sized = graph.add("Mul", outputs, graph.numbers(program.scale[:n_y]))
    physical = graph.add("Add", sized, graph.numbers(program.shift[:n_y]))
    y = graph.limited(physical, *(graph.numbers(limit) for limit in program.output_limits))
    if not x:
        return "", y
    every = graph.add("Concat", cells, s, axis=1)
    newest = {column: len(place) + column for column in range(n)}
    newest |= {n + j: 1 + j for j in range(n_u)}
    kept = [newest[column] if lag == 1 else remembered[column, lag - 1] for column, lag in program.memory]
    return graph.add("Gather", every, graph.places(kept), axis=1), y


def _ones(graph: Graph) -> Name:
    """(B, 1) the constant 1."""
    rows = graph.add("Gather", graph.add("Shape", "u"), graph.places([0]), axis=0)
    shape = graph.add("Concat", rows, graph.places([1]), axis=0)
    return graph.add("Expand", graph.numbers([[1.0]]), shape)


_OPERATIONS = {"change": "Sub", "magnitude": "Abs", "sign": "Sign", "product": "Mul"}


def _work(graph: Graph, program: Program, cells: Name, place: dict[int, int]) -> Name:
    """The cells, and behind them all that is worked out of them; `place` learns where."""
    worked: dict[int, Name] = {}

    def column(cell: int) -> Name:
        if cell in worked:
            return worked[cell]
        return graph.add("Gather", cells, graph.places([place[cell]]), axis=1)

    for operation, to, a, b, low, high in program.working:
        if operation == "held":
            worked[to] = graph.limited(column(a), graph.numbers(low), graph.numbers(high))
            continue
        both = operation in ("change", "product")
        parts = [column(cell) for cell in ((a, b) if both else (a,))]
        worked[to] = graph.add(_OPERATIONS[operation], *parts)
    for to in worked:
        place[to] = len(place)
    return graph.add("Concat", cells, *worked.values(), axis=1) if worked else cells


def _conclude(graph: Graph, program: Program, columns: Any) -> Name:
    """(B, n) what the rules conclude of the regressors, weighed by how loudly they speak."""
    rules, n, n_x = program.theta.shape
    w = columns(program.regressors)
    theta = graph.numbers(program.theta.reshape(rules * n, n_x).T)
    concluded = graph.add("MatMul", w, theta)
    m = program.memberships
    if m is None:
        return concluded
    phi = graph.add("Unsqueeze", _fire(graph, program, m, columns), graph.places([2]))
    apart = graph.add("Reshape", concluded, graph.places([-1, rules, n]))
    return graph.add("ReduceSum", graph.add("Mul", phi, apart), graph.places([1]), keepdims=0)


def _fire(graph: Graph, program: Program, m: Memberships, columns: Any) -> Name:
    """(B, R) how loudly every rule speaks, in sum 1."""
    lags = program.lags
    pairs = list(zip(lags.z_column.tolist(), lags.z_lag.tolist(), lags.z_minus.tolist(), strict=True))
    z = columns([program.cell(c, lag) for c, lag, _ in pairs])
    if any(minus >= 0 for *_, minus in pairs):
        earlier = columns([program.cell(c, max(minus, 0)) if minus >= 0 else 0 for c, _, minus in pairs])
        counts = graph.numbers([float(minus >= 0) for *_, minus in pairs])
        z = graph.add("Sub", z, graph.add("Mul", earlier, counts))
    z = graph.limited(z, graph.numbers(m.low), graph.numbers(m.high))
    gap = graph.add("Sub", graph.add("Unsqueeze", z, graph.places([1])), graph.numbers(m.centre))
    below = graph.add("Less", gap, graph.numbers(0.0))
    width = graph.add("Where", below, graph.numbers(m.left), graph.numbers(m.right))
    distance = graph.add("Div", gap, width)
    square = graph.add("Mul", distance, distance)
    every = graph.places([2])
    if m.shape == "gaussian":
        own = graph.add("Mul", square, graph.numbers(-0.5))
        join = "ReduceMin" if m.conjunction == "minimum" else "ReduceSum"
        return graph.add("Softmax", graph.add(join, own, every, keepdims=0), axis=1)
    own = _side(graph, graph.add("Abs", distance), m)
    join = "ReduceMin" if m.conjunction == "minimum" else "ReduceProd"
    phi = graph.add(join, own, every, keepdims=0)
    far = graph.add("ReduceSum", square, every, keepdims=0)
    closest = graph.add("ArgMin", far, axis=1, keepdims=0)
    nearest = graph.add("OneHot", closest, graph.places([len(m.centre)]), graph.numbers([0.0, 1.0]))
    rows = graph.places([1])
    speaks = graph.add("Greater", graph.add("ReduceMax", phi, rows), graph.numbers(0.0))
    phi = graph.add("Where", speaks, phi, nearest)  # where none speaks, the nearest does
    return graph.add("Div", phi, graph.add("ReduceSum", phi, rows))


def _side(graph: Graph, reach: Name, m: Memberships) -> Name:
    """Grades of a triangle or a trapezoid that far from its centre."""
    if m.shape == "triangle":
        sloped = graph.add("Sub", graph.numbers(1.0), graph.add("Div", reach, graph.numbers(2.0)))
    else:
        sloped = graph.add("Div", graph.add("Sub", graph.numbers(2.0), reach), graph.numbers(1.5))
    return graph.limited(sloped, graph.numbers(0.0), graph.numbers(1.0))
