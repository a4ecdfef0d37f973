"""What the interpreter and libraries would take from the working folder, which may be a stranger's.

Python looks for modules there when it is started as `python -c` or `python -m`, as every worker process is:
a `threading.py` beside the logs would be run. Numba reads `.numba_config.yaml` there, and that file can name
a cache, whose entries are unpickled. Matplotlib takes its style from a `matplotlibrc` there, which can have
LaTeX run.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from flysid.errors import UsageError

SAFE_PATH = "PYTHONSAFEPATH"
STYLE_FILE = "matplotlibrc"
NUMBA_FILE = ".numba_config.yaml"
_OURS = "FLYSID_KEEPS_FOLDER_OUT"


def keep_working_folder_out() -> None:
    """Neither this process nor one that it begins imports modules from the working folder."""
    if not os.environ.get(SAFE_PATH):
        os.environ[SAFE_PATH] = "1"
        os.environ[_OURS] = "1"
    if not sys.flags.safe_path and sys.path and sys.path[0] in ("", os.getcwd()):
        del sys.path[0]


def environment_of_the_user() -> Mapping[str, str]:
    """The environment as the user has set it, for a command that the user has named."""
    ours = {SAFE_PATH, _OURS} if _OURS in os.environ else set()
    return {name: value for name, value in os.environ.items() if name not in ours}


def refuse_numba_settings(folder: Path) -> None:
    """Raise UsageError where Numba would read its settings in this folder."""
    path = folder / NUMBA_FILE
    if path.exists():
        raise UsageError(
            "Numba would take its settings from the working folder, and they can run code",
            path=path,
            hint="remove the file, or run flysid in another folder; NUMBA_... variables set the same",
        )


def ignore_matplotlib_style(folder: Path) -> None:
    """Pictures are drawn in the user's own style, or the usual one, not in that of this folder.

    Raises UsageError: Matplotlib does not understand the file, and so cannot be imported.
    """
    path = folder / STYLE_FILE
    if not path.exists() or importlib.util.find_spec("matplotlib") is None:
        return
    try:
        import matplotlib
    except Exception as error:  # whatever a stranger's file brings about
        raise UsageError(
            f"Matplotlib cannot read it: {error}", path=path, hint="remove it, or work in another folder"
        ) from error
    if os.path.samefile(matplotlib.matplotlib_fname(), path):
        matplotlib.rcdefaults()
