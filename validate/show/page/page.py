"""The page of a comparison as a string."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from flysid.escaping import one_line
from flysid.validate.diagnose.context import ReportContext
from flysid.validate.show.page.describe import Page, describe
from flysid.validate.show.page.html import environment, load_asset, script_json, security_policy, write_page


def write_report(path: str | Path, context: ReportContext) -> Path:
    """Write the page whole or not at all; returns its path. Raises StoreError: the file cannot be written."""
    return write_page(path, render(context))


def render(context: ReportContext) -> str:
    """The page of what was found, with a sentence on everything that is missing."""
    page = describe(context)
    return fill(page, context.missing.sentences)


def fill(page: Page, missing: Sequence[str]) -> str:
    """The template with a page in it; `missing` are sentences on what could not be given."""
    styles = load_asset("uPlot.min.css") + "\n" + load_asset("page.css")
    scripts = [load_asset("uPlot.iife.min.js"), load_asset("page.js")]
    return (
        environment()
        .get_template("page.html.j2")
        .render(
            vars(page),
            csp=security_policy(scripts, styles),
            styles=Markup(styles),
            scripts=[Markup(script) for script in scripts],
            data=Markup(script_json([section.data for section in page.sections])),
            missing=[one_line(words) for words in missing],
        )
    )
