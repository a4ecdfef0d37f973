"""Files of pictures, drawn with matplotlib, which is imported only when a picture is asked for."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from flysid.errors import UsageError
from flysid.files import writing_to

SUFFIXES = (".png", ".svg", ".pdf")


def check_picture(path: str | Path) -> None:
    """Raise UsageError where no picture can be drawn into `path`: an unknown ending, no matplotlib."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise UsageError(f"no picture format {Path(path).suffix!r}", path=path, hint=", ".join(SUFFIXES))
    if importlib.util.find_spec("matplotlib") is None:
        raise UsageError("matplotlib is not installed", hint='pip install "flysid[plot]"')


def save_picture(figure: Any, path: str | Path) -> None:
    """Write a matplotlib figure; equal figures give equal SVG files. Raises WriteError."""
    dateless = {"Date": None} if Path(path).suffix.lower() == ".svg" else None
    with writing_to(Path(path)):
        figure.savefig(path, dpi=110, metadata=dateless)
