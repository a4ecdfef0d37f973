"""The gallery: real reports, made by flysid's own commands from simulated logs while the site is built."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jinja2

FIT = "fit logs -r ardrone-synthetic -m ts --rules 2 --effort quick --holdout 0.5 --no-rotate -o run"
VALIDATE = "validate run -o report"


def _fly(folder: str, more: str, seeds: tuple[int, int] = (1, 2)) -> tuple[str, ...]:
    """Twice the flights of a plan, so that enough are held out for a verdict."""
    return tuple(f"synth -o {folder} --no-truth {more} --seed {seed}" for seed in seeds)


@dataclass(frozen=True)
class Example:
    """A report of the gallery; the last of `commands` writes it into the folder `report`."""

    name: str
    title: str
    words: str
    commands: tuple[str, ...]


EXAMPLES = (
    Example(
        "nonlinear",
        "A nonlinear vehicle",
        "The drag of this quadrotor grows with its speed. The gain of the longitudinal channel therefore "
        "depends on the speed. Two rules can follow it; one linear model cannot.",
        (
            *_fly("logs", "--plant ardrone --plan demo --duration 30"),
            f"{FIT} -c longitudinal",
            VALIDATE,
        ),
    ),
    Example(
        "linear",
        "A linear vehicle",
        "The same manoeuvres, flown with a linear plant: rules have nothing to add.",
        (
            *_fly("logs", "--plant ardrone-linear --plan demo --duration 30"),
            f"{FIT} -c lateral",
            VALIDATE,
        ),
    ),
    Example(
        "one-flight",
        "A single flight",
        "One log, split in time. Every verdict is limited to this flight: nothing is known of another.",
        (
            "synth -o logs --no-truth --plant ardrone --plan multisine --duration 90",
            f"{FIT} -c longitudinal",
            VALIDATE,
        ),
    ),
    Example(
        "wind",
        "Wind and gusts",
        "Steady wind of 3 m/s with turbulence pushes the vehicle beyond what its inputs explain. Compare the "
        "coherence and the cautions with those of the calm flights.",
        (
            *_fly("logs", "--plant ardrone --plan demo --duration 30 --wind 3"),
            f"{FIT} -c longitudinal",
            VALIDATE,
        ),
    ),
    Example(
        "routine",
        "Ordinary flying",
        "Routine flights excite little: long stretches of hover and few changes of the input. Look at the "
        "width of the intervals, and at the cautions.",
        (
            *_fly("logs", "--plant ardrone --plan routine --duration 30"),
            f"{FIT} -c vertical",
            VALIDATE,
        ),
    ),
    Example(
        "two-runs",
        "Before and after a change",
        "The second set of logs comes from a vehicle with twice the drag. Models fitted to both "
        "sets are compared on flights that neither has seen.",
        (
            *_fly("before", "--plant ardrone --plan demo --duration 30"),
            *_fly("after", "--plant ardrone --plan demo --duration 30 --change 1:1:drag:2", (3, 4)),
            f"{FIT.replace('logs', 'before').replace('run', 'old')} -c longitudinal",
            f"{FIT.replace('logs', 'after').replace('run', 'new')} -c longitudinal",
            "compare old new -o report",
        ),
    ),
)


def make(example: Example, folder: Path) -> None:
    """Run the commands in a temporary folder, and leave NAME.html, NAME.svg and NAME.json in `folder`."""
    with TemporaryDirectory() as work:
        for command in example.commands:
            words = [sys.executable, "-m", "flysid", *shlex.split(command), "-q"]
            done = subprocess.run(
                words, cwd=work, capture_output=True, text=True, env=os.environ, check=False
            )
            if done.returncode not in (0, 3):
                raise RuntimeError(f"gallery: flysid {command}: {done.stderr}")
        page = (Path(work) / "report" / "report.html").read_text("utf-8")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{example.name}.svg").write_text(first_picture(page), "utf-8")
    said = {"verdict": jinja2.filters.do_striptags(_between(page, '<h1 id="verdict">', "</h1>"))}
    (folder / f"{example.name}.json").write_text(json.dumps(said), "utf-8")
    (folder / f"{example.name}.html").write_text(page, "utf-8")


def first_picture(page: str) -> str:
    """The picture of the first card as a file of its own, with the page's colours."""
    found = re.search(r'<svg [^>]*class="telling">.*?</svg>', page, re.DOTALL)
    if found is None:
        raise RuntimeError("gallery: the page has no picture on its first card")
    style = (
        "path{fill:none}text{font:11px sans-serif;fill:#5b6275}.grid{stroke:#e4e4df}.measured{stroke:#181b25}"
        ".arx{stroke:#c2570c;stroke-width:1.6;stroke-dasharray:5 3}.ts{stroke:#1d5fd6;stroke-width:1.6}"
    )
    svg = found[0].replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" style="background:#fff" ', 1)
    return re.sub(r"(<svg [^>]*>)", rf"\1<style>{style}</style>", svg, count=1)


def _between(text: str, before: str, after: str) -> str:
    return text.partition(before)[2].partition(after)[0]


def section(example: Example, folder: Path) -> str:
    """The Markdown of one example."""
    verdict = json.loads((folder / f"{example.name}.json").read_text("utf-8"))["verdict"]
    commands = "\n".join(map(_wrapped, example.commands))
    return (
        f"## {example.title}\n\n"
        f'<a href="gallery/{example.name}.html"><img src="gallery/{example.name}.svg" width="420" '
        f'alt="First channel of the report: {example.title}"></a>\n\n'
        f"{example.words}\n\n**{verdict}** "
        f'<a href="gallery/{example.name}.html">Open the report</a>\n\n```console\n{commands}\n```\n'
    )


def _wrapped(command: str) -> str:
    """As typed in a shell, no line wider than the page."""
    lines = textwrap.wrap(f"$ flysid {command}", 78, subsequent_indent="    ", break_on_hyphens=False)
    return " \\\n".join(lines)


def make_gallery(app: Any) -> None:
    """Called by Sphinx before it reads: reports that are missing from the site are made."""
    for example in _wanted(app):
        if not (Path(app.outdir) / "gallery" / f"{example.name}.html").is_file():
            make(example, Path(app.outdir) / "gallery")


def fill_gallery(app: Any, page: str, source: list[str]) -> None:
    """Called by Sphinx with the text of every page: the gallery's lists the reports."""
    if page == "gallery":
        folder = Path(app.outdir) / "gallery"
        source[0] += "\n".join(section(example, folder) for example in _wanted(app))


def _wanted(app: Any) -> list[Example]:
    """All, or those that `sphinx -D gallery=NAME,NAME` names."""
    names = app.config.gallery.split(",")
    return [example for example in EXAMPLES if "all" in names or example.name in names]
