"""Strings that want to be code, in every field that can reach a report (row 14).

The plain check needs no browser: the page of a hostile string has the same tags and attributes, in the same
order, as that of a harmless one, and no attribute that would run or load anything. In a browser nothing sets
the mark.
"""

from __future__ import annotations

import csv
import io
import json
import random
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from flysid.dataset import Dataset, Segment
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.document import to_json
from flysid.validate.show.page import ReportContext, render
from flysid.validate.show.tables import to_csv, to_markdown
from flysid.validate.show.terminal import summary, table
from soak import Outcome
from tests.fakes import FirstOrder
from tests.input_trials import GoesOn, always

MARK = "data-hacked"
SET = f"document.documentElement.setAttribute('{MARK}',1)"
SCRIPTS = (
    f"<script>{SET}</script>",
    f"</script><script>{SET}</script>",
    f"<img src=x onerror={SET}>",
    f"<svg/onload={SET}>",
    f"<iframe srcdoc='<script>parent.{SET}</script>'>",
    f"<details open ontoggle={SET}>",
    f'"><input autofocus onfocus="{SET}">',
    f"' onmouseover='{SET}",
    f"javascript:{SET}",
    f"<a href=javascript:{SET}>x</a>",
    f"<style>@import 'http://127.0.0.1:9/x'</style><body onload={SET}>",
    "</style><style>*{display:none}</style>",
    "</title></head><body>",
    "<base href=http://127.0.0.1:9/>",
    "<meta http-equiv=refresh content=0;url=http://127.0.0.1:9/>",
    "<link rel=stylesheet href=http://127.0.0.1:9/x.css>",
    "{{ 7*7 }}{% for x in y %}{{ config }}",
    f"${{{SET}}}`'\"\\",
    "]]>--><!--",
    "&lt;script&gt;&#60;script&#62;",
    "=HYPERLINK(\"http://127.0.0.1:9/\",\"x\")",
    "=cmd|' /C calc'!A0",
    "+1+1", "-2+3", "@SUM(1+1)", "\t=1+1", "\r=1+1",
    "| a | b |\n|---|---|\n| [x](javascript:1) | ![x](http://127.0.0.1:9/) |",
    "\x1b[31m\x1b]0;title\x07", "a\x00b\x08\x7f", "\u202e\u2066evil\u200b", "\ud83d\ude00", "\udcff",
    "../../etc/passwd", "C:\\con", "%s%n{}{0.__class__}", "x" * 3000, " ",
    "'", '"', "<", "&", "\\u003c/script>",
)  # fmt: skip
FIELDS = (
    "channel",
    "input",
    "output",
    "unit",
    "flight",
    "note",
    "rule",
    "model",
    "command",
    "remark",
    "label",
    "skipped",
    "reason",
)
LOADING = {"src", "srcdoc", "href", "action", "formaction", "data", "poster", "background"}


