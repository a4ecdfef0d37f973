"""Extras never take the main result down: each is broken in turn, and the result is what it was before.

The list of extras is the program's own, `flysid.extras.Extra`. Which command reaches which extra is found by
running the commands: a new extra that no command here reaches fails.
"""

from __future__ import annotations

import html
import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flysid import extras
from flysid.errors import DataError, WriteError
from flysid.extras import Extra, Missing, MissingExtra, extra
from flysid.files import write_atomically
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.synth.synth import WRITERS, Order, flights
from flysid.validate.paper import reproduction
from flysid.validate.paper.printed import LOOPS
from flysid.validate.runs.runindex import INDEX
from tests.command import call
from tests.contest import linear_side

CHANNEL = "longitudinal"
ERRORS = (RuntimeError("struck"), np.linalg.LinAlgError("struck"))
"""In turn, extra by extra: one function catches what any of them raises."""
CHANNELS = ("-r", "ardrone-synthetic", "-c", CHANNEL)
PRINTED = {Extra.TRANSFER_TEXT, Extra.GAIN_SETS, Extra.PLOT, Extra.SETS_TABLE, Extra.INDEX, Extra.REMEMBERED,
           Extra.RULE_TABLES, Extra.WORST}  # fmt: skip
"""Extras beside what is printed or kept: no page and no document is theirs."""


@dataclass(frozen=True)
class Shown:
    """What came of a command.

    Attributes
    ----------
    result : the main result, to be the same whatever extra breaks.
    told : where the sentence stands, by place.
    """

    code: int
    result: Any
    terminal: str
    told: Mapping[str, str] = field(default_factory=dict)


