"""`python -m tests.kernels`: compiles what is compiled, into the cache that all tests share.

In a fresh clone every worker of the tests would compile the same functions. `make test` has this done beside
the type check, which leaves a core idle.
"""

from __future__ import annotations

from flysid.live.receiving import warm_up
from tests.format_trials import FORMATS, intact
from tests.model_examples import EXAMPLES, fitted


def main() -> None:
    """Fit one model of every structure, read one log of every format, take one frame from a link."""
    for name in EXAMPLES:
        fitted(name)
    for name in FORMATS:
        intact(name)
    warm_up()


if __name__ == "__main__":
    main()
