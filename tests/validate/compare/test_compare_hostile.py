"""Whatever the data, the models and the names: plain numbers, one of four verdicts, literal text."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError
from flysid.model.start import start_window
from flysid.validate.compare.verdict import Verdict
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.diagnostics import diagnose
from flysid.validate.diagnose.document import to_json
from flysid.validate.show.page import ReportContext, render
from flysid.validate.show.tables import to_csv, to_markdown
from flysid.validate.show.terminal import summary, table
from tests.fakes import FirstOrder

ARX = FirstOrder(a=0.9, b=0.08)
TS = FirstOrder(a=0.9, b=0.1, structure="ts", labels=("R1", "R2"), limit=np.inf)


@dataclass(frozen=True, eq=False)
class Wild(FirstOrder):
    """Returns what no model may: infinities, NaN, huge values, from some row on."""

    value: float = np.nan
    structure: str = "ts"

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        y = super().simulate(u, y0)
        y[len(y) // 2 :] = self.value
        return y

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        out = super().predict(u, y, k)
        out[len(out) // 2 :] = self.value
        return out


def every_form(models: dict[str, FirstOrder], test: Dataset, train: Dataset, *, page: bool = True) -> str:
    """Compares and renders in all forms; the verdict in free run."""
    c = compare(models, test)
    text = json.dumps(to_json({"x": c}, {"x": diagnose(c, train)}), allow_nan=False)
    assert json.loads(text)["channels"]["x"]["free_run"]["verdict"] in set(Verdict)
    html = render(ReportContext({"x": c}, train={"x": train})) if page else ""
    for form in (html, table({"x": c}), summary({"x": c}), to_csv({"x": c}), to_markdown({"x": c})):
        assert "nan" not in form.replace("nance", "").split()
        assert "inf" not in form.split()
    return str(c.verdict["y"].verdict)


def dataset(u: FloatArray, y: FloatArray, pieces: int = 1) -> Dataset:
    segments = [
        Segment(a, b, flight=f"f{i}")
        for i, (a, b) in enumerate(zip(np.array_split(u, pieces), np.array_split(y, pieces), strict=True))
    ]
    return Dataset(ARX.dt_s, ARX.inputs, ARX.outputs, tuple(segments), name="x")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e200])
def test_a_model_that_breaks_the_laws_loses(value: float) -> None:
    rng = np.random.default_rng(0)
    u = rng.normal(size=(400, 1))
    y = ARX.simulate(u) + 0.01 * rng.normal(size=(400, 1))
    data = dataset(u, y, 2)
    verdict = every_form({"arx": ARX, "ts": Wild(value=value, limit=np.inf)}, data, data)
    assert verdict == "worse"


KINDS = ("noise", "constant", "zero", "steps", "ramp", "huge", "tiny", "one spike")


def signal(kind: str, n: int, rng: np.random.Generator) -> FloatArray:
    """(n, 1) of one kind."""
    noise = rng.normal(size=n)
    made = {
        "noise": noise,
        "constant": np.full(n, 3.3),
        "zero": np.zeros(n),
        "steps": np.round(np.cumsum(noise)),
        "ramp": np.linspace(0.0, 1.0, n),
        "huge": 1e150 * noise,
        "tiny": 1e-150 * noise,
        "one spike": np.where(np.arange(n) == n // 2, 1e6, 0.0),
    }
    return made[kind][:, None]


@settings(deadline=None, max_examples=25)
@example("tiny", "noise", 21, 1, 0)
@example("one spike", "tiny", 21, 1, 55)
@given(
    st.sampled_from(KINDS), st.sampled_from(KINDS), st.integers(1, 160), st.integers(1, 7), st.integers(0, 99)
)
def test_any_data_gives_plain_numbers_or_a_named_error(
    u_kind: str, y_kind: str, n: int, pieces: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    test = dataset(signal(u_kind, n, rng), signal(y_kind, n, rng), min(pieces, n))
    train = dataset(signal(y_kind, 50, rng), signal(u_kind, 50, rng))
    models = {"arx": ARX, "ts": TS}
    longest = max(len(s) for s in test.segments)
    if longest < start_window(1, longest, test.dt_s) + 10 + 9:  # start, samples to score, k - 1 of ten steps
        with pytest.raises(DataError, match="the longest has"):
            every_form(models, test, train)
    else:
        every_form(models, test, train, page=seed < 10)


@pytest.mark.parametrize(
    "payload",
    [
        "<svg/onload=hacked=1>", "javascript:hacked=1", "'-hacked-'", "{{ 7*7 }}{% for x in y %}",
        "]]>--><!--", "&lt;script&gt;", "\u202e\u2066evil", "a\x00b\x07", "=HYPERLINK(\"x\")",
        "| a | b |\n|---|",
        "x" * 3000, "", "\ud83d\ude00", "../../etc/passwd", "%s%n{}", "</style><style>*{display:none}",
    ],
)  # fmt: skip
def test_hostile_strings_in_every_form(payload: str) -> None:
    outputs = (replace(ARX.outputs[0], unit=payload),)
    inputs = (replace(ARX.inputs[0], name=payload or "u"),)
    rng = np.random.default_rng(0)
    u = rng.normal(size=(200, 1))
    data = replace(dataset(u, ARX.simulate(u), 2), inputs=inputs, outputs=outputs)
    models = {
        "arx": replace(ARX, inputs=inputs, outputs=outputs, notes=(payload,)),
        "ts": replace(TS, inputs=inputs, outputs=outputs, labels=(payload, payload)),
    }
    c = compare(models, data)
    page = render(ReportContext({payload: c}, train={payload: data}, command=payload, remark=payload))
    assert page.count("<script") == 3
    assert "<svg/onload" not in page
    assert "</style><style>" not in page
    forms = (table({payload: c}), summary({payload: c}), to_csv({payload: c}), to_markdown({payload: c}))
    for form in forms:
        assert all(character == "\n" or character.isprintable() for character in form)
    json.dumps(to_json({payload: c}), allow_nan=False).encode("utf-8")
