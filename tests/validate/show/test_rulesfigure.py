"""The paper's figures 4 to 6 of models of rules: eight panels, equal bytes, harmless names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset, Signal
from flysid.errors import StoreError, UsageError
from flysid.model.arx import ARX
from flysid.model.static_ts import StaticTS
from flysid.model.ts import TS, over_lags
from flysid.validate.show.rulesfigure import draw_rules, write_rules_figure
from tests import model_examples

pytest.importorskip("matplotlib", reason="pip install matplotlib")

DATA = model_examples.data()
SEGMENT = DATA.segments[0]


def test_the_panels_show_what_the_model_says() -> None:
    model = StaticTS(rules=3).fit(DATA)
    panels = draw_rules(model, SEGMENT).axes
    assert [p.get_title(loc="left") for p in panels] == [f"({c})" for c in "abcdefgh"]
    x, grade = panels[0].lines[1].get_data()
    assert np.asarray(grade) == pytest.approx(model.memberships(0, np.asarray(x))[:, 1])
    run = model.simulate(SEGMENT.u)[:, 0]
    assert np.asarray(panels[1].lines[1].get_ydata()) == pytest.approx(run)
    assert np.asarray(panels[2].lines[0].get_ydata()) == pytest.approx(SEGMENT.y[:, 0] - run)
    u, steady = panels[4].lines[1].get_data()
    assert np.asarray(steady) == pytest.approx(model.simulate(np.asarray(u)[:, None])[:, 0], abs=1e-9)
    strength = model.firing(SEGMENT.u, SEGMENT.y)
    drawn = [line.get_ydata() for panel in panels[6:] for line in panel.lines]
    assert np.stack([np.asarray(d) for d in drawn], axis=1) == pytest.approx(strength)
    said = np.asarray(panels[5].lines[0].get_ydata())
    assert np.array_equal(np.isnan(said), strength[:, 0] < 0.25)


@pytest.mark.parametrize("rules", [1, 2])
def test_dynamic_rules_are_drawn_in_free_run(rules: int, tmp_path: Path) -> None:
    model = over_lags(TS(rules=rules, na=rules, nb=1, nk=1, iterations=3), DATA)
    panels = draw_rules(model, SEGMENT).axes
    run = model.free_run(SEGMENT)[:, 0]
    assert np.asarray(panels[1].lines[1].get_ydata()) == pytest.approx(run)
    path = write_rules_figure(tmp_path / "new" / "figure-4.svg", model, SEGMENT)
    assert path.read_bytes() == write_rules_figure(tmp_path / "again.svg", model, SEGMENT).read_bytes()


def test_names_from_logs_are_text(tmp_path: Path) -> None:
    evil = "$\\frac{$ ../x \x1b"
    named = Dataset.from_arrays(
        SEGMENT.u, SEGMENT.y, DATA.dt_s, inputs=[Signal(evil, evil)], outputs=[Signal("y", evil)]
    )
    path = write_rules_figure(tmp_path / "f.svg", StaticTS(rules=2).fit(named), named.segments[0])
    assert "$\\frac{$ ../x" in path.read_text("utf-8")


def test_what_cannot_be_drawn_is_named(tmp_path: Path) -> None:
    model = StaticTS(rules=2).fit(DATA)
    with pytest.raises(UsageError, match=r"no picture format '\.gif'"):
        write_rules_figure(tmp_path / "f.gif", model, SEGMENT)
    with pytest.raises(UsageError, match="no rules to draw"):
        draw_rules(ARX(na=1, nb=1, nk=1, refine=False).fit(DATA), SEGMENT)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="no output 3"):
        draw_rules(model, SEGMENT, output=3)
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError):
        write_rules_figure(tmp_path / "file" / "f.svg", model, SEGMENT)