@pytest.fixture(scope="module", autouse=True)
def arx_alone_competes() -> Iterator[None]:
    with linear_side("arx"):
        yield


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short flights, ingested, and a run of them."""
    root = tmp_path_factory.mktemp("extras")
    suffix, encode = WRITERS["tlog"]
    for recording in list(flights(Order(plant="ardrone", plan="demo", duration_s=8.0)))[:2]:
        write_atomically(root / f"{recording.name}{suffix}", encode(recording))
    list(ingest_logs(find_logs([root]), root / "data", bounds=None))
    assert fit(root, "run", "ts").code == 0
    return root


def fit(place: Path, run: str = "fitted", models: str = "ts,tf") -> Shown:
    words = (*CHANNELS, "-m", models, "--rules", 2, "--effort", "quick", "--holdout", 0.5, "--no-rotate")
    done = flysid(place, "fit", "data", *words, "-j", 1, "-o", run, "--force")
    fitted = {}
    for file in sorted((place / run / CHANNEL).glob("*.json")):
        document = json.loads(file.read_text("utf-8"))
        fitted[file.stem] = {k: v for k, v in document.items() if k not in ("notes", "operating_points")}
    return Shown(done[0], fitted, done[1], {"run.json": texts_of(place / run / "run.json")})


def validate(place: Path, *more: str) -> Shown:
    done = flysid(place, "validate", "run", "-o", "report", "--force", *more)
    document = json.loads((place / "report" / "report.json").read_text("utf-8"))
    page = html.unescape((place / "report" / "report.html").read_text("utf-8"))
    told = {"page": spaced(page), "report.json": texts_of(place / "report" / "report.json")}
    return Shown(done[0], (document["channels"], document["about"]), done[1], told)


def figures(place: Path) -> Shown:
    pytest.importorskip("matplotlib")
    return validate(place, "--figures", "svg")


def transfer(place: Path) -> Shown:
    code, said, out = flysid(place, "tf", "data", *CHANNELS, "--poles", 1, "--zeros", 0, "--json", whole=True)
    document = json.loads(out)
    bounded = ("gain", "dead_time", "modes")  # by the measured response, where there is one
    found = [
        [{k: v for k, v in transfer.items() if k not in bounded} for transfer in c["transfers"]]
        for c in document["channels"]
    ]
    return Shown(code, found, said, {"JSON": spaced(" ".join(document.get("missing", [])))})


def bode(place: Path) -> Shown:
    pytest.importorskip("matplotlib")
    code, said, out = flysid(
        place,
        "tf",
        "data",
        *CHANNELS,
        "--poles",
        1,
        "--zeros",
        0,
        "--plot",
        "bode.svg",
        "--force",
        whole=True,
    )
    return Shown(code, out, said)


def gains(place: Path) -> Shown:
    code, said, out = flysid(place, "gains", "data", whole=True)
    return Shown(code, out, said)


def suggestions(place: Path) -> Shown:
    """Every one of them breaks here: the list stays a list."""
    code, said, out = flysid(place, "ls", "data", "--suggest", "--json", whole=True)
    document = json.loads(out)
    told = {"JSON": spaced(" ".join(document.get("missing", [])))}
    return Shown(code, isinstance(document["suggestions"], list), said, told)


def review(place: Path) -> Shown:
    """Every section breaks here: the page names the log, and 3 says that nothing was judged."""
    code, said, out = flysid(place, "review", "data", "-o", "review.html", "--force", "--json", whole=True)
    whole_document = json.loads(out[: out.rindex("}") + 1])
    documents = whole_document["reviews"]
    page = html.unescape((place / "review.html").read_text("utf-8"))
    broken = [sentence for document in documents for sentence in document["broken"]]
    broken += whole_document.get("missing", [])
    told = {"page": spaced(page)}
    if broken:
        told["JSON"] = spaced(" ".join(broken))
    return Shown(0 if code == 3 else code, [document["log"] for document in documents], said, told)


def runs(place: Path) -> Shown:
    (place / "run" / INDEX).unlink(missing_ok=True)
    code, said, out = flysid(place, "runs", "run", "--json", whole=True)
    return Shown(code, out, said)


def fleet(place: Path) -> Shown:
    code, said, out = flysid(place, "fleet", "fit", "data", *CHANNELS, "--json", whole=True)
    document = json.loads(out)
    groups = [{k: v for k, v in g.items() if k != "response"} for g in document["groups"]]
    return Shown(code, groups, said, {"JSON": spaced(" ".join(document.get("missing", [])))})


def reproduce(place: Path) -> Shown:
    code, said, out = flysid(place, "reproduce", "ardrone-ts", whole=True)
    return Shown(code, [line for line in out.splitlines() if "verdict" in line or "RMSE" in line], said)


def studio(place: Path) -> Shown:
    """The page's views of the run, from what the server answers with."""
    pytest.importorskip("msgspec")
    from flysid.studio.explain import _held, explain, worst_seconds
    from flysid.studio.folders import Workspace, short_id
    from flysid.studio.forms import Explained
    from flysid.studio.run_views import list_runs

    _held.cache_clear()
    workspace = Workspace(place / "data")
    run = short_id(place / "run")
    heard: list[str] = []
    with extras.hearing(heard.append):
        worst_seconds(workspace, run)
        shown = explain(workspace, run, Explained(CHANNEL))
        words = explain(workspace, run, Explained(CHANNEL, row=40))
        listed = list_runs(workspace)
    reasons = [row["reason"] for row in listed["damaged"]]
    told = [*shown.get("missing", []), *words.get("missing", []), *reasons]
    flown = {name: model["yh"] for name, model in shown["models"].items()}
    return Shown(0, flown, spaced(" ".join([*heard, *told])), {"answer": spaced(" ".join(told))})


SCENES: dict[str, Callable[[Path], Shown]] = {
    scene.__name__: scene
    for scene in (
        validate,
        gains,
        runs,
        review,
        suggestions,
        fleet,
        studio,
        fit,
        transfer,
        bode,
        figures,
        reproduce,
    )
}
"""Cheap ones first."""


def flysid(place: Path, *words: object, whole: bool = False) -> Any:
    """(exit code, all that was said), and what was printed where `whole`."""
    done = call(*map(str, words), cwd=place)
    said = spaced(done.stdout + done.stderr)
    return (done.returncode, said, done.stdout) if whole else (done.returncode, said)


def spaced(text: str) -> str:
    return " ".join(text.split())


def texts_of(path: Path) -> str:
    """All strings of a JSON file."""

    def strings(value: Any) -> Iterator[str]:
        if isinstance(value, str):
            yield value
        for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            yield from strings(part)

    return " ".join(strings(json.loads(path.read_text("utf-8"))))


@contextmanager
def tried(trial: Callable[[Extra], None]) -> Iterator[None]:
    """`trial` is called with every extra before it is made."""
    real = extras.attempt

    def attempt(which: Extra, make: Callable[[], Any]) -> Any:
        trial(which)
        return real(which, make)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(extras, "attempt", attempt)
        yield


@contextmanager
def struck(which: Extra, error: Exception) -> Iterator[None]:
    def strike(now: Extra) -> None:
        if now is which:
            raise error

    with tried(strike):
        yield


