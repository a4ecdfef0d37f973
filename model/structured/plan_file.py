"""The file that says what a structured state-space model looks like.

    states = ["vx", "theta", "q"]

    [F.vx]                                   # d vx / dt =
    vx = "X_u"                               # a free term; its start is found from the data
    theta = 0.1712                           # a number stays as it is
    [F.theta]
    q = 1
    [G.q]
    pitch = { name = "M_e", start = 100.0 }  # a free term with its start
    [H.climb]                                # an output that is no state: what it is made of
    vx = { tied = "X_u", factor = -1 }       # tied to another term
    [delay]
    pitch = { name = "tau", start = 0.02 }   # seconds by which an input is late

d x / dt = F x + G u(t - delay), y = H x + D u(t - delay). What is not named is zero. An output that has the
name of a state needs no [H] and no [D]. Optional: `reference = ["chirp"]`, inputs that drive a loop from
outside, and [units] of the states that no output has the name of.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.files import remedy_unread, why_unread

TABLES = ("F", "G", "H", "D")
FORMS = 'a number, "NAME", { name = "NAME", start = 1.0 } or { tied = "NAME", factor = -1.0 }'


@dataclass(frozen=True)
class TermPlace:
    """Where a term stands: F, G, H, D (row, column) or delay (row 0, column: the input), and its factor."""

    table: str
    row: int
    column: int
    factor: float = 1.0


@dataclass(frozen=True)
class FreeNumber:
    """A free number. `start` is None where it is to be found from the data."""

    name: str
    unit: str
    start: float | None
    places: tuple[TermPlace, ...]

    @property
    def is_delay(self) -> bool:
        """It delays an input."""
        return any(p.table == "delay" for p in self.places)


@dataclass(frozen=True, eq=False)
class PlanLayout:
    """A plan for given signals: matrices with the fixed numbers, and the terms that are free.

    `fixed`: "F" (n, n), "G" (n, n_u), "H" (n_y, n), "D" (n_y, n_u), "delay" (1, n_u).
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    fixed: Mapping[str, FloatArray]
    terms: tuple[FreeNumber, ...]

    def matrices(self, theta: FloatArray) -> dict[str, FloatArray]:
        """Every table with these values of the terms."""
        found = {name: values.copy() for name, values in self.fixed.items()}
        for term, value in zip(self.terms, theta, strict=True):
            for p in term.places:
                found[p.table][p.row, p.column] += p.factor * value
        return found

    def state_of(self, output: int) -> int | None:
        """The state that an output is, or None where it is made of several or of unknown numbers."""
        if any(p.table in ("H", "D") and p.row == output for t in self.terms for p in t.places):
            return None
        row = self.fixed["H"][output]
        if self.fixed["D"][output].any() or np.count_nonzero(row) != 1 or row.max() != 1.0:
            return None
        return int(np.argmax(row))


@dataclass(frozen=True)
class Plan:
    """A parsed file; `layout` makes it one for given signals."""

    states: tuple[str, ...]
    tables: Mapping[str, Mapping[str, Mapping[str, Any]]]
    delays: Mapping[str, Any]
    reference: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    path: str = ""

    @classmethod
    def read(cls, path: str | Path) -> Plan:
        """Read a file. Raises UsageError: it cannot be read, or says what cannot be."""
        try:
            text = Path(path).read_text("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(
                f"cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
            ) from error
        return cls.parse(text, str(path))

    @classmethod
    def parse(cls, text: str, path: str = "") -> Plan:
        """The plan that a TOML text holds. Raises UsageError: it is not TOML, or says what cannot be."""
        try:
            document = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise UsageError(f"not TOML: {error}", path=path or None) from error
        known = ("states", *TABLES, "delay", "reference", "units")
        for key in document:
            if key not in known:
                raise UsageError(f"no entry {key!r}", hint=f"one of {', '.join(known)}", path=path or None)
        states = _names(document.get("states", []), "states", path)
        if not states:
            raise UsageError(
                "a structured model needs its states", hint='states = ["u", "q"]', path=path or None
            )
        tables = {t: {r: _table(v, f"{t}.{r}", path) for r, v in _table(document.get(t, {}), t, path).items()}
                  for t in TABLES}  # fmt: skip
        units = {k: str(v) for k, v in _table(document.get("units", {}), "units", path).items()}
        reference = _names(document.get("reference", []), "reference", path)
        delays = _table(document.get("delay", {}), "delay", path)
        plan = cls(states, tables, delays, reference, units, path)
        plan._check_states()
        return plan

    @classmethod
    def full(cls, inputs: Sequence[Signal], outputs: Sequence[Signal]) -> Plan:
        """Every output a state, every derivative free, every input late by a free time."""
        rows = tuple(s.name for s in outputs)
        columns = tuple(s.name for s in inputs)
        tables: dict[str, dict[str, dict[str, Any]]] = {t: {} for t in TABLES}
        for row in rows:
            tables["F"][row] = {name: f"{row} per {name}" for name in rows}
            tables["G"][row] = {name: f"{row} per {name}" for name in columns}
        return cls(rows, tables, {name: f"delay of {name}" for name in columns})

    def layout(self, inputs: Sequence[Signal], outputs: Sequence[Signal]) -> PlanLayout:
        """For these signals, of which the inputs are without references.

        Raises UsageError: a name that does not exist, an output without a row, an entry that cannot be.
        """
        us = tuple(s.name for s in inputs)
        ys = tuple(s.name for s in outputs)
        for name in self.delays:
            self._check_name(name, us, "delay", "input")
        for table, rows in self.tables.items():
            for row, columns in rows.items():
                if table in "HD":
                    self._check_name(row, ys, f"[{table}.{row}]", "output")
                for column in columns if table in "GD" else ():
                    self._check_name(column, us, f"[{table}.{row}]", "input")
        sizes = {"F": (self.states, self.states), "G": (self.states, us), "H": (ys, self.states),
                 "D": (ys, us), "delay": (("",), us)}  # fmt: skip
        fixed = {t: np.zeros((len(rows), len(columns))) for t, (rows, columns) in sizes.items()}
        known = {s.name: s.unit for s in (*outputs, *inputs)} | dict(self.units)
        terms = _Terms(self, known)
        for table, rows in (*self.tables.items(), ("delay", {"": self.delays})):
            for row, columns in rows.items():
                for column, entry in columns.items():
                    i = sizes[table][0].index(row)
                    j = sizes[table][1].index(column)
                    fixed[table][i, j] = terms.add(entry, table, (row, column), (i, j))
        for i, name in enumerate(ys):
            if name in self.tables["H"] or name in self.tables["D"]:
                continue
            if name not in self.states:
                raise UsageError(
                    f"output {name!r} is no state and has no [H.{name}]",
                    hint=f"add the row, or name one of the states {', '.join(self.states)} so",
                    path=self.path or None,
                )
            fixed["H"][i, self.states.index(name)] = 1.0
        if (fixed["delay"] < 0.0).any():
            raise UsageError("a delay is at least 0 s", path=self.path or None)
        return PlanLayout(self.states, us, ys, fixed, terms.found())

    def _check_states(self) -> None:
        for name in self.units:
            self._check_name(name, self.states, "[units]", "state")
        for table, rows in self.tables.items():
            for row, columns in rows.items():
                if table in "FG":
                    self._check_name(row, self.states, f"[{table}.{row}]", "state")
                for column in columns if table in "FH" else ():
                    self._check_name(column, self.states, f"[{table}.{row}]", "state")

    def _check_name(self, name: str, known: Sequence[str], where: str, kind: str) -> None:
        if name not in known:
            raise UsageError(
                f"{where}: no {kind} is called {name!r}",
                hint=f"one of {', '.join(known)}",
                path=self.path or None,
            )


