"""`python -m tests.doors.reproduce_forms`: `flysid reproduce ardrone-ts`, every form into FORM.txt.

Whole and unreduced; the forms share one result, which takes twenty seconds to fit.
"""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

from flysid.cli import main
from flysid.validate.paper import reproduction

FORMS = {"text": (), "json": ("--json",), "figures": ("--figures", "figures")}


def print_all() -> None:
    """Run the verb with the words of every form; the first error ends it."""
    setattr(reproduction, "reproduce_ardrone_ts", cache(reproduction.reproduce_ardrone_ts))  # noqa: B010 - mypy
    for form, words in FORMS.items():
        sys.argv = ["flysid", "reproduce", "ardrone-ts", *words]
        with Path(f"{form}.txt").open("w", encoding="utf-8") as file, redirect_stdout(file):
            try:
                main()
            except SystemExit as end:
                if end.code:
                    raise


if __name__ == "__main__":
    print_all()
