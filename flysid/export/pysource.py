"""Python files that code of MPC and of learning calls: programs as CasADi or as JAX functions.

A file needs nothing but the package that it is for. The memory is in physical units, in the order of
`Program.memory`; several programs stand one behind another, and their outputs are weighed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from flysid.export.csource import rendered
from flysid.export.program import AffinePast, LikelyPast, Operation, Program
from flysid.export.programs import Member, limits_of, rest_of
from flysid.export.wording import name_with_unit, plain, states_of, title_of, value_name
from flysid.model.polynomials import VANISHING
from flysid.model.rules.likely_start import HALVINGS, STEPS

Dialect = Literal["casadi", "jax"]


def python_file(members: Sequence[Member], name: str, dialect: Dialect) -> str:
    """The text of a file.

    `members`: one, or those of an ensemble.
    `name`: of the functions, as `identifier` makes it.
    """
    first = members[0].program
    alone = len(members) == 1
    ends = np.cumsum([0, *(len(m.program.memory) for m in members)])
    parts = [
        {"own": "" if alone else f"_{number}", "x": f"x[{begin}:{end}]"}
        for number, (begin, end) in enumerate(pairwise(ends.tolist()), 1)
    ]
    for part, member in zip(parts, members, strict=True):
        words = {"own": part["own"], **_words(member.program)}
        part["text"] = rendered(f"{dialect}_member.py.j2", member.program, name, words)
    rules = [m.program.memberships for m in members if m.program.memberships is not None]
    low, high = limits_of(members)
    words = {
        "py": python_literal,
        "title": title_of(members),
        "dt_exact": repr(float(first.dt_s)),
        "outputs": [
            {"name": name_with_unit(s), "low": f"{a:.6g}", "high": f"{b:.6g}"}
            for s, a, b in zip(first.outputs, low, high, strict=True)
        ],
        "members": parts,
        "mean": " + ".join(f"{m.share!r} * y{p['own']}" for m, p in zip(members, parts, strict=True)),
        "states": states_of(members),
        "rest": rest_of(members).tolist(),
        "input_names": [plain(s.name) for s in first.inputs],
        "output_names": [plain(s.name) for s in first.outputs],
        "multiplies": any(m.shape != "gaussian" and m.conjunction == "product" for m in rules),
        "reduces": any(m.shape != "gaussian" or m.conjunction == "minimum" for m in rules),
        "looks_for_nearest": any(m.shape != "gaussian" for m in rules),
        "past_rows": max(m.program.past_rows for m in members),
        "searches": any(isinstance(m.program.past, LikelyPast) for m in members),
        "steps": STEPS,
        "halvings": HALVINGS,
        "vanishing": VANISHING,
    }
    return rendered(f"{dialect}.py.j2", first, name, words)


def python_literal(values: Any) -> str:
    """A text, a number or nested rows of them, digit by digit."""
    if isinstance(values, str):
        return f'"{values}"'
    if np.ndim(values):
        return "[" + ", ".join(python_literal(v) for v in values) + "]"
    return repr(float(values))


def _words(program: Program) -> dict[str, Any]:
    """What the text of one program needs beside what C needs."""
    n = program.n
    lags = program.lags
    rules = len(program.theta)
    regressors = [
        value_name(program, (int(c), int(lag))) for c, lag in zip(lags.column, lags.lag, strict=True)
    ]
    antecedents = list(zip(lags.z_column, lags.z_lag, lags.z_minus, strict=True))
    return {
        "py": python_literal,
        "simulated": [name_with_unit(s) for s in program.states],
        "s_shift": program.shift[:n],
        "s_scale": program.scale[:n],
        "theta_all": list(program.theta),
        "regressors": regressors,
        "rule_names": [f"rule {r + 1}" for r in range(rules)],
        "antecedents": [_antecedent_name(program, *map(int, a)) for a in antecedents],
        "scheduling": [_scheduling(program, *map(int, a)) for a in antecedents],
        "known": _known(program),
        "workings": _workings(program),
        "kept": _kept(program),
        **_past_words(program),
        **({"right": program.memberships.right} if program.memberships is not None else {}),
    }


def _past_words(program: Program) -> dict[str, Any]:
    """How the memory follows from the last samples."""
    past = program.past
    rows = program.past_rows
    words: dict[str, Any] = {"past": "samples", "past_rows": rows}
    if isinstance(past, AffinePast):
        return words | {"past": "affine", "start_matrix": past.matrix}
    if past is None:
        return words | {"start_at": _places_of_memory(program, rows, rows, len(program.outputs), rows)}
    n_y = len(program.outputs)
    seen = np.flatnonzero(np.tile(np.arange(program.n) < n_y, past.moving))
    return words | {
        "past": "likely",
        "depth": past.depth,
        "moving": past.moving,
        "start_mean": past.mean,
        "start_root": past.root,
        "start_weight": past.weight,
        "start_seen": seen.tolist(),
        "start_at": _places_of_memory(program, rows, past.depth, program.n, past.moving),
    }


def _places_of_memory(program: Program, rows: int, end: int, width: int, states: int) -> list[int]:
    """Where the memory at sample `end` stands among inputs (rows, n_u) and quantities (states, width)."""
    n_u = len(program.inputs)
    places = []
    for column, lag in program.memory:
        if column >= program.n:
            places.append((end - lag) * n_u + column - program.n)
        else:
            places.append(rows * n_u + (states - lag) * width + column)
    return places


def _antecedent_name(program: Program, column: int, lag: int, minus: int) -> str:
    name = value_name(program, (column, lag))
    return name if minus < 0 else f"{name} - {value_name(program, (column, minus))}"


def _scheduling(program: Program, column: int, lag: int, minus: int) -> dict[str, str]:
    text = f"cell[{program.cell(column, lag)}]"
    if minus >= 0:
        text += f" - cell[{program.cell(column, minus)}]"
    return {"text": text, "words": _antecedent_name(program, column, lag, minus)}


def _spans(program: Program) -> list[tuple[int, int, int]]:
    """(column, begin, end) of every signal's past values in the memory, in its order; some are empty."""
    spans = []
    at = 0
    for column in (*range(program.n, len(program.signals)), *range(program.n)):
        spans.append((column, at, at + program.depths[column]))
        at += program.depths[column]
    return spans


