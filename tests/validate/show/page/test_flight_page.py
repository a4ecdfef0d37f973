"""`flysid plot`: the page in a real browser, pictures, text, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.errors import UsageError
from flysid.ingest.lake.timeline import Moment, Timeline, Trace
from flysid.validate.show.page.decimate import extremes
from flysid.validate.show.page.flight_page import render_flights
from flysid.validate.show.page.html import write_page
from tests.browser import needs_browser, opened
from tests.samplelogs import dataflash

HOSTILE = "</script><script>document.title=1</script>[red]"
SPIKE = 123_456
INKED_ABOVE = """
const canvas = document.querySelectorAll('.chart canvas')[1], pen = canvas.getContext('2d');
const ink = getComputedStyle(document.documentElement).getPropertyValue('--r6').trim();
const want = [1, 3, 5].map(i => parseInt(ink.slice(i, i + 2), 16));
const p = pen.getImageData(0, canvas.height * 0.15, canvas.width, canvas.height * 0.3).data;
let n = 0;
for (let i = 0; i < p.length; i += 4) {
  if (want.every((c, k) => Math.abs(p[i + k] - c) < 40) && p[i + 3] > 128) { n++; }
}
return n;
"""  # pixels in the line's colour where only the spike reaches


def timeline(n: int = 200_000) -> Timeline:
    time_s = np.arange(n) / 1000.0
    values = np.sin(time_s)
    values[SPIKE % n] = 50.0
    values[n // 4 : n // 4 + 1000] = np.nan
    traces = (Trace("ATT.Roll", "deg", time_s, values), Trace(HOSTILE, "", time_s[::10], values[::10]))
    return Timeline(
        HOSTILE, (traces, traces[:1]), ((0.0, 100.0, "LOITER"),), (Moment(5.0, "message", HOSTILE),)
    )


def test_thinning_keeps_every_peak_and_every_gap() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=10_007)
    values[[0, 5_000, 10_006]] = 99.0, -99.0, np.nan
    kept = extremes(values, 100)
    assert (np.diff(kept) > 0).all()
    assert len(kept) <= 2 * 101 + 1
    assert {0, 5_000, 10_006} <= set(kept.tolist())
    np.testing.assert_array_equal(extremes(values, 2), np.arange(10_007))


def test_the_page_says_that_it_is_thinned() -> None:
    assert "samples at a time" not in render_flights([timeline(1000 * 5)], "a")
    page = render_flights([timeline()], "a", most_samples=10_000)
    assert "samples at a time: no peak is lost" in page
    assert len(page) < 600_000


@needs_browser
def test_zoom_is_shared_a_spike_shows_at_every_zoom_and_nothing_hostile_runs(
    browser: Any, tmp_path: Path
) -> None:
    path = write_page(tmp_path / "p.html", render_flights([timeline()], HOSTILE))
    assert opened(browser, path) == []
    assert browser.execute_script("return document.documentElement.dataset.ready") == "yes"
    assert HOSTILE in browser.title
    assert browser.execute_script("return document.querySelectorAll('.chart canvas').length") == 2
    assert browser.execute_script(INKED_ABOVE) > 0, "one sample in 200,000 is drawn"
    box = browser.find_element("css selector", ".chart")
    span = "const s = document.querySelector('.flight').dataset; return [+s.from, +s.to]"
    assert browser.execute_script(span) == pytest.approx([0.0, 199.999])
    box.send_keys("+")
    zoomed = browser.execute_script(span)
    assert zoomed == pytest.approx([50.0, 150.0], rel=0.01)
    box.send_keys("0")
    assert browser.execute_script(span) == pytest.approx([0.0, 199.999])
    browser.execute_script(
        "document.querySelector('details').open = true; document.querySelector('.go').click()"
    )
    assert browser.execute_script(span) == pytest.approx([0.0, 10.0])
    assert browser.get_log("browser") == []


def test_a_log_is_plotted_as_page_picture_and_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("0001.BIN").write_bytes(dataflash.build())

    def plot(*arguments: str) -> str:
        done = CliRunner().invoke(root, ["plot", "0001.BIN", *arguments], catch_exceptions=False)
        assert done.exit_code == 0
        return done.stdout.strip()

    assert plot("ATT.*") == "0001.BIN.html"
    data = Path("0001.BIN.html").read_text().partition('id="data">')[2].partition("</script>")[0]
    names = {trace["name"] for panel in json.loads(data)[0]["panels"] for trace in panel}
    assert "ATT.Roll" in names
    pytest.importorskip("matplotlib")
    plot("ATT.Roll", "-o", "roll.png")
    assert Path("roll.png").read_bytes()[:4] == b"\x89PNG"
    pytest.importorskip("plotext")
    assert "ATT.Roll" in plot("ATT.Roll", "--term")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["ATT.Rol"], "no numeric field"),
        (["ATT.Roll", "--pair", "attitude"], "each say what to draw"),
        (["ATT.Roll", "-o", "0001.BIN"], "the target exists"),
        (["ATT.Roll", "-o", "roll.docx"], "no picture format"),
        (["--flight", "9"], "no flight"),
    ],
)
def test_what_cannot_be_plotted_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("0001.BIN").write_bytes(dataflash.build())
    done = CliRunner().invoke(root, ["plot", "0001.BIN", *arguments])
    assert isinstance(done.exception, UsageError)
    assert words in str(done.exception)
