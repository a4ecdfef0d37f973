"""Two inputs, two outputs: every output is its own entry, section and table row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.model.arx import ARX
from flysid.model.start import start_window
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.condition import matching_channels
from flysid.validate.compare.models import across_channels
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.document import to_json
from flysid.validate.show.page import ReportContext, render
from flysid.validate.show.terminal import summary, table


def flights(count: int, seed: int) -> Dataset:
    """y1 follows u1; y2 follows u2 and the one before."""
    rng = np.random.default_rng(seed)
    us = []
    ys = []
    for _ in range(count):
        u = np.repeat(rng.normal(size=(40, 2)), 10, axis=0)
        y = np.zeros((400, 2))
        for k in range(2, 400):
            y[k, 0] = 0.9 * y[k - 1, 0] + 0.1 * u[k - 1, 0]
            y[k, 1] = 0.8 * y[k - 1, 1] + 0.1 * u[k - 1, 1] + 0.4 * u[k - 2, 1]
        us.append(u)
        ys.append(y + 0.02 * rng.normal(size=y.shape))
    data = Dataset.from_arrays(us, ys, 0.05, inputs=["phi", "theta"], outputs=["v_x", "v_y"])
    return replace(data, name="body")


@pytest.fixture(scope="module")
def compared() -> Comparison:
    train = flights(3, 0)
    simple, full = (ARX(na=1, nb=nb, nk=1, refine=False).fit(train) for nb in (1, 2))
    return compare({"arx": simple, "ts": full}, flights(6, 1))


def test_every_output_has_its_verdict(compared: Comparison) -> None:
    assert list(compared.verdict) == ["v_x", "v_y"]
    assert compared.verdict["v_y"].verdict == "better"
    document = to_json({"body": compared})
    assert list(document["channels"]) == ["body/v_x", "body/v_y"]
    assert "body/v_y" in matching_channels("free_run.verdict == better", document)
    assert set(matching_channels('"body/v_y".free_run.change_pct < -5', document)) == {"body/v_x", "body/v_y"}


def test_errors_are_those_of_the_output(compared: Comparison) -> None:
    entry = compared.entry("v_y", "1")
    ts = compared.fitted["ts"]
    errors = []
    for s in compared.test.segments:
        window = start_window(compared.lags, len(s), compared.dt_s)
        errors.append((s.y - ts.predict(s.u, s.y, 1))[window:, 1])
    rmse = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    assert entry.models["ts"].scores.rmse == pytest.approx(rmse, rel=1e-12)


def test_forms_name_every_output(compared: Comparison) -> None:
    both = across_channels({"body": compared, "again": compared})
    page = render(ReportContext.of(both))
    for i in (0, 1):
        for j in (0, 1):
            assert f'id="c{i}-{j}"' in page
    assert "body/v_x" in table(both)
    assert len(summary(both).splitlines()) == 4
    assert all(p.p_holm is None or p.p is None or p.p_holm >= p.p for p in both["body"].verdict.values())
