"""Edits that leave a TS model with fewer words: two rules as one, a rule dropped, a condition left out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.free_run_error import Body, Stage
from flysid.model.rules.growth import best_started
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.refit import as_problem
from flysid.model.rules.regressor_layout import Layout


def edits(layout: Layout, p: Parameters, support: FloatArray) -> Iterator[tuple[str, Layout, Parameters]]:
    """Every pair of rules merged, every rule dropped, every antecedent left out."""
    share = np.maximum(support, 1e-3)
    rules, n_z = p.centre.shape
    if rules == 1:
        return
    for i, j in combinations(range(rules), 2):
        yield f"R{i + 1} and R{j + 1} merged", layout, _merged(p, i, j, share)
    if rules > 2:
        for r in range(rules):
            yield f"R{r + 1} dropped", layout, _kept(p, np.delete(np.arange(rules), r))
    for z in range(n_z if n_z > 1 else 0):
        rest = np.delete(np.arange(n_z), z)
        antecedents = tuple(layout.antecedents[k] for k in rest)
        fewer = p._replace(
            centre=p.centre[:, rest], width=p.width[:, rest], z_range=np.ascontiguousarray(p.z_range[:, rest])
        )
        yield (
            f"conditions on {layout.antecedents[z].name(layout.signals)} left out",
            replace(layout, antecedents=antecedents),
            _kept(fewer, np.arange(rules)),
        )


def _merged(p: Parameters, i: int, j: int, share: FloatArray) -> Parameters:
    """Rules i and j as one: means weighted by support; the set covers both."""
    w = np.array([share[i], share[j]]) / (share[i] + share[j])
    centre = w @ p.centre[[i, j]]
    spread = w @ (p.width[[i, j]] ** 2 + (p.centre[[i, j]] - centre) ** 2)
    kept = _kept(p, np.delete(np.arange(len(p.theta)), j))
    at = i if i < j else i - 1
    kept.theta[at] = np.tensordot(w, p.theta[[i, j]], axes=1)
    kept.centre[at], kept.width[at] = centre, np.sqrt(spread)
    return kept


def _kept(p: Parameters, rules: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Parameters:
    """A copy with some of the rules."""
    return p._replace(theta=p.theta[rules].copy(), centre=p.centre[rules].copy(), width=p.width[rules].copy())


def staged(layout: Layout, p: Parameters, runs: tuple[FloatArray, ...]) -> Iterator[Stage]:
    """The edited model as a stage of refinement; nothing where there are no runs."""
    if runs:
        problem, body = as_problem(layout, p, runs)
        yield best_started(problem, _apart(body))


def _apart(body: Body) -> Body:
    """A single rule says the same everywhere: its set is written as one that covers everything."""
    if len(body.a) > 1:
        return body
    return replace(body, centre=np.zeros_like(body.centre), width=np.ones_like(body.width))
