"""Self-contained pages: templates, styles and scripts in one file that loads nothing.

Safety: names come from logs. The templates escape everything; data blocks are JSON with <, > and & written
as \\u escapes; the Content-Security-Policy allows a page's own scripts and styles by hash and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined

from flysid.files import write_atomically, writing_to
from flysid.showing import number, percentage


@cache
def load_asset(name: str) -> str:
    """A file of `assets/`."""
    return (resources.files("flysid.validate.show.page") / "assets" / name).read_text("utf-8")


@cache
def environment() -> Environment:
    """Templates from `assets/`; what they print is escaped."""
    made = Environment(
        loader=FunctionLoader(load_asset),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["number"] = number
    made.filters["percentage"] = percentage
    return made


def plain_page(text: str) -> str:
    """A report that is text alone."""
    return environment().get_template("plain.html.j2").render(text=text)


def security_policy(scripts: Sequence[str], styles: str) -> str:
    """Only these scripts and styles run; nothing is loaded from anywhere."""
    allowed = " ".join(_hash(s) for s in scripts)
    return (
        f"default-src 'none'; script-src {allowed}; style-src {_hash(styles)}; "
        "img-src 'none'; base-uri 'none'; form-action 'none'"
    )


def _hash(content: str) -> str:
    return "'sha256-" + base64.b64encode(hashlib.sha256(content.encode()).digest()).decode() + "'"


def script_json(value: Any) -> str:
    """JSON that cannot end its <script> block nor start a comment in it."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def write_page(path: str | Path, text: str) -> Path:
    """Write a page whole or not at all; returns its path. Raises StoreError: the file cannot be written."""
    path = Path(path)
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode())
    return path
