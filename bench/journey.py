"""The first hour: from a log in hand to a verdict and a file for others, command by command.

`python -m bench.journey [--logs DIR] [-o FILE]`: for .bin, .ulg, .tlog, .mcap, .csv and .bbl, each in a new
folder of its own: doctor, plot, recipes, suggest, fit, page, export. A table says of
every command its exit code, its wall and CPU time, and when its first line came. Logs are simulated; a
blackbox, which cannot be, is the smallest real one below DIR/blackbox that a fit can use. What the commands
printed stands below the table: read it.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import resource
import shlex
import shutil
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

PX4 = "-r px4-velocity -c v_x"
SYNTHETIC = "-r ardrone-synthetic -c longitudinal"
SIMULATED = {
    ".bin": ("dataflash", "-r ardupilot-velocity -c v_x", "--pair attitude"),
    ".ulg": ("ulog", PX4, "--pair attitude"),
    ".tlog": ("tlog", SYNTHETIC, "--recipe ardrone-synthetic"),
    ".mcap": ("mcap", SYNTHETIC, "--recipe ardrone-synthetic"),
}
ROOT = Path(__file__).resolve().parents[1]
"""What is measured, whatever version is installed beside it."""
BLACKBOX = "hiro_highP_highD.bfl"
PR_SET_CHILD_SUBREAPER = 36  # of Linux' prctl.h


@dataclass(frozen=True)
class Step:
    """One command: its exit code, seconds, and what it printed."""

    command: str
    code: int
    wall_s: float
    cpu_s: float
    first_s: float | None
    printed: str


def _adopt_orphans() -> None:
    """Be handed the process that a command's workers came from, so that its time counts too."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def run(command: str, folder: Path) -> Step:
    """Runs `flysid COMMAND` in `folder`, and reads what it prints as it comes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.monotonic()
    child = subprocess.Popen(
        [sys.executable, "-m", "flysid", *shlex.split(command)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": str(ROOT)},
    )
    assert child.stdout is not None
    first_s = None
    lines = []
    for line in child.stdout:
        first_s = time.monotonic() - start if first_s is None else first_s
        lines.append(line.decode("utf-8", "replace"))
    code = child.wait()
    with suppress(ChildProcessError):  # none is left
        while True:
            os.waitpid(-1, 0)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Step(command, code, time.monotonic() - start, cpu_s, first_s, "".join(lines))


def journey(log: str, words: str, plotted: str, folder: Path) -> list[Step]:
    """All commands of one log, in the order in which a newcomer finds them."""
    table = log.endswith(".csv")
    commands = [
        f"doctor {log}",
        f"plot {log} {plotted} -o plot.html",
        *([] if table else [f"recipes --for {log}", f"ls {log} --suggest"]),
        f"fit {log} {words} -m arx -o run",
        "validate run -o page",
        f"export {log} --to csv",
    ]
    return [run(command, folder) for command in commands]


def rig(path: Path) -> None:
    """A motor on a bench: 60 rpm per percent, 0.24 s."""
    rng = np.random.default_rng(1)
    throttle = np.repeat(rng.choice([30.0, 40.0, 50.0, 60.0], 40), 50)
    speed = np.full(len(throttle), 2400.0)
    for n in range(1, len(speed)):
        speed[n] = speed[n - 1] + 0.08 * (60.0 * throttle[n - 1] - speed[n - 1])
    rows = np.column_stack([np.arange(len(speed)) / 50.0, throttle, speed + rng.normal(0.0, 5.0, len(speed))])
    np.savetxt(path, rows, fmt="%.2f", delimiter=",", header="time_s,throttle_pct,speed_rpm", comments="")


def told(journeys: dict[str, list[Step]]) -> str:
    """The table, and below it what every command printed."""
    rows = ["| log | command | exit | wall, s | CPU, s | first line, s |", "|---|---|---|---|---|---|"]
    below = []
    for log, steps in journeys.items():
        for step in steps:
            first = "none" if step.first_s is None else f"{step.first_s:.1f}"
            rows.append(
                f"| {log} | `{step.command}` | {step.code} | {step.wall_s:.1f} | {step.cpu_s:.1f} | {first} |"
            )
            below.append(f"$ flysid {step.command}\n{step.printed}")
    return "\n".join(rows) + "\n\n```console\n" + "\n".join(below) + "```\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=Path, default=Path("../shared/logs"))
    parser.add_argument("--only", default="", help="one suffix, e.g. .ulg")
    parser.add_argument("-o", "--out", type=Path)
    given = parser.parse_args()
    _adopt_orphans()
    journeys: dict[str, list[Step]] = {}
    with TemporaryDirectory() as place:
        for suffix in (*SIMULATED, ".csv", ".bbl"):
            if given.only not in ("", suffix):
                continue
            folder = Path(place) / suffix[1:]
            folder.mkdir()
            log = f"flight{suffix}"
            words = "--from throttle_pct --to speed_rpm"
            plotted = "throttle_pct speed_rpm"
            if suffix in SIMULATED:
                kind, words, plotted = SIMULATED[suffix]
                run(f"synth -o made --plan steps --duration 60 --format {kind} --no-truth", folder)
                next((folder / "made").iterdir()).rename(folder / log)
                (folder / "made").rmdir()
            elif suffix == ".csv":
                rig(folder / log)
            elif not (given.logs / "blackbox" / BLACKBOX).is_file():
                continue
            else:
                shutil.copyfile(given.logs / "blackbox" / BLACKBOX, folder / log)
                words = "-r betaflight-rate -c roll_rate --between 0:10..0:40"
                plotted = "--pair rate"
            journeys[suffix] = journey(log, words, plotted, folder)
            print(suffix, "done", file=sys.stderr, flush=True)
    text = told(journeys)
    if given.out is None:
        print(text)
    else:
        given.out.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
