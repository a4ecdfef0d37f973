"""The page: whole, self-contained, safe with hostile names, drawn for any model."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import dataclass, replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import flysid
from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import StoreError
from flysid.loops.judged import judge
from flysid.loops.nyquist import curve_of
from flysid.model.base import Rule
from flysid.showing import number
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.bands import BandCurve
from flysid.validate.show.page import ReportContext, Sweep, render, write_report
from flysid.validate.show.page.decimate import decimate, round_for_json
from flysid.validate.show.page.figures import bode, sweep_figure
from flysid.validate.show.page.gainpanels import nyquist
from flysid.validate.show.page.overlay import Role
from flysid.validate.show.page.rulefigures import antecedent_range, membership_figures
from flysid.validate.show.page.svg import HALF, log_ticks, ticks
from flysid.validate.show.shown import ShownComparison
from tests.fakes import FirstOrder, flown
from tests.flysid.loops.test_loops import log_of

ARX = FirstOrder(a=0.9, b=0.07)
TS = FirstOrder(a=0.9, b=0.1, structure="ts", labels=("R1", "R2", "R3"))
ASSETS = Path(__file__).resolve().parents[4] / "validate" / "show" / "page" / "assets"
HOSTILE = "</script><script>hacked=1</script><img src=x onerror=hacked=2>\"'{{7*7}}\u2028\x1b[31m"


@cache
def compared() -> ShownComparison:
    return compare([ARX, TS], flown(TS, [400] * 6, noise=0.02))


def context() -> ReportContext:
    sweep = Sweep((1, 2, 3), (0.4, 0.3, 0.29), (0.02, 0.02, 0.02), 3, (0.41, 0.03), "by hand")
    train = flown(TS, [500] * 4, noise=0.02, seed=9)
    return ReportContext(
        {"roll": compared()}, train={"roll": train}, sweeps={"roll": sweep}, command="flysid validate run"
    )


@cache
def rendered() -> str:
    return render(context())


class Page(HTMLParser):
    """Collects elements, attributes, scripts and the visible text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.inside: dict[str, list[str]] = {"script": [], "style": []}
        self.text: list[str] = []
        self._open = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag in self.inside:
            self._open = tag
            self.inside[tag].append("")

    def handle_endtag(self, tag: str) -> None:
        if tag == self._open:
            self._open = ""

    def handle_data(self, data: str) -> None:
        if self._open:
            self.inside[self._open][-1] += data
        else:
            self.text.append(data)

    @property
    def words(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.text))


def test_page_says_the_verdict_and_loads_nothing() -> None:
    page = Page(rendered())
    assert "The fuzzy model is better on another flight like these, on roll." in page.words
    for tag, attributes in page.tags:
        assert tag not in {"link", "iframe", "object", "embed", "img", "base"}
        assert "style" not in attributes, "the policy forbids style attributes"
        assert not any(name.startswith("on") for name in attributes)
        assert attributes.get("src") is None
        href = attributes.get("href")
        assert href is None or href.startswith("#")