class Skeleton(HTMLParser):
    """Tags with the names of their attributes, and attributes that would run or load something."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, ...]] = []
        self.live: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, *(name for name, _ in attrs)))
        for name, value in attrs:
            loads = name in LOADING and not (value or "").startswith(("#", "data:"))
            if name.startswith("on") or loads or ("javascript:" in (value or "").lower() and name in LOADING):
                self.live.append(f"<{tag} {name}={value}>")


def texts(count: int) -> list[str]:
    """The scripts, then what becomes of two of them in one text."""
    rng = random.Random(14)
    more = (
        rng.choice(("{}{}", "{} {}", "a {}\n{}", "{}\t{}", "{}\u00a0{}")).format(*rng.sample(SCRIPTS, 2))
        for _ in range(count)
    )
    return [*SCRIPTS, *more][:count]


def page_with(given: Mapping[str, str]) -> tuple[str, list[str]]:
    """A report with these texts in these fields, and the other forms of the same comparison."""
    pick = {name: given.get(name, f"harmless {name}") for name in FIELDS}
    arx = FirstOrder(a=0.9, b=0.08)
    ts = FirstOrder(a=0.9, b=0.1, structure="ts", labels=("R1", pick["rule"]))
    inputs = (replace(arx.inputs[0], name=pick["input"]),)
    outputs = (replace(arx.outputs[0], name=pick["output"], unit=pick["unit"]),)
    models = {
        "arx": replace(arx, inputs=inputs, outputs=outputs, notes=(pick["note"],)),
        pick["model"]: replace(ts, inputs=inputs, outputs=outputs),
    }
    rng = np.random.default_rng(0)
    segments = []
    for k in range(2):
        u = rng.normal(size=(120, 1))
        segments.append(Segment(u, arx.simulate(u), flight=pick["flight"] + str(k), t0_ns=k * 10**12))
    data = Dataset(arx.dt_s, inputs, outputs, tuple(segments), name=pick["channel"])
    name = pick["channel"]
    c = compare(models, data)
    context = ReportContext(
        {name: c},
        train={name: data},
        command=pick["command"],
        remark=pick["remark"],
        provenance={pick["label"]: pick["label"]},
        skipped={pick["skipped"]: pick["reason"]},
    )
    beware = cautions({name: c}, context.diagnoses)
    markdown = to_markdown({name: c}, None, beware, context.skipped)
    document = json.dumps(to_json({name: c}, context.diagnoses), allow_nan=False)
    forms = [document, table({name: c}), summary({name: c}), to_csv({name: c}), markdown]
    return render(context), forms


def skeleton(page: str) -> Skeleton:
    found = Skeleton()
    found.feed(page)
    found.close()
    return found


def injections(
    goes_on: GoesOn = always, count: int = len(SCRIPTS), step: int = 1, pages: Path | None = None
) -> Outcome:
    """Every one of `count` texts in every field, as many at a time as there are fields.

    Each page has another text in every field, so that after `count` pages each text has stood in each; with a
    larger `step` in some. Where a page fails, its texts are tried alone. `pages` keeps pages for a browser.
    """
    outcome = Outcome("strings in reports")
    every = texts(count)
    for number in range(0, count, step):
        if not goes_on():
            break
        given = {field: every[(number + k) % count] for k, field in enumerate(FIELDS)}
        with outcome.trial():
            page, faults = _tried(given)
        if faults:
            alone = [f"{t[:40]!r} as {f}: {fault}" for f, t in given.items() for fault in _tried({f: t})[1]]
            outcome.failures += alone or faults
        if pages is not None:
            (pages / f"{number}.html").write_text(page, "utf-8", errors="replace")
    outcome.remark = f"{len(FIELDS)} strings a trial"
    return outcome


@cache
def _plain_tags(signed: bool) -> list[tuple[str, ...]]:
    """Tags of a page of harmless texts; an output whose name begins with a sign has no memberships drawn."""
    return skeleton(page_with({"output": "-harmless output"} if signed else {})[0]).tags


def _tried(given: Mapping[str, str]) -> tuple[str, list[str]]:
    page, forms = page_with(given)
    plain = _plain_tags(given.get("output", "").replace(" ", "")[:1] in ("+", "-"))
    return page, list(_faults(page, forms, plain, set(given.values())))


def _faults(page: str, forms: list[str], plain: list[tuple[str, ...]], given: set[str]) -> Iterator[str]:
    found = skeleton(page)
    if found.tags != plain:
        at = next((i for i, (a, b) in enumerate(zip(found.tags, plain, strict=False)) if a != b), -1)
        yield f"the page's tags differ from {at} on: {found.tags[at : at + 3]} for {plain[at : at + 3]}"
    yield from found.live
    if any(not (c == "\n" or c.isprintable()) for form in forms[1:] for c in form):
        yield "control characters in text"
    if re.search(r"(?<!\\)(?:\\\\)*[<\[`]", re.sub(r"\| \[[−+0-9][^|]*\] \|", "", forms[4])):
        yield "Markdown that is not text"
    for row in csv.reader(io.StringIO(forms[3])):
        if any(
            (cell[:1] in "=@\t\r" and cell) or (cell[:2] in ("+1", "-2") and cell in given) for cell in row
        ):
            yield f"a cell that a spreadsheet would run: {row}"
    page.encode("utf-8")


def browsed(pages: Path, goes_on: GoesOn = always, chromium: str | None = None) -> Outcome | None:
    """The pages opened by chromium, which must not set the mark; None where there is none."""
    chromium = chromium or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        return None
    outcome = Outcome("strings in a browser")
    for page in sorted(pages.glob("*.html")):
        if not goes_on():
            break
        with outcome.trial():
            command = [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", page.as_uri()]
            done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
            head = done.stdout[: done.stdout.find(">", done.stdout.find("<html")) + 1]
            if "data-ready" not in head and "<html" not in head:
                outcome.failures.append(f"{page.name}: not opened: {done.stderr[-200:]}")
            if MARK in head:
                outcome.failures.append(f"{page.name}: a script ran")
    return outcome