@pytest.fixture(scope="module")
def short_reproduction() -> Iterator[None]:
    """The paper's first loop over twenty seconds, fitted once: the words about it are tried here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduction, "DURATION_S", 20.0)
        patch.setattr(reproduction, "LOOPS", LOOPS[:1])
        results = reproduction.reproduce_ardrone_ts()
        patch.setattr(reproduction, "reproduce_ardrone_ts", lambda: results)
        yield


@pytest.fixture(scope="module")
def sound(place: Path, short_reproduction: None) -> dict[str, tuple[Shown, set[Extra]]]:  # noqa: ARG001
    """Every scene as it is where nothing breaks, and the extras that it tries."""
    found = {}
    for name, scene in SCENES.items():
        reached: set[Extra] = set()
        with tried(reached.add):
            found[name] = scene(place), reached
    return found


def test_where_nothing_breaks_nothing_is_missing(sound: dict[str, tuple[Shown, set[Extra]]]) -> None:
    for name, (shown, _) in sound.items():
        assert shown.code == (3 if name == "gains" else 0), shown.terminal
        for text in (shown.terminal, *shown.told.values()):
            assert "could not be given" not in text


@pytest.mark.parametrize(
    ("which", "error"), [*zip(Extra, cycle(ERRORS), strict=False)], ids=[which.name for which in Extra]
)
def test_a_broken_extra_is_named_and_the_result_is_the_same(
    which: Extra, error: Exception, place: Path, sound: dict[str, tuple[Shown, set[Extra]]]
) -> None:
    scenes = [name for name, (_, reached) in sound.items() if which in reached]
    assert scenes, f"no command here reaches {which.name}"
    for name in dict.fromkeys([scenes[0], *({"fit"} & {*scenes})]):
        before, _ = sound[name]
        with struck(which, error):
            after = SCENES[name](place)
        assert after.code == before.code, after.terminal
        assert after.result == before.result
        sentence = f"could not be given: an internal computation failed ({type(error).__name__}: struck)."
        for text in (after.terminal, *(() if which in PRINTED else after.told.values())):
            assert which.value[1:] in text
            assert sentence in text


def test_a_command_says_what_could_not_be_given_beside_a_fit_on_the_page_of_the_run(place: Path) -> None:
    with struck(Extra.MODEL_TEXT, RuntimeError("struck")):
        done = fit(place, "wordless")
    assert done.code == 0
    assert not list((place / "wordless" / CHANNEL).glob("*.txt"))
    assert call("validate", "wordless", cwd=place).returncode == 0
    words = "The file that explains the model in words of ts on longitudinal could not be given"
    report = place / "wordless" / "report"
    assert words in (report / "report.html").read_text("utf-8")
    assert words in " ".join(json.loads((report / "report.json").read_text("utf-8"))["missing"])


def test_a_broken_verdict_is_not_swallowed(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("the verdict")

    monkeypatch.setattr("flysid.validate.compare.models.decide", broken)
    with pytest.raises(RuntimeError, match="the verdict"):
        call("validate", "run", "-o", "none", cwd=place)
    assert not (place / "none").exists()


def test_what_flysid_says_of_an_extra_stands_in_its_sentence() -> None:
    def refused() -> None:
        raise DataError("too short", hint="fly longer")

    missing = Missing()
    with missing.gathering():
        assert extra(Extra.NEARNESS, refused, None, "roll") is None
        assert extra(Extra.NEARNESS, refused, None, "roll") is None
    assert missing.sentences == (
        "The distance to the training samples of roll could not be given: too short; try: fly longer.",
    )


@pytest.mark.parametrize("error", [KeyboardInterrupt(), MemoryError(), WriteError("disk full")])
def test_an_interrupt_short_memory_and_a_full_disk_are_no_extras_fault(error: BaseException) -> None:
    def broken() -> None:
        raise error

    with pytest.raises(type(error)):
        extra(Extra.PLOT, broken, None)


def test_python_is_warned_where_nobody_listens() -> None:
    def broken() -> float:
        return 1 / 0

    with pytest.warns(MissingExtra, match=r"The plot could not be given: .*ZeroDivisionError"):
        assert extra(Extra.PLOT, broken, 0.0) == 0.0


def test_warnings_about_numbers_stay_off_the_screen() -> None:
    from scipy.linalg import LinAlgWarning, solve

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        extra(Extra.CERTIFICATE, lambda: solve([[1.0, 1.0], [1.0, 1.0 + 1e-15]], [1.0, 1.0]), None)
        extra(Extra.CERTIFICATE, lambda: warnings.warn("rcond", LinAlgWarning, stacklevel=2), None)
