"""Fuzzy clustering in the product space: where rules lie, and how wide they are.

"fuzzy-c-means" (Bezdek 1981), "gustafson-kessel" (Gustafson and Kessel 1979, with the covariance
conditioning of Babuska, van der Veen, Kaymak 2002) and "subtractive" (Chiu 1994), all on standardised
columns, with Bezdek's usual exponent of 2. Starts are drawn with k-means++ (Arthur and Vassilvitskii 2007)
from a seeded generator: the same data and seed give the same clusters. Cost per iteration: N R d for c-means,
N R d^2 for Gustafson-Kessel; long records are thinned to `MOST_SAMPLES` rows first, which moves centres less
than their own spread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.polynomials import ROUNDING
from flysid.showing import counted

Method = Literal["gustafson-kessel", "fuzzy-c-means", "subtractive"]

MOST_SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of rows of X.

    Attributes
    ----------
    centre : (R, d) in the units of X.
    grade : (N, R) membership of every row used, rows sum to 1.
    rows : (N, d) the rows used (thinned X).
    """

    centre: FloatArray
    grade: FloatArray
    rows: FloatArray


def cluster(X: FloatArray, rules: int, method: Method = "gustafson-kessel", *, seed: int = 0) -> Clusters:
    """Divide the rows of X (N, d) into `rules` fuzzy clusters.

    Raises
    ------
    UsageError : unknown method, or fewer than one rule.
    DataError : fewer distinct rows than rules.
    """
    if method not in _METHODS:
        raise UsageError(f"unknown clustering {method!r}", hint="one of " + ", ".join(_METHODS))
    if rules < 1:
        raise UsageError(f"{rules} rules were asked for", hint="ask for at least one")
    rows = X[:: max(1, -(-len(X) // MOST_SAMPLES))]
    distinct = len(np.unique(rows, axis=0))
    if distinct < rules:
        raise DataError(
            f"{counted(rules, 'rule')} asked for, but the data hold {counted(distinct, 'distinct sample')}",
            hint="ask for fewer rules, or bring data that vary more",
        )
    spread = rows.std(axis=0)
    spread[spread == 0] = 1.0
    shift = rows.mean(axis=0)
    standard = (rows - shift) / spread
    centre, grade = _METHODS[method](standard, rules, np.random.default_rng(seed))
    return Clusters(centre * spread + shift, grade, rows)


def project(
    clusters: Clusters, columns: int, *, two_sided: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre, left and right width (R, columns) of every cluster in the first columns, ordered by centre.

    Widths are fuzzy standard deviations about the centre; two-sided ones count each side by itself. No
    width is below a tenth of the distance to the next centre: the sets of neighbours always overlap.
    """
    order = np.argsort(clusters.centre[:, 0], kind="stable")
    centre = clusters.centre[order, :columns]
    weight = clusters.grade[:, order] ** 2
    gap = clusters.rows[:, None, :columns] - centre[None, :, :]
    both = _spread(gap, weight, np.ones_like(gap))
    left = _spread(gap, weight, (gap < 0).astype(float)) if two_sided else both
    right = _spread(gap, weight, (gap > 0).astype(float)) if two_sided else both
    span = np.ptp(clusters.rows[:, :columns], axis=0)
    floor = np.where(span > 0, span, 1.0) / (10.0 * len(centre))
    return centre, np.maximum(left, floor), np.maximum(right, floor)


def _spread(gap: FloatArray, weight: FloatArray, counted: FloatArray) -> FloatArray:
    mass = (weight[:, :, None] * counted).sum(axis=0)
    square = (weight[:, :, None] * counted * gap * gap).sum(axis=0)
    return np.asarray(np.sqrt(square / np.maximum(mass, 1e-12)))


def _seeds(X: FloatArray, rules: int, rng: np.random.Generator) -> FloatArray:
    """k-means++ seeds, settled by ten rounds of k-means."""
    centre = X[[rng.integers(len(X))]]
    while len(centre) < rules:
        square = _squares(X, centre).min(axis=1)
        total = square.sum()
        share = square / total if total > 0 else np.full(len(X), 1.0 / len(X))
        centre = np.vstack([centre, X[rng.choice(len(X), p=share)]])
    for _ in range(10):
        nearest = _squares(X, centre).argmin(axis=1)
        for r in range(rules):
            if (nearest == r).any():
                centre[r] = X[nearest == r].mean(axis=0)
    return centre


def _squares(X: FloatArray, centre: FloatArray) -> FloatArray:
    """(N, R) squared distances."""
    gap = X[:, None, :] - centre[None, :, :]
    return np.asarray((gap * gap).sum(axis=2))


def _grades(square: FloatArray) -> FloatArray:
    """Memberships of Bezdek's update; a row on a centre belongs to it."""
    inverse = 1.0 / np.maximum(square, 1e-300)
    inverse = np.minimum(inverse, 1e150)
    return np.asarray(inverse / inverse.sum(axis=1, keepdims=True))


def _iterate(
    X: FloatArray, centre: FloatArray, squares: Callable[[FloatArray, FloatArray], FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Alternate centres and grades until no grade moves by 1e-4, at most 60 times."""
    grade = _grades(_squares(X, centre))
    for _ in range(60):
        weight = grade**2
        centre = weight.T @ X / np.maximum(weight.sum(axis=0), 1e-300)[:, None]
        before = grade
        grade = _grades(squares(centre, weight))
        if np.abs(grade - before).max() < 1e-4:
            break
    return centre, grade


def _fuzzy_c_means(X: FloatArray, rules: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return _iterate(X, _seeds(X, rules, rng), lambda centre, _: _squares(X, centre))


def _gustafson_kessel(X: FloatArray, rules: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Distances in each cluster's own metric, of unit volume."""
    overall = np.cov(X, rowvar=False, bias=True).reshape(X.shape[1], X.shape[1])

    def squares(centre: FloatArray, weight: FloatArray) -> FloatArray:
        result = np.empty((len(X), len(centre)))
        for r, c in enumerate(centre):
            gap = X - c
            covariance = (weight[:, r, None] * gap).T @ gap / max(weight[:, r].sum(), 1e-300)
            metric = _unit_volume_inverse(0.99 * covariance + 0.01 * overall)
            result[:, r] = ((gap @ metric) * gap).sum(axis=1)
        return np.maximum(result, 0.0)

    return _iterate(X, _seeds(X, rules, rng), squares)


def _unit_volume_inverse(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    values = np.maximum(values, max(values[-1] * ROUNDING, 1e-12))
    volume = np.exp(np.log(values).mean())
    return np.asarray(vectors / values * volume @ vectors.T)


def _subtractive(X: FloatArray, rules: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Chiu's mountains: the sample with most neighbours, then the most once those are subtracted."""
    del rng  # deterministic
    radius = 2.0 * np.sqrt(X.shape[1]) / rules
    potential = np.zeros(len(X))
    for begin in range(0, len(X), 256):
        potential[begin : begin + 256] = np.exp(-4.0 / radius**2 * _squares(X[begin : begin + 256], X)).sum(
            axis=1
        )
    chosen: list[int] = []
    for _ in range(rules):
        peak = int(np.where(np.isin(np.arange(len(X)), chosen), -np.inf, potential).argmax())
        chosen.append(peak)
        near = np.exp(-4.0 / (1.5 * radius) ** 2 * _squares(X, X[[peak]])[:, 0])
        potential = potential - potential[peak] * near
    centre = X[chosen]
    return centre, _grades(_squares(X, centre))


_METHODS: dict[str, Callable[[FloatArray, int, np.random.Generator], tuple[FloatArray, FloatArray]]] = {
    "gustafson-kessel": _gustafson_kessel,
    "fuzzy-c-means": _fuzzy_c_means,
    "subtractive": _subtractive,
}
