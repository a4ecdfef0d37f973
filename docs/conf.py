"""Sphinx: the documentation as a site. `make docs` builds it without network; warnings are errors."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import flysid

sys.path.insert(0, str(Path(__file__).parent))
from gallery_reports import fill_gallery, make_gallery

project = "flysid"
author = "the flysid authors"
release = flysid.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_click"]
exclude_patterns = ["_build", "pictures"]
html_theme = "furo"
html_title = "flysid"
html_show_copyright = False
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence"]
suppress_warnings = ["myst.xref_missing"]  # links to files of the repository, such as the licence
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give shapes and units

_ENTRY = re.compile(r"^(\S.*?) : (.*)$")


def list_entries(_app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Sections of our docstrings as lists: their entries read `name : meaning`, on one line."""
    out: list[str] = []
    in_section = False
    for i, line in enumerate(lines):
        below = lines[i + 1] if i + 1 < len(lines) else ""
        if below and set(below) == {"-"} and line.strip():
            out += [f"**{line}**", ""]
            in_section = True
        elif set(line) == {"-"}:
            continue
        elif in_section and (entry := _ENTRY.match(line)):
            names = ", ".join(f"``{name.strip()}``" for name in entry[1].split(","))
            out.append(f"- {names}: {entry[2]}")
        elif in_section and line.startswith(" "):
            out.append("  " + line.strip())
        else:
            out.append(line)
    lines[:] = out


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", list_entries)
    app.add_config_value("gallery", "all", "env")
    app.connect("builder-inited", make_gallery)
    app.connect("source-read", fill_gallery)
