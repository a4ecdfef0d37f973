"""`python -m tests.arx_flysid`: the command line, where ARX alone competes (`tests.contest`).

The jobs of its studio run this program, too.
"""

from __future__ import annotations

import sys

from flysid.cli import main

if __name__ == "__main__":
    if sys.argv[1] == "studio":
        from flysid.studio import jobs

        jobs.PROGRAM = "tests.arx_flysid"
        main()
    else:
        from tests.contest import linear_side

        with linear_side("arx"):
            main()
