"""Files of pictures, drawn with matplotlib, which is imported only when a picture is drawn.

No window, no global state; equal pictures give equal files. Fonts are embedded as text.
"""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flysid.errors import UsageError
from flysid.files import write_atomically, writing_to

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DATELESS: dict[str, dict[str, Any]] = {
    ".png": {"Software": "flysid"},
    ".svg": {"Date": None, "Creator": "flysid"},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": "flysid"},
}
"""Metadata of each kind of file: nothing that differs from run to run."""
FONTS: dict[Any, Any] = {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "flysid"}
FOR_PAPER: dict[Any, Any] = {**FONTS, "font.size": 8.0, "axes.linewidth": 0.6}


def check_picture(path: str | Path) -> None:
    """Raise UsageError where no picture can be drawn into `path`: an unknown ending, no matplotlib."""
    if Path(path).suffix.lower() not in DATELESS:
        raise UsageError(f"no picture format {Path(path).suffix!r}", path=path, hint=", ".join(DATELESS))
    require_matplotlib()


def require_matplotlib() -> None:
    """Raise UsageError where matplotlib is not installed, before any work is done."""
    if importlib.util.find_spec("matplotlib") is None:
        raise UsageError("matplotlib is not installed", hint='pip install "flysid[plot]"')


def picture_bytes(
    draw: Callable[[], Figure], suffix: str, settings: dict[Any, Any] = FOR_PAPER, dpi: float = 200.0
) -> bytes:
    """What is drawn as the content of a file of this kind; equal figures give equal bytes."""
    from matplotlib import rc_context

    content = io.BytesIO()
    with rc_context(settings):
        draw().savefig(content, format=suffix[1:], metadata=DATELESS[suffix], dpi=dpi)
    return content.getvalue()


def save_picture(figure: Figure, path: str | Path) -> None:
    """Write a matplotlib figure whole or not at all. Raises WriteError."""
    path = Path(path)
    content = picture_bytes(lambda: figure, path.suffix.lower(), FONTS, dpi=110.0)
    with writing_to(path):
        write_atomically(path, content)
