"""A vehicle as an ONNX graph in float32: the state (B, 13 + motors) a sample later, for any batch.

The graph is drawn by running the module that `portable` writes on names instead of numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flysid.export.onnx_graph import Graph
from flysid.export.vehicles.portable import portable_source
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.rigid_body import STATES


def vehicle_onnx(vehicle: FittedVehicle) -> bytes:
    """The file: `x` and `u` become `x_next` after the vehicle's sample time.

    Raises UsageError: the package onnx is not installed.
    """
    graph = Graph()
    size = STATES + vehicle.motors
    x = [_column(graph, "x", i) for i in range(size)]
    u = [_column(graph, "u", i) for i in range(vehicle.motors)]
    written: dict[str, Any] = {}
    exec(portable_source(vehicle), written)
    step: Callable[..., Sequence[_Term]] = written["step"]
    library = {"sqrt": _Term.root, "stack": _array, "smallest": _Term.at_least}
    after = step(_array(x), u, vehicle.dt_s, **library)
    graph.name_output("x_next", "Concat", [term.name for term in after], axis=1)
    words = (
        f"A vehicle identified by flysid, {vehicle.dt_s:g} s a step. x: position 3, velocity 3, quaternion "
        "w x y z, body rate 3, motors; axes forward, left, up. u: (logged command - "
        f"{vehicle.zero:g}) / {vehicle.full:g}, after the delay."
    )
    return graph.to_bytes("vehicle", {"x": size, "u": vehicle.motors, "x_next": size}, words)


def _array(parts: Sequence[Any]) -> Any:
    """Of terms and numbers, added and scaled entry by entry."""
    found = np.empty(len(parts), dtype=object)
    found[:] = parts
    return found


def _column(graph: Graph, name: str, place: int) -> _Term:
    return _Term(graph, graph.add("Gather", name, graph.places([place]), axis=1))


class _Term:
    """(B, 1) numbers that a graph works out."""

    def __init__(self, graph: Graph, name: str) -> None:
        self._graph = graph
        self.name = name

    def _name(self, other: _Term | float) -> str:
        return other.name if isinstance(other, _Term) else self._graph.numbers([[float(other)]])

    def _joined(self, operation: str, first: str, second: str) -> _Term:
        return _Term(self._graph, self._graph.add(operation, first, second))

    def __add__(self, other: _Term | float) -> _Term:
        return self._joined("Add", self.name, self._name(other))

    def __radd__(self, other: float) -> _Term:
        return self._joined("Add", self._name(other), self.name)

    def __sub__(self, other: _Term | float) -> _Term:
        return self._joined("Sub", self.name, self._name(other))

    def __rsub__(self, other: float) -> _Term:
        return self._joined("Sub", self._name(other), self.name)

    def __mul__(self, other: _Term | float) -> _Term:
        return self._joined("Mul", self.name, self._name(other))

    def __rmul__(self, other: float) -> _Term:
        return self._joined("Mul", self._name(other), self.name)

    def __truediv__(self, other: _Term | float) -> _Term:
        return self._joined("Div", self.name, self._name(other))

    def __neg__(self) -> _Term:
        return _Term(self._graph, self._graph.add("Neg", self.name))

    def root(self) -> _Term:
        """Its square root."""
        return _Term(self._graph, self._graph.add("Sqrt", self.name))

    def at_least(self, least: float) -> _Term:
        """The larger of the two."""
        return self._joined("Max", self.name, self._name(least))