def test_every_script_and_style_is_in_the_policy_by_hash() -> None:
    page = Page(rendered())
    (policy,) = [a["content"] for t, a in page.tags if t == "meta" and "http-equiv" in a]
    assert policy is not None
    kinds = [a.get("type") for t, a in page.tags if t == "script"]
    blocks = [s for s, kind in zip(page.inside["script"], kinds, strict=True) if kind is None]
    assert len(blocks) == 2
    for block in (*blocks, *page.inside["style"]):
        digest = base64.b64encode(hashlib.sha256(block.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert "unsafe" not in policy
    assert policy.startswith("default-src 'none'")


def test_a_stranger_learns_who_is_who_and_in_what_unit() -> None:
    words = Page(rendered()).words
    assert "Fuzzy model (TS) against linear model (ARX) on 6 held-out segments" in words
    assert "steady gain m/s per deg" in words
    assert words.count("R1 R2 R3") == 2  # below the strip, above the pictures of rules along time
    assert "where each model settles for a constant input" in words
    assert "Dashed: ARX. Solid: R1, R2, R3, in the colours of the table of rules." in words


def test_rules_in_the_key_have_the_one_word_of_their_condition() -> None:
    @dataclass(frozen=True, eq=False)
    class Said(FirstOrder):
        more: str = ""

        def rules(self) -> tuple[Rule, ...]:
            conditions = ("v is A1 'slow <b>' (about 1)", f"v is A2 'fast' (about 2){self.more}")
            return tuple(replace(r, condition=c) for r, c in zip(super().rules(), conditions, strict=True))

    said = Said(a=0.9, b=0.1, structure="ts", labels=("R1", "R2"))
    for model, keys in (
        (said, ("R1 slow &lt;b&gt;", "R2 fast")),
        (replace(said, more=" and u is A2 'low' (0)"), ("R1", "R2")),
    ):
        page = render(ReportContext({"roll": compare([ARX, model], flown(said, [400] * 6, noise=0.02))}))
        assert all(f"</span>{key}</span>" in page for key in keys)


def test_long_facts_are_folded_and_nothing_is_told_twice() -> None:
    long = "; ".join(f"flight {i}: 1 segments, 0 gaps, 0 short segments dropped" for i in range(12))
    facts = {"alignment": long, "held-out sha256": compared().test_hash, "version of numpy": "2.4"}
    page = render(replace(context(), provenance=facts | {"version of flysid": "9.9"}))
    assert "<summary>flight 0: 1 segments, 0 gaps, 0 short segments dropped</summary>" in page
    assert page.count(compared().test_hash) == 1
    assert "<dt>versions</dt><dd>numpy 2.4, flysid 9.9</dd>" in page


def test_the_label_of_the_chosen_count_stands_away_from_the_line() -> None:
    for errors, below in (((0.5, 0.2, 0.4), True), ((0.1, 0.2, 0.15), False), ((0.5, 0.2, 0.19), True)):
        picture = sweep_figure(Sweep((1, 2, 3), errors, (0.0,) * 3, 2), "m")
        (y,) = re.findall(r'y="([\d.]+)"[^>]*>chosen: 2', picture)
        (ring,) = re.findall(r'd="M[\d.]+ ([\d.]+)h0" class="ring"', picture)
        assert (float(y) > float(ring)) is below
    assert "chosen: 1" in sweep_figure(Sweep((1,), (0.5,), (0.0,), 1), "m")


def test_of_many_segments_the_worst_are_among_those_drawn() -> None:
    quiet = flown(TS, [60] * 70, noise=0.01)
    odd = [replace(s, y=s.y + (2.0 if i in (65, 69) else 0.0)) for i, s in enumerate(quiet.segments)]
    c = compare([ARX, TS], quiet.with_segments(odd))
    page = Page(render(ReportContext.of({"x": c})))
    (shown,) = json.loads(page.inside["script"][0])
    labels = [s["label"] for s in shown["segments"]]
    assert len(labels) == 60
    assert {"flight-65", "flight-69"} <= set(labels)
    assert labels == sorted(labels, key=lambda label: int(label.removeprefix("flight-")))
    assert "60 of 70 segments are drawn: the 20 of the largest error" in page.words
    rmse = [c.entry().models[m].segments[65].scores.rmse for m in ("arx", "ts")]
    assert f"flight-65 {number(rmse[0])} → {number(rmse[1])}" in page.words
    assert "segments are drawn" not in Page(rendered()).words


def test_rules_are_counted_in_whole_numbers() -> None:
    drawn = sweep_figure(Sweep((1, 2, 3), (0.4, 0.3, 0.35), (0.0,) * 3, 2), "m/s")
    at = re.findall(r'y="[\d.]+" class="t" text-anchor="middle">([\d.]+)<', drawn)
    assert at == ["1", "2", "3"]


def test_every_panel_is_drawn_and_anchors_exist() -> None:
    page = Page(rendered())
    for title in (
        "Autocorrelation of the one-step residual", "Cross-correlation of the free-run error", "Rule count",
        "Histogram of the one-step residual", "Spectrum of the one-step residual", "Static map",
        "Step response to u", "Frequency response from u",
        "Membership functions", "Input coverage", "Output coverage", "Degree of fulfilment",
        "Output of individual rules", "Reproduce",
    ):  # fmt: skip
        assert title in page.words, title
    ids = {a.get("id") for _, a in page.tags}
    assert {a["href"] for t, a in page.tags if t == "a"} <= {f"#{i}" for i in ids}
    assert all(a.get("aria-label") for t, a in page.tags if t == "svg")
    assert "nan" not in " ".join(str(a.get("d")) for t, a in page.tags if t == "path").lower()


def test_page_works_for_a_model_that_offers_nothing_beyond_the_protocol() -> None:
    class Bare:
        """Only what `Fitted` asks for."""

        def __init__(self, inner: FirstOrder) -> None:
            self._inner = inner

        def __getattr__(self, name: str) -> object:
            if name in {"memberships", "antecedents", "rule_outputs", "local_polynomials"}:
                raise AttributeError(name)
            return getattr(self._inner, name)

    c = compare({"arx": ARX, "ts": Bare(TS)}, flown(TS, [300], noise=0.02))  # type: ignore[dict-item]
    words = Page(render(ReportContext.of({"": c}))).words
    assert "Membership functions" not in words
    assert "Degree of fulfilment" in words


def test_one_model_alone_and_a_diverging_one() -> None:
    test = flown(TS, [300] * 2, noise=0.02)
    assert "nothing to compare" in render(ReportContext.of({"x": compare([ARX], test)}))
    wild = replace(TS, a=1.4, limit=30.0)
    text = render(ReportContext.of({"x": compare([ARX, wild], test)}))
    assert "diverged in free run on x, in 2 of 2 held-out segments, first at t = " in text
    swapped = {"arx": replace(wild, structure="arx"), "ts": TS}
    words = Page(render(ReportContext.of({"x": compare(swapped, test)}))).words
    assert "On x the linear model diverged in free run, so there is no error to compare with." in words
    assert "diverged diverged" not in words
    words = Page(render(ReportContext.of({"x": compare({"arx": wild, "ts": wild}, test)}))).words
    assert "Neither the fuzzy model nor the linear model is usable on x." in words
    assert "is enough" not in words


def hostile_context() -> ReportContext:
    """Every string that can reach the page is an attack."""
    evil = (Signal(HOSTILE, HOSTILE),)
    test = flown(TS, [300] * 2, noise=0.02)
    test = replace(test, inputs=evil, outputs=evil, name=HOSTILE)
    models = {
        "arx": replace(ARX, inputs=evil, outputs=evil, notes=(HOSTILE,)),
        HOSTILE: replace(TS, inputs=evil, outputs=evil, labels=(HOSTILE, HOSTILE)),
    }
    c = compare(models, test)
    return ReportContext(
        {HOSTILE: c},
        train={HOSTILE: test},
        sweeps={HOSTILE: Sweep((1,), (0.1,), (0.1,), 1, None, HOSTILE)},
        command=HOSTILE,
        provenance={HOSTILE: HOSTILE},
        remark=HOSTILE,
    )


@pytest.mark.parametrize("name", ["-rate", "+rate", "−rate", "a - b", "(x)", "rate(k-1)", "-"])
def test_a_name_that_begins_with_a_sign_has_its_membership_picture(name: str) -> None:
    data = Dataset.from_arrays(
        [np.arange(50.0)[:, None]], [np.arange(50.0)[:, None] ** 2], 0.1, inputs=[name], outputs=["rate"]
    )
    assert antecedent_range(f"{name}(k)", data) == (0.0, 49.0)
    assert antecedent_range(f"{name}(k-2)", data) == (0.0, 47.0)
    assert antecedent_range(f"{name}(k)-{name}(k-1)", data) is None  # it never changes
    low, high = antecedent_range(f"rate(k-1)-{name}(k-3)", data) or (0.0, 0.0)
    assert (low, high) == (2.0**2 - 0.0, 48.0**2 - 46.0)
    low, high = antecedent_range(f"-rate(k-1)+{name}(k-3)", data) or (0.0, 0.0)
    if name not in ("-rate", "−rate"):  # where a signal is called so, it is that signal
        assert (low, high) == (-(48.0**2) + 46.0, -4.0)
    assert antecedent_range(f"{name}(k)x", data) is None
    assert antecedent_range("", data) is None


def test_a_set_over_a_hidden_state_has_its_picture() -> None:
    """No record holds that state: the model itself knows where it was."""

    class Hidden:
        antecedents = ("hidden 1(k-1)",)
        trained_range = np.array([[-2.0], [3.0]])

        def memberships(self, variable: int, x: FloatArray) -> FloatArray:
            del variable
            return np.stack([np.exp(-(x**2))], axis=1)

    (drawn,) = membership_figures(Hidden(), flown(TS, [50], noise=0.0), {})
    assert "hidden 1(k-1)" in drawn


def test_hostile_names_are_shown_literally() -> None:
    text = render(hostile_context())
    page = Page(text)
    tags = [t for t, _ in page.tags]
    assert tags.count("script") == 3
    assert "img" not in tags
    assert "<img src=x onerror=hacked=2>" in page.words
    assert "{{7*7}}" in page.words
    assert "\x1b" not in text
    data = json.loads(page.inside["script"][0])
    assert data[0]["models"][1].startswith("</SCRIPT>")


def test_written_whole_and_equal_every_time(tmp_path: Path) -> None:
    one = write_report(tmp_path / "deep" / "a.html", context())
    two = compared().report(tmp_path / "b.html")
    assert one.read_text("utf-8") == rendered()
    assert two.stat().st_size < 1_500_000
    (tmp_path / "plain").touch()
    assert two.stat().st_mode == (tmp_path / "plain").stat().st_mode  # as readable as any other file
    (tmp_path / "plain").unlink()
    assert [p.name for p in tmp_path.iterdir()] == ["b.html", "deep"] or len(list(tmp_path.iterdir())) == 2
    blocked = tmp_path / "file"
    blocked.write_text("x")
    with pytest.raises(StoreError, match="cannot be written"):
        compared().report(blocked / "r.html")


def test_vendored_files_are_the_ones_the_table_names() -> None:
    table = (ASSETS / "README.md").read_text("utf-8")
    for name in ("uPlot.iife.min.js", "uPlot.min.css"):
        digest = hashlib.sha256((ASSETS / name).read_bytes()).hexdigest()
        assert f"| {digest} |" in table
    assert "MIT" in (ASSETS / "uPlot-LICENSE.txt").read_text("utf-8")
    for name in ("uPlot.iife.min.js", "page.js"):
        assert "</script" not in (ASSETS / name).read_text("utf-8").lower()


def test_a_test_that_chance_alone_passes_says_so() -> None:
    few = compare([ARX, replace(TS, b=0.11)], flown(TS, [50], noise=0.02))
    page = Page(render(ReportContext.of({"x": few}))).words
    assert "too little data to tell" in page
    assert "nothing left that the input explains" not in page


def test_the_verdict_stands_beside_its_channel_and_not_in_the_tab() -> None:
    found = re.search(r'<div class="channel-head"><h2[^>]*>(.*?)</h2>(.*?)</div>', rendered())
    assert found is not None
    assert "TS better" not in found[1]
    assert "TS better" in found[2]


def test_rules_of_two_fuzzy_models_are_told_apart() -> None:
    two = {"a:ts": replace(TS, b=0.09), "b:ts": TS}
    test = flown(TS, [300] * 5, noise=0.02)
    page = Page(render(ReportContext.of({"x": compare(two, test, baseline="a:ts")})))
    assert "B:TS R1" in page.words
    assert "A:TS R2" in page.words
    hz = np.geomspace(0.1, 1.0, 5)
    two_rules = [BandCurve((1.0 / (1.0 + 1j * hz)).astype(np.complex128), None)] * 2
    pair = {Role("a:ts", "arx", shown=True): two_rules, Role("b:ts", "ts", shown=True): two_rules}
    drawn = bode(None, pair, hz, "m/s", "both")
    assert drawn.count('"rule r1 dashed"') == drawn.count('"rule r1"') == 2  # gain and phase
    alone = Page(render(context())).words
    assert "TS R1" not in alone


def test_decimation_keeps_every_peak() -> None:
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 100.0, 10_001)
    y = rng.normal(size=10_001)
    y[7777] = 99.0
    times, few = decimate(t, {"y": y}, 300)
    assert len(times) == len(few["y"]) <= 302
    assert few["y"].max() == 99.0
    assert few["y"].min() == y.min()
    assert np.all(np.diff(times) > 0)
    same, all_of_it = decimate(t[:50], {"y": y[:50]}, 300)
    assert len(same) == 50
    assert all_of_it["y"] is not None
    assert round_for_json(np.array([1.23456789, np.nan, -0.0])) == [1.2346, None, 0.0]


def test_sweep_is_read_from_the_notes_of_a_model() -> None:
    notes = (
        "Orders na = 3.",
        "Validation free-run error by number of rules, in standard deviations of the output: "
        "1: 0.134 +- 0.012, 2: 5e-02. +- is one standard error of the distance to the best.",
        "2 rules: the fewest within one standard error of the best.",
    )
    sweep = Sweep.from_notes(notes, 2)
    assert sweep is not None
    assert (sweep.rules, sweep.error, sweep.chosen) == ((1, 2), (0.134, 0.05), 2)
    assert sweep.spread == (0.012, 0.0)
    older = Sweep.from_notes((notes[1].replace(" +- 0.012", ""),), 2)
    assert older is not None
    assert (older.error, older.spread) == ((0.134, 0.05), (0.0, 0.0))
    assert sweep.unit == "standard deviations of the output"
    assert sweep.words.startswith("2 rules")
    assert Sweep.from_notes(("made by hand",), 1) is None
    ts = replace(TS, notes=notes)
    page = Page(render(ReportContext.of({"x": compare([ARX, ts], flown(TS, [300], noise=0.02))})))
    assert "Rule count" in page.words
    assert "Bars: one standard error of the distance to the best." in page.words
    assert "RMSE, standard deviations of the output" in page.words


def test_ticks_are_round_and_inside() -> None:
    assert ticks(0.0, 10.0, 5) == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert ticks(-1.0, 1.0, 4) == [-1.0, -0.5, 0.0, 0.5, 1.0]
    assert log_ticks(0.09, 11.0)[:3] == [pytest.approx(0.1), pytest.approx(0.2), pytest.approx(0.5)]
    assert ticks(1.0, 1.0, 4) == []


def test_two_models_that_are_one_share_its_bands_and_show_where_it_errs() -> None:
    """As where the search for rules takes the linear model, parameter for parameter."""
    train = flown(ARX, [300] * 2, noise=0.05)
    model = flysid.ARX(na=1, nb=1, nk=1).fit(train)
    test = flown(ARX, [300] * 4, noise=0.05, seed=3)
    late = replace(test.segments[2], y=test.segments[2].y + np.linspace(0.0, 2.0, 300)[:, None] ** 4)
    test = test.with_segments((*test.segments[:2], late, test.segments[3]))
    page = render(ReportContext.of({"x": compare([model, model], test, train=train)}))
    assert "ARX-2 is the same model." in page
    assert 'class="sure arx"' in page
    assert 'class="sure ts"' not in page
    (data,) = json.loads(re.search(r'id="data">(.*?)</script>', page, re.S)[1])  # type: ignore[index]
    assert [[band[0] for band in segment["bands"]] for segment in data["segments"]] == [["arx"]] * 4
    where = re.search(r"<figcaption>([^<]*)</figcaption></figure>\n<p class=\"change\"", page)
    assert where is not None
    assert where[1] == data["segments"][2]["label"].replace("\u2212", "-")
    found = compare({"arx": model, "ts": model}, test, train=train)
    text = " ".join(Page(render(ReportContext.of({"x": found}))).text)
    assert "A linear model is enough" in text
    assert "The ten seconds in which the model's error is largest." in text
    assert "fuzzy" not in text.lower()


def test_the_logged_gains_have_a_section_with_their_margins_and_a_nyquist_plot() -> None:
    known, refused = (
        judge([log_of(40.0, header)], ["roll"])[0] for header in (None, {"rollPID": "92,45,25"})
    )
    page = render(replace(context(), loops=[known, refused]))
    text = " ".join(Page(page).text)
    assert "What your gains mean" in text
    assert known.lines()[1].strip()[1:] in text
    assert "Refused: the stated gains do not give what the log recorded" in text
    assert page.count('aria-label="Nyquist plot of the roll loop"') == 1
    assert "What your gains mean" not in rendered()


def test_a_nyquist_plot_keeps_inside_its_axes() -> None:
    curve = curve_of(judge([log_of(40.0)], ["roll"])[0])
    assert curve is not None
    assert abs(curve.loop[0]) > 3.0  # below the picture
    drawn = nyquist(curve, "loop")
    xs = [float(x) for x in re.findall(r"[ML](-?[\d.]+) ", drawn)]
    assert min(xs) >= 0.0
    assert max(xs) <= HALF
