import numpy as np
import pytest

from flysid.dataset import Dataset, Segment, Signal
from flysid.ingest.align.doubts import Doubt, doubt_lines, doubts
from flysid.ingest.align.recipe import ChannelSpec
from flysid.ingest.excitation.excitation import Spectrum
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.context import ReportContext
from flysid.validate.diagnose.document import to_json
from flysid.validate.show.page.page import render
from tests.validate.show.page.test_report import compared

SPEC = ChannelSpec(("u",), ("y",), min_rate_hz=20.0, remedy="log faster")
RNG = np.random.default_rng(3)
U = np.repeat(RNG.normal(size=120), 25)
Y = np.convolve(U, 0.9 ** np.arange(200) * 0.1)[: len(U)]


def data(
    u: np.ndarray = U, y: np.ndarray = Y, dt_s: float = 0.02, vehicles: tuple[str, ...] = ("a",)
) -> Dataset:
    segments = tuple(Segment(u, y, flight=v, marks={"vehicle": v}) for v in vehicles)
    return Dataset(dt_s, (Signal("u", "deg"),), (Signal("y", "m/s"),), segments, name="c")


def oscillation() -> Dataset:
    """Both move at one frequency, and little else of the output follows the input."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=440)
    y = u + 0.8 * rng.normal(size=440)
    tone = 4.0 * np.sin(2 * np.pi * 4.0 * 0.1 * np.arange(440))
    return data(u + tone, y + tone, dt_s=0.1)


def test_good_data_have_a_band_and_no_fault() -> None:
    (remark,) = doubts(data(), SPEC)
    assert remark.kind == "band"
    assert "y follows u from" in remark.text


@pytest.mark.parametrize(
    ("of", "kind", "words"),
    [
        (data(1e-6 * U), "quiet", "e-06 deg rms only"),
        (data(dt_s=0.1), "slow", "10 Hz resolves dynamics up to 5 Hz only, this channel needs 20 Hz"),
        (data(y=RNG.normal(size=len(U))), "unexplained", "% of the power of y below"),
        (data(U[:2500], Y[:2500]), "short", "50 s alone will hardly give a verdict"),
        (data(np.sign(U), Y), "holes", "input u takes 2 distinct values (-1, 1 deg)"),
        (oscillation(), "narrow", "y follows u from 3.8 to 4.9 Hz only, less than an octave"),
        (data(vehicles=("b", "a", "b")), "pooled", "flights of 2 vehicles are pooled (a, b)"),
    ],
)
def test_each_fault_is_named_with_its_remedy(of: Dataset, kind: str, words: str) -> None:
    assert [words in d.text and d.todo != "" for d in doubts(of, SPEC) if d.kind == kind] == [True]


def test_a_band_of_one_line_is_said_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A real log read "from 5 to 5 Hz only"."""
    monkeypatch.setattr(Spectrum, "band_hz", lambda _: (4.97, 5.0))
    assert "y follows u at 5 Hz only" in " ".join(d.text for d in doubts(oscillation(), SPEC))


def test_a_fit_says_that_an_input_has_holes_and_leaves_bands_to_the_page() -> None:
    (said,) = doubt_lines(doubts(data(np.sign(U), Y), SPEC))
    assert said.startswith("remark: input u takes 2 distinct values (-1, 1 deg); rules learn nothing between")


def test_several_short_flights_are_no_short_flight() -> None:
    assert "short" not in {d.kind for d in doubts(data(U[:1000], Y[:1000], vehicles=("a", "b")), SPEC)}


def test_the_page_says_once_what_holds_for_several_channels() -> None:
    slow = Doubt("slow", "10 Hz is too slow", "log faster")
    bands = [Doubt("band", f"{y} follows u from 1 to 2 Hz", "") for y in ("p", "q")]
    found = cautions({}, {}, {"p": [slow, bands[0]], "q": [slow, bands[1]]})
    assert [(c.level, c.text, c.todo) for c in found] == [
        ("warning", "p, q: 10 Hz is too slow.", "log faster."),
        ("note", "p follows u from 1 to 2 Hz, q follows u from 1 to 2 Hz.", ""),
    ]


def test_doubts_reach_the_page_and_the_document() -> None:
    slow = {"c": [Doubt("slow", "10 Hz <i>is</i> too slow", "log faster")]}
    context = ReportContext({"c": compared()}, doubts=slow)
    page = render(context)
    assert "c: 10 Hz &lt;i&gt;is&lt;/i&gt; too slow." in page
    assert "log faster" in page
    listed = to_json(context.comparisons, context.diagnoses, context.doubts)["cautions"]
    assert any(c["text"] == "c: 10 Hz <i>is</i> too slow." for c in listed)
