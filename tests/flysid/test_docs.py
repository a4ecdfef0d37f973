"""The examples in the documentation run as they stand."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

import flysid
from flysid.cli.verbs import VERBS
from flysid.errors import FlysidError
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.validate.compare.condition import check_condition
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.document import to_json
from tests.fakes import FirstOrder, flown

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.mark.usefixtures("arx_alone")
def test_the_examples_of_models_md_run_one_after_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not any(
        r.skipped for r in ingest_logs(find_logs([ROOT / "sample_logs"]), tmp_path / "data", jobs=1)
    )
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in BLOCK.findall((ROOT / "docs" / "models.md").read_text("utf-8")):
        exec(block, names)
    told = capsys.readouterr().out
    assert "R1 has weight" in told
    assert "verdicts on the held-out flight" in told
    assert re.search(
        r"^  ts .* same$", told, re.MULTILINE
    )  # the sample logs are of a linear plant: rules add nothing
    assert "TS better" not in told
    assert (tmp_path / "ts.json").is_file()
    names |= {name: getattr(flysid, name) for name in flysid.__all__} | {"model": names["ts"]}
    prose = re.sub(r"^```.*?^```", "", (ROOT / "docs" / "models.md").read_text("utf-8"), flags=re.M | re.S)
    spans = set(re.findall(r"`([^`\n]+)`", prose))
    assert sorted(span for span in spans if not _stands_for_something(span, names)) == []


def _stands_for_something(span: str, names: dict[str, object]) -> bool:
    """A command that there is, an expression that can be evaluated, a setting or a capability of a model."""
    words = span.split()
    if words[0] in ("flysid", "pip"):
        return words[0] == "pip" or words[1] in VERBS
    homes = [home for home in names.values() if inspect.isroutine(home) or inspect.isclass(home)]
    settings = {name for home in homes for name in inspect.signature(home).parameters}
    name = re.match(r"\w+", span)
    if name is not None and (name[0] in settings or any(hasattr(h, name[0]) for h in (*homes, names["ts"]))):
        return True
    with contextlib.suppress(FlysidError):  # no file of that name: the call itself is understood
        try:
            eval(span, names)
        except (AttributeError, NameError):
            return importlib.util.find_spec(span) is not None if "(" not in span else False
    return True


def test_the_guards_of_report_md_are_understood() -> None:
    text = (ROOT / "docs" / "report.md").read_text("utf-8")
    arx = FirstOrder(b=0.08)
    ts = FirstOrder(structure="ts", labels=("R1", "R2"))
    document = to_json({"roll": compare([arx, ts], flown(ts, [60] * 5, noise=0.02))})
    expressions = re.findall(r"--fail-if '([^']+)'", text)
    fields = re.findall(r"`(free_run\.[\w.]+)`", text)
    words = {"verdict": "better", "scope": "'another flight'"}
    ends = {f: f.rpartition(".")[2] for f in fields}
    expressions += [f"{f} == {words[end]}" if end in words else f"{f} > 0" for f, end in ends.items()]
    expressions += [
        f"free_run.ts.{f} > 0" for f in re.findall(r"`(\w+)`[,)]", text.partition("rmse` (")[2])[:6]
    ]
    assert len(expressions) > 15
    for expression in expressions:
        check_condition(expression, document)


def test_a_report_of_the_gallery_is_made_by_its_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small one: those of the site are made by `make docs` alone."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    gallery = importlib.import_module("gallery_reports")
    synth = "synth -o logs --no-truth --plan steps --duration 20"
    fit = "fit logs -r ardrone-synthetic -c lateral -m arx --effort quick --holdout 0.5 -o run"
    small = gallery.Example("small", "Small", "Few words.", (synth, fit, "validate run -o report"))
    gallery.make(small, tmp_path)
    assert "<h1 id" in (tmp_path / "small.html").read_text("utf-8")
    assert ElementTree.parse(tmp_path / "small.svg").getroot().tag.endswith("svg")
    listed = gallery.section(small, tmp_path)
    assert 'href="gallery/small.html"' in listed
    assert f"$ flysid {fit}" in listed.replace(" \\\n    ", " ")
    assert len({example.name for example in gallery.EXAMPLES}) == 6


def built_site(to: Path) -> Path:
    """That of `make docs` where no file is newer, as in CI; otherwise one without its gallery, in `to`."""
    made = ROOT / "docs/_build"
    stamp = made / ".whole"
    if stamp.exists() and max(map(changed, sources_of_site())) < changed(stamp):
        return made
    pytest.importorskip("furo")
    options = ("-n", "-W", "--keep-going", "-q", "-b", "html", "-D", "gallery=none")
    command = [sys.executable, "-m", "sphinx", *options, "docs", str(to)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return to


def sources_of_site() -> Iterator[Path]:
    """What the site is built from: pages, and the docstrings of the code."""
    yield from ROOT.glob("*.md")
    left_out = {"_build", "__pycache__"}
    yield from (f for f in (ROOT / "docs").rglob("*") if f.is_file() and not left_out & {*f.parts})
    for folder in ("flysid", "ingest", "model", "validate"):
        yield from (ROOT / folder).rglob("*.py")


def changed(file: Path) -> float:
    return file.stat().st_mtime


def test_the_site_is_built_without_a_warning_and_knows_every_verb_and_name(tmp_path: Path) -> None:
    site = built_site(tmp_path)
    verbs = (site / "reference" / "verbs.html").read_text("utf-8")
    for verb in VERBS:
        assert f"flysid {verb}" in verbs
    names = (site / "reference" / "python.html").read_text("utf-8")
    for name in set(flysid.__all__) - {"__version__"}:
        assert f".{name}" in names
    for page in site.rglob("*.html"):
        assert not re.search(r'(src|href)="https?://[^"]*\.(js|css)', page.read_text("utf-8")), (
            "nothing from elsewhere"
        )
