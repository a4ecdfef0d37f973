"""A .fis file says what the model does: read back and evaluated as the toolbox's manual defines it."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pytest

from flysid.export.fis import fis_text, why_no_fis
from flysid.export.matlab import matlab_files
from flysid.export.programs import program_of
from flysid.model.rules.memberships import Conjunction, Shape
from flysid.model.static_ts import StaticTS
from tests.model_examples import data, fitted

MF = re.compile(r"MF\d+='R\d+':'(\w+)',\[(.*)\]")


@dataclass
class Sugeno:
    """A Sugeno system: sets by input, consequents by output."""

    sets: list[list[tuple[str, list[float]]]]
    then: list[list[list[float]]]
    minimum: bool
    rules: list[tuple[list[int], list[int]]]

    @classmethod
    def read(cls, text: str) -> Sugeno:
        parts = re.split(r"^\[(\w+)\]$", text, flags=re.M)
        named = dict(zip(parts[1::2], parts[2::2], strict=True))
        found = {
            k: [(m[1], [float(v) for v in m[2].split()]) for m in MF.finditer(body)]
            for k, body in named.items()
        }
        rules = []
        for line in named["Rules"].split("\n"):
            if line:
                given, then = line.split(" (")[0].split(",")
                rules.append(([int(v) for v in given.split()], [int(v) for v in then.split()]))
        return cls(
            [found[k] for k in named if k.startswith("Input")],
            [[row for _, row in found[k]] for k in named if k.startswith("Output")],
            "AndMethod='min'" in named["System"],
            rules,
        )

    def __call__(self, u: np.ndarray) -> np.ndarray:
        total = 0.0
        out = np.zeros(len(self.then))
        for given, then in self.rules:
            grades = [grade(*self.sets[j][mf - 1], float(u[j])) for j, mf in enumerate(given)]
            w = min(grades) if self.minimum else float(np.prod(grades))
            total += w
            out += [w * float(np.dot(self.then[i][mf - 1], [*u, 1.0])) for i, mf in enumerate(then)]
        return out / total if total > 0.0 else np.full(len(out), np.nan)


def grade(kind: str, p: list[float], x: float) -> float:
    if kind == "gaussmf":
        return float(np.exp(-((x - p[1]) ** 2) / (2 * p[0] ** 2)))
    if kind == "gauss2mf":
        left = np.exp(-((x - p[1]) ** 2) / (2 * p[0] ** 2)) if x < p[1] else 1.0
        right = np.exp(-((x - p[3]) ** 2) / (2 * p[2] ** 2)) if x > p[3] else 1.0
        return float(left * right)
    a, *tops, d = p
    return float(max(min((x - a) / (tops[0] - a), 1.0, (d - x) / (d - tops[-1])), 0.0))


@pytest.mark.parametrize("shape", ["gaussian", "triangle", "trapezoid"])
@pytest.mark.parametrize("conjunction", ["product", "minimum"])
def test_inside_the_ranges_it_is_the_model(shape: Shape, conjunction: Conjunction) -> None:
    settings = StaticTS(rules=3, shape=shape, conjunction=conjunction)
    model = settings.fit(data(2, 2))
    program = program_of(model)
    m = program.memberships
    assert m is not None
    system = Sugeno.read(fis_text(program, "plant"))
    rng = np.random.default_rng(2)
    u = rng.uniform(m.low, m.high, (200, 2))
    y = model.simulate(u)
    found = np.array([system(row) for row in u])
    inside = np.isfinite(found).all(axis=1) & (
        (found > program.output_limits[0]) & (found < program.output_limits[1])
    ).all(axis=1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(found[inside], y[inside], rtol=0.0, atol=1e-9 * np.ptp(y))


def test_only_static_rules_have_one() -> None:
    assert "plant.fis" in matlab_files(fitted("static ts"), program_of(fitted("static ts")), "plant")
    assert "remembers" in why_no_fis(program_of(fitted("ts")))
    assert "linear" in why_no_fis(program_of(fitted("oe")))
