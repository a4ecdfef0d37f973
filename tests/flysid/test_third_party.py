"""tests/pingpong adds a structure, a format, a verb, a recipe and a figure, and no file of flysid changes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.flysid.studio.server import studio
from tests.forked import Forks, forking

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "tests/pingpong"


def install(site: Path) -> None:
    """Lay the package out as pip does."""
    shutil.copytree(PACKAGE / "pingpong", site / "pingpong", ignore=shutil.ignore_patterns("__pycache__"))
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text("utf-8"))["project"]
    info = site / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 1.0\n")
    groups = [
        "\n".join([f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())])
        for group, entries in project["entry-points"].items()
    ]
    (info / "entry_points.txt").write_text("\n\n".join(groups) + "\n")


def log_of(path: Path, seed: int, samples: int = 700) -> None:
    """A ball that follows a jet of random steps with one lag."""
    rng = np.random.default_rng(seed)
    jet = np.repeat(rng.uniform(1.0, 3.0, samples // 20 + 1), 20)[:samples]
    height = np.zeros(samples)
    for k in range(1, samples):
        height[k] = 0.93 * height[k - 1] + 0.05 * jet[k - 1] + 0.002
    height += 0.003 * rng.standard_normal(samples)
    path.write_bytes(b"PINGPONG" + np.column_stack([jet, height]).astype("<f8").tobytes())


@pytest.fixture(scope="module")
def forks() -> Iterator[Forks]:
    with forking() as forks:
        yield forks


class Site:
    """A folder with logs, and an interpreter in which the package is installed."""

    def __init__(self, folder: Path, forks: Forks) -> None:
        self.folder = folder
        self.forks = forks
        self.site = folder / "site"
        install(self.site)
        self.environment = {**os.environ, "PYTHONPATH": f"{self.site}{os.pathsep}{ROOT}"}

    def flysid(
        self, *words: str, fails: bool = False, more: Mapping[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        program = "tests.arx_flysid" if words[:1] == ("fit",) else "flysid"  # bounce needs no other rivals
        done = self.forks.run(program, words, self.folder, {**self.environment, **(more or {})})
        assert (done.returncode != 0) == fails, (words, done.stdout, done.stderr)
        return done

    def start(self, *words: str) -> subprocess.CompletedProcess[str]:
        """As a shell does, whatever is imported."""
        return subprocess.run(
            [sys.executable, "-m", "flysid", *words],
            env=self.environment,
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=300,
        )


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory, forks: Forks) -> Site:
    """Logs ingested, fitted by the package's recipe and structure, and judged."""
    site = Site(tmp_path_factory.mktemp("pingpong"), forks)
    (site.folder / "logs").mkdir()
    for seed in range(3):
        log_of(site.folder / f"logs/{seed}.ping", seed)
    site.flysid("ingest", "logs", "-o", "data", "-q")
    site.flysid("fit", "data", "-r", "pingpong-height", "-m", "bounce,line", "-o", "run", "-q")
    site.flysid("validate", "run", "-o", "report")
    return site


@pytest.fixture
def fresh(tmp_path: Path, forks: Forks) -> Site:
    site = Site(tmp_path, forks)
    log_of(tmp_path / "a.ping", 7)
    return site


def test_a_format_is_ingested_listed_and_shown(judged: Site) -> None:
    assert "ball" in judged.flysid("show", "data", "0").stdout
    assert judged.flysid("ls", "data").stdout.count("pingpong") >= 1
    (judged.folder / "cut.ping").write_bytes((judged.folder / "logs/0.ping").read_bytes()[:-3])
    assert "lost: 13 bytes" in judged.flysid("doctor", "cut.ping", fails=True).stdout


def test_a_recipe_is_listed_explained_and_suggested(judged: Site) -> None:
    assert "pingpong-height: height" in judged.flysid("recipes").stdout
    assert "channel height: jet -> height" in judged.flysid("recipes", "pingpong-height").stdout
    assert "pingpong-height" in judged.flysid("recipes", "--for", "logs/0.ping").stdout


