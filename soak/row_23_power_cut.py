"""Row 23: power cut during ingest. The disk, as it stood then, is mounted anew: no finished flight is lost.

An ext4 file system in a file on a memory disk stands for the disk: what the kernel has not written to it is
not in a copy of that file. The copy takes milliseconds, during which ingest is stopped. What a real disk
keeps in a cache of its own is not modelled. A flight that shows must be whole.
"""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from flysid.store import list_flights, read_flight
from soak import Budget, Campaign, Outcome
from tests.fault_trials import PLACE, write_logs

TRIALS = 50
LOGS = 12
INGEST = """
import sys
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
for result in ingest_logs(find_logs([sys.argv[1]]), sys.argv[2], bounds=None):
    print(result.flight.id, flush=True)
"""


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome."""
    outcome = Outcome("ingest")
    rng = random.Random(23)
    goes_on = budget.clock()
    finished = 0
    with tempfile.TemporaryDirectory(dir="/dev/shm") as place:
        folder = Path(place)
        write_logs(folder / "logs", LOGS)
        try:
            while outcome.trials < TRIALS and goes_on():
                with outcome.trial():
                    finished += cut(folder, rng, outcome)
        except PermissionError:
            outcome.remark = "not tried: this user may not mount"
            yield outcome
            return
    outcome.remark = f"{finished} flights were finished when the power went"
    yield outcome


def cut(folder: Path, rng: random.Random, outcome: Outcome) -> int:
    """Ingest, take the disk away after some flight, look at what it holds; how many had been finished."""
    disk = folder / "disk"
    copy = folder / "copy"
    with disk.open("wb") as file:
        file.truncate(64 << 20)
    subprocess.run(["mkfs.ext4", "-q", "-F", str(disk)], check=True, capture_output=True)
    with mounted(disk, folder / "before") as before:
        command = [sys.executable, "-c", INGEST, str(folder / "logs"), str(before / "data")]
        with subprocess.Popen(command, env=PLACE, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            done = [child.stdout.readline().strip() for _ in range(rng.randint(1, LOGS - 1))]
            time.sleep(rng.uniform(0.0, 0.05))
            child.send_signal(signal.SIGSTOP)
            shutil.copyfile(disk, copy)
            child.kill()
    with mounted(copy, folder / "after") as after:
        data = after / "data"
        found = [manifest.id for manifest in list_flights(data)] if data.exists() else []
        for name in found:
            read_flight(data, name)
        lost = sorted(set(done) - set(found))
        if lost:
            outcome.failures.append(f"trial {outcome.trials}: lost {', '.join(lost)}")
    return len(done)


@contextmanager
def mounted(disk: Path, folder: Path) -> Iterator[Path]:
    """A file system in a file, mounted. Raises PermissionError where one may not mount."""
    folder.mkdir(exist_ok=True)
    done = subprocess.run(["mount", "-o", "loop", str(disk), str(folder)], capture_output=True, check=False)
    if done.returncode:
        raise PermissionError(done.stderr)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], capture_output=True, check=True)


CAMPAIGN = Campaign(23, "power cut during ingest", run)