class _Terms:
    """Terms as they are met: names are shared, ties wait until their term is known."""

    def __init__(self, plan: Plan, units: Mapping[str, str]) -> None:
        self.plan = plan
        self.units = units
        self.starts: dict[str, float | None] = {}
        self.places: dict[str, list[tuple[TermPlace, str]]] = {}

    def add(self, entry: object, table: str, names: tuple[str, str], at: tuple[int, int]) -> float:
        """The fixed number of an entry, 0 where it is a term."""
        where = "delay." + names[1] if table == "delay" else f"{table}.{names[0]}.{names[1]}"
        if isinstance(entry, (int, float)) and not isinstance(entry, bool):
            return self._number(entry, where)
        if isinstance(entry, str):
            entry = {"name": entry}
        if not isinstance(entry, dict) or set(entry) not in _SHAPES:
            raise self._error(f"{where} is {entry!r}", f"give {FORMS}")
        name = entry.get("name", entry.get("tied"))
        if not isinstance(name, str) or not re.fullmatch(r"\S(.*\S)?", name):
            raise self._error(f"{where}: {name!r} is no name", f"give {FORMS}")
        factor = self._number(entry.get("factor", 1.0), where)
        if "name" in entry:
            start = self._number(entry["start"], where) if "start" in entry else None
            before = self.starts.setdefault(name, start)
            if start is not None and before not in (None, start):
                raise self._error(f"{name!r} starts at {before:g} and at {start:g}", "one name, one start")
            self.starts[name] = start if before is None else before
        if table == "delay" and factor < 0.0:
            raise self._error(
                f"{where}: {factor:g} times a delay is below 0 s", "tie it with a factor above 0"
            )
        place = TermPlace(table, *at, factor)
        self.places.setdefault(name, []).append((place, self._unit(table, *names)))
        return 0.0

    def found(self) -> tuple[FreeNumber, ...]:
        """All terms, in the order of the file.

        Raises UsageError: a tie to a term that is not there; nothing is free.
        """
        for name in self.places:
            if name not in self.starts:
                hint = f"one of {', '.join(self.starts)}" if self.starts else f"name it: {FORMS}"
                raise self._error(f"tied to {name!r}, which is no term", hint)
        terms = []
        for name, places in self.places.items():
            own = next((unit for p, unit in places if p.factor == 1.0), places[0][1])
            terms.append(FreeNumber(name, own, self.starts[name], tuple(p for p, _ in places)))
        if not terms:
            raise self._error("no term is free", f"give {FORMS}")
        return tuple(terms)

    def _unit(self, table: str, row: str, column: str) -> str:
        if table == "delay":
            return "s"
        over = self.units.get(row) or "1"
        under = self.units.get(column) or "1"
        rate = {"F": "/s", "G": "/s"}.get(table, "")
        if over == under:
            return f"1{rate}" if rate else ""
        return f"{over}{rate} per {under}"

    def _number(self, value: object, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self._error(f"{where}: {value!r} is no number", f"give {FORMS}")
        return float(value)

    def _error(self, message: str, hint: str) -> UsageError:
        return UsageError(message, hint=hint, path=self.plan.path or None)


_SHAPES = ({"name"}, {"name", "start"}, {"tied"}, {"tied", "factor"})


def _names(value: object, key: str, path: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(v, str) and v for v in value):
        raise UsageError(f"{key} is {value!r}", hint=f'{key} = ["a", "b"]', path=path or None)
    if len(set(value)) < len(value):
        raise UsageError(f"{key} names one twice: {', '.join(value)}", path=path or None)
    return tuple(value)


def _table(value: object, key: str, path: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise UsageError(f"[{key}] is {value!r}", hint=f"[{key}], then name = {FORMS}", path=path or None)
    return value