def test_a_structure_is_fitted_and_judged_on_the_page_and_in_json(judged: Site) -> None:
    report = json.loads((judged.folder / "report/report.json").read_text("utf-8"))
    (channel,) = report["channels"].values()
    assert report["about"]["height"]["contender"] == "bounce"
    assert channel["free_run"]["models"]["bounce"]["fit_pct"] > 90.0
    page = (judged.folder / "report/report.html").read_text("utf-8")
    assert "ball on a jet" in page
    assert "height(k) = 0.9" in page
    assert "bounce, 3 parameters" in (judged.folder / "run/height/bounce.txt").read_text("utf-8")


def test_a_structure_without_an_exporter_says_whose_it_is(judged: Site) -> None:
    refused = judged.flysid("export", "run", "--model", "bounce", "--c", "c", fails=True).stderr
    assert "'bounce' cannot be exported: the package 'pingpong' has no exporter for it" in " ".join(
        refused.split()
    )


def test_a_figure_stands_on_the_page(judged: Site) -> None:
    page = (judged.folder / "report/report.html").read_text("utf-8")
    assert page.count('aria-label="Bounces"') == 1


def test_a_verb_is_listed_helped_and_run(judged: Site) -> None:
    assert "referee" in judged.flysid("--help").stdout.partition("More:")[2]
    assert "Count the bounces" in judged.flysid("referee", "--help").stdout
    assert judged.start("referee", "logs/0.ping").stdout.endswith(" bounces\n")
    assert "Did you mean 'referee'?" in judged.flysid("refere", fails=True).stderr


@pytest.mark.parametrize(
    ("words", "last", "offered"),
    [
        ("flysid fit data --models bo", 4, "bounce"),
        ("flysid fit data --recipe ping", 4, "pingpong-height"),
        ("flysid ref", 1, "referee"),
    ],
)
def test_a_shell_completes_its_names(judged: Site, words: str, last: int, offered: str) -> None:
    done = judged.flysid(
        more={"_FLYSID_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(last)}
    )
    assert offered in done.stdout


def test_the_studio_offers_its_structure_and_its_recipe(judged: Site) -> None:
    with studio(judged.folder / "data", site=judged.site) as server:
        models = server.get("models").json["models"]
        assert {"name": "bounce", "usual": False} in models
        assert "pingpong-height" in {recipe["name"] for recipe in server.get("recipes").json["recipes"]}


def test_its_models_are_loaded_in_python(judged: Site) -> None:
    code = "import flysid; print(flysid.load('run/height/bounce.json').n_parameters)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=judged.environment,
        cwd=judged.folder,
        capture_output=True,
        text=True,
    )
    assert done.stdout.strip() == "3", done.stderr


def test_a_structure_that_breaks_is_that_packages_fault(fresh: Site) -> None:
    module = fresh.site / "pingpong/bounce.py"
    module.write_text(module.read_text().replace("rows = [np.column", "rows = 1 / 0, [np.column"))
    done = fresh.flysid("fit", "a.ping", "-r", "pingpong-height", "-m", "bounce", "-o", "run")
    said = " ".join(done.stderr.split())
    assert "the package pingpong failed: ZeroDivisionError" in said
    assert "flysid itself failed" not in said


def test_models_under_a_name_that_no_row_has_are_refused(fresh: Site) -> None:
    module = fresh.site / "pingpong/bounce.py"
    module.write_text(module.read_text().replace('structure: str = "bounce"', 'structure: str = "lob"'))
    done = fresh.flysid("fit", "a.ping", "-r", "pingpong-height", "-m", "bounce", "-o", "run")
    assert "call themselves 'lob'" in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("entry", "value", "words", "why"),
    [
        (
            "structures",
            "bounce = pingpong.rows:NOTHING",
            ("fit", "a.ping", "-r", "pingpong-height", "-o", "run"),
            "cannot be imported",
        ),
        (
            "structures",
            "bounce = pingpong.rows:MAGIC",
            ("fit", "a.ping", "-r", "pingpong-height", "-o", "run"),
            "neither a",
        ),
        ("formats", "pingpong = pingpong.rows:BOUNCE", ("show", "a.ping"), "it must name a"),
        ("formats", "pingpong = pingpong.gone:FORMAT", ("show", "a.ping"), "cannot be imported"),
        ("verbs", "referee = pingpong.rows:BOUNCE", ("refere",), "it must name a"),
        ("recipes", "pingpong-lob = pingpong.recipes", ("recipes", "pingpong-lob"), "is not beside"),
        ("recipes", "px4-rates = pingpong.recipes", ("recipes",), "is taken"),
    ],
)
def test_what_is_no_row_is_named_with_its_package(
    fresh: Site, entry: str, value: str, words: tuple[str, ...], why: str
) -> None:
    rows = fresh.site / "pingpong/rows.py"
    rows.write_text(rows.read_text() + "\nMAGIC = 3\n")
    (info,) = fresh.site.glob("*.dist-info")
    points = (info / "entry_points.txt").read_text().replace("bounce = pingpong.rows:BOUNCE\n", "")
    points = points.replace("pingpong = pingpong.reader:FORMAT\n", "") if entry == "formats" else points
    (info / "entry_points.txt").write_text(
        points.replace(f"[flysid.{entry}]\n", f"[flysid.{entry}]\n{value}\n")
    )
    refused = " ".join(fresh.flysid(*words, fails=True).stderr.split())
    assert f"of flysid.{entry} is not a new {entry.removesuffix('s')}" in refused
    assert why in refused
    assert "package pingpong" in refused