def _known(program: Program) -> list[dict[str, str]]:
    """What fills the cells behind the constant, in their order."""
    parts = []
    for column, begin, end in _spans(program):
        j = column - program.n
        if j >= 0:
            parts.append({"text": f"now[{j}:{j + 1}]", "words": value_name(program, (column, 0))})
        if end > begin:
            words = _span_words(program, column, 1, end - begin)
            parts.append({"text": f"past[{begin}:{end}]", "words": words})
    return parts


def _kept(program: Program) -> list[dict[str, str]]:
    """What fills the next memory, in its order."""
    parts = []
    for column, begin, end in _spans(program):
        if end == begin:
            continue
        j = column - program.n
        newest = f"u[{j}:{j + 1}]" if j >= 0 else f"s[{column}:{column + 1}]"
        parts.append({"text": newest, "words": value_name(program, (column, 0))})
        if end > begin + 1:
            words = _span_words(program, column, 1, end - begin - 1)
            parts.append({"text": f"x[{begin}:{end - 1}]", "words": words})
    return parts


def _span_words(program: Program, column: int, first: int, last: int) -> str:
    newest = value_name(program, (column, first))
    return newest if first == last else f"{newest} to {value_name(program, (column, last))}"


_FORMS: dict[Operation, str] = {
    "change": "{a} - {b}",
    "magnitude": "{abs}({a})",
    "sign": "{sign}({a})",
    "product": "{a} * {b}",
    "held": "_limited({a}, {low}, {high})",
}


def _workings(program: Program) -> list[dict[str, str]]:
    first = len(program.signals)
    return [
        {
            "form": _FORMS[operation],
            "a": f"cell[{a}]",
            "b": f"cell[{b}]",
            "low": repr(low),
            "high": repr(high),
            "words": value_name(program, (first + number, 0)),
        }
        for number, (operation, _, a, b, low, high) in enumerate(program.working)
    ]
