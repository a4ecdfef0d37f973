"""`python -I -S counted.py FILE LINE`: a shell runs LINE; FILE gets the CPU seconds of all that it started.

A command's workers may outlive it for a moment, as orphans whose CPU time nobody counts. This process adopts
them (on Linux) and waits for them: one that stays ends the line with code 125.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
import subprocess
import sys
import time

ADOPT = 36  # PR_SET_CHILD_SUBREAPER of linux/prctl.h
END_WITH_PARENT = 1  # PR_SET_PDEATHSIG
PATIENCE_S = 20.0
LEFT_BEHIND = 125


def main() -> int:
    """The line's exit code."""
    file, line = sys.argv[1:]
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(ADOPT, 1, 0, 0, 0)
        ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGTERM, 0, 0, 0)
    signal.signal(signal.SIGTERM, lambda *_: os.killpg(0, signal.SIGKILL))
    signal.signal(signal.SIGINT, lambda *_: None)  # for the line alone; a deaf parent's line hears it again
    code = subprocess.call(["bash", "-c", line])
    whole = _wait_for_orphans()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    with open(file, "w", encoding="utf-8") as counts:
        counts.write(repr(used.ru_utime + used.ru_stime))
    return code if whole else LEFT_BEHIND


def _wait_for_orphans() -> bool:
    """Whether all have ended by themselves; after a while the others are ended."""
    end = time.monotonic() + PATIENCE_S
    with contextlib.suppress(ChildProcessError):
        while time.monotonic() < end:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                time.sleep(0.01)
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