def test_the_help_stands_where_a_verb_of_a_package_is_broken(fresh: Site) -> None:
    (info,) = fresh.site.glob("*.dist-info")
    (info / "entry_points.txt").write_text("[flysid.verbs]\nreferee = pingpong.gone:REFEREE\n")
    offered = {"_FLYSID_COMPLETE": "bash_complete", "COMP_WORDS": "flysid val", "COMP_CWORD": "1"}
    assert "validate" in fresh.flysid(more=offered).stdout
    shown = fresh.flysid("--help").stdout
    assert "validate" in shown
    assert "No module named 'pingpong.gone'" in " ".join(shown.split())


def test_a_figure_that_breaks_takes_nothing_with_it(judged: Site) -> None:
    rows = judged.site / "pingpong/rows.py"
    sound = rows.read_text()
    rows.write_text(sound.replace("    axes = Axes(", "    axes = 1 / 0, Axes("))
    try:
        judged.flysid("validate", "run", "-o", "broken")
    finally:
        rows.write_text(sound)
    page = (judged.folder / "broken/report.html").read_text("utf-8")
    assert "the bounces of height" in page.lower()
    assert "Frequency response" in page


def test_a_package_in_the_working_folder_is_not_asked(fresh: Site) -> None:
    install(fresh.folder)
    fresh.environment["PYTHONPATH"] = f"{os.pathsep}{ROOT}"  # an empty entry is the working folder
    shown = fresh.start("--help").stdout
    assert "validate" in shown
    assert "referee" not in shown


def test_a_structure_may_take_a_file_which_the_run_keeps(fresh: Site) -> None:
    rows = fresh.site / "pingpong/rows.py"
    rows.write_text(rows.read_text().replace('takes=("seed",)', 'takes=("file",)'))
    module = fresh.site / "pingpong/bounce.py"
    module.write_text(module.read_text().replace("    seed: int = 0\n", "    file: Path | None = None\n"))
    words = ("fit", "a.ping", "-r", "pingpong-height", "-o", "run", "-m")
    assert "no such file" in fresh.flysid(*words, "bounce:table.csv", fails=True).stderr
    (fresh.folder / "table.csv").write_text("net,0.1525\n")
    fresh.flysid(*words, "bounce:table.csv")
    assert (fresh.folder / "run/bounce.csv").read_text() == "net,0.1525\n"
    assert "arx takes no file" in fresh.flysid(*words, "arx:table.csv", "--force", fails=True).stderr


def test_a_structure_may_read_from_disk(fresh: Site) -> None:
    rows = fresh.site / "pingpong/rows.py"
    rows.write_text(rows.read_text().replace('takes=("seed",)', 'takes=("seed",), streams=True'))
    module = fresh.site / "pingpong/bounce.py"
    module.write_text(
        module.read_text().replace(
            "if len(train.inputs)", "train = train.head(1000)\n        if len(train.inputs)"
        )
    )
    done = fresh.flysid(
        "fit", "a.ping", "-r", "pingpong-height", "-m", "bounce", "--memory", "0", "-o", "run"
    )
    assert "from disk" in done.stderr
    assert (fresh.folder / "run/height/bounce.json").is_file()
    done = fresh.flysid("fit", "a.ping", "-r", "pingpong-height", "-m", "line", "--memory", "0", "-o", "line")
    assert "line could not be fitted: needs its data in memory" in " ".join(done.stderr.split())
