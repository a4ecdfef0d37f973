"""`python -m tests.bare_flysid`: the command line as it is where the studio's packages are not installed."""

from __future__ import annotations

import sys

from flysid.cli import main

if __name__ == "__main__":
    sys.modules["starlette"] = None  # type: ignore[assignment]
    main()
