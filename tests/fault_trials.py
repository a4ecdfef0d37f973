"""Trials of faults: commands killed at random points, disks that fill, handles that run out.

Each trial runs the real command line in processes of their own, in empty folders. The tests make a few,
`soak` makes many.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import zstandard

from flysid.store import list_flights, read_flight
from soak import Outcome
from tests.ingest.formats.test_captures import over_udp, pcapng
from tests.ingest.formats.test_tlog import flying
from tests.samplelogs import blackbox, crazyflie, mavlogdump, parquet, tlog

ROOT = Path(__file__).resolve().parents[1]
PLACE = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Verb:
    """A command whose output is a folder: `arguments` come before the folder's path."""

    arguments: tuple[str, ...]
    module: str = "flysid"

    def command(self, out: Path) -> list[str]:
        return [sys.executable, "-m", self.module, *self.arguments, str(out)]

    def run(self, out: Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.command(out), cwd=out.parent, env=PLACE, capture_output=True, text=True, check=False
        )


Write = Callable[[Path, int, int], None]


def write_logs(folder: Path, count: int, repeat: int = 4) -> None:
    """Tlogs with different contents; each `repeat` times the sample."""
    folder.mkdir(parents=True)
    for i in range(count):
        (folder / f"log{i:02}.tlog").write_bytes(_tlog(i, repeat))


def _tlog(number: int, repeat: int) -> bytes:
    mav = tlog.sender(7)
    last = tlog.frame(mav, mav.heartbeat_encode(2, 3, 0, number, 4))
    return tlog.build() * repeat + tlog.stamped(tlog.EPOCH_US + 9_000_000, last)


def write_newer_logs(folder: Path, count: int, repeat: int = 4) -> None:
    """A log of each newer format, packed ones among them; an archive of `count` logs."""
    folder.mkdir(parents=True)
    logs = {
        "blackbox.bbl": blackbox.build() * repeat,
        "captured.pcapng": pcapng(over_udp(flying(tlog.sender(), 100 * repeat))),
        "log00": crazyflie.build(),
        "mavlogdump.json": mavlogdump.build() * repeat,
        "packed.tlog.gz": gzip.compress(_tlog(0, repeat), mtime=0),
        "packed.tlog.zst": zstandard.compress(_tlog(1, repeat)),
        "table.parquet": parquet.build(),
    }
    for name, blob in logs.items():
        (folder / name).write_bytes(blob)
    with zipfile.ZipFile(folder / "flights.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(count):
            archive.writestr(f"monday/{i}.tlog", _tlog(i + 2, repeat))


def visible(folder: Path) -> dict[str, str]:
    """Path -> digest of every file that does not hide; times that fits took are left out."""
    found = {}
    for path in sorted(folder.rglob("*")):
        where = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".") for part in where.parts):
            found[str(where)] = hashlib.sha256(_without_times(path)).hexdigest()
    return found


def _without_times(path: Path) -> bytes:
    raw = path.read_bytes()
    if path.name not in ("run.json", "report.json"):
        return raw
    document = json.loads(raw)
    for part in (document, *(c for c in document["channels"] if isinstance(c, dict))):
        part.pop("fit_seconds", None)
    return json.dumps(document, sort_keys=True).encode()


# ------------------------------------------------------------------------------------------ kill -9


def kill_when(command: Sequence[str], where: Path, due: Callable[[], bool]) -> bool:
    """Start a command, kill it as soon as it is due; True where it was still running."""
    with subprocess.Popen(
        command, cwd=where, env=PLACE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as child:
        while child.poll() is None:
            if due():
                child.send_signal(signal.SIGKILL)
                child.wait()
                return True
            time.sleep(0.001)
    return False


def after(seconds: float) -> Callable[[], bool]:
    """Due when this time has passed from now on."""
    stop = time.monotonic() + seconds
    return lambda: time.monotonic() >= stop


class Changes:
    """Counts changes of what is written for an output: its files, and those beside it in the making."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._last: list[str] | None = None
        self.count = -1

    def seen(self) -> int:
        """How many changes so far."""
        beside = f".{self._out.name}."
        tops = [p for p in self._out.parent.iterdir() if p == self._out or p.name.startswith(beside)]
        walked = (step for top in tops for step in os.walk(top))  # passes over what vanishes meanwhile
        found = sorted(f"{folder}/{name}" for folder, _, files in walked for name in ("", *files))
        if found != self._last:
            self._last = found
            self.count = self.count + 1
        return self.count


def killed_ingests(
    folder: Path,
    count: int,
    goes_on: Callable[[], bool] = lambda: True,
    *,
    seed: int = 0,
    name: str = "ingest",
    write: Write = write_logs,
) -> Outcome:
    """`kill -9` during ingest, then the same command again: as if nothing had happened."""
    write(folder / "logs", 6, 4)
    verb = Verb(("ingest", str(folder / "logs"), "-q", "-o"))
    began = time.monotonic()
    assert verb.run(folder / "whole").returncode == 0
    length = time.monotonic() - began
    whole = visible(folder / "whole")
    outcome = Outcome(name)
    rng = random.Random(seed)
    interrupted = 0
    while outcome.trials < count and goes_on():
        out = folder / f"data{outcome.trials}"
        with outcome.trial():
            interrupted += kill_when(verb.command(out), folder, after(rng.uniform(0.1, 1.05) * length))
            left = visible(out) if out.exists() else {}
            if not left.items() <= whole.items() and not _is_whole_so_far(out, whole):
                outcome.failures.append(
                    f"trial {outcome.trials}: visible files that an undisturbed run lacks"
                )
            again = verb.run(out)
            if again.returncode != 0 or visible(out) != whole:
                outcome.failures.append(f"trial {outcome.trials}: differs after one more run: {again.stderr}")
        shutil.rmtree(out, ignore_errors=True)
    outcome.remark = f"{interrupted} still running when killed"
    return outcome


def _is_whole_so_far(data: Path, whole: dict[str, str]) -> bool:
    """Every flight that is there is complete and readable."""
    for manifest in list_flights(data):
        read_flight(data, manifest.id)
    return visible(data).items() <= whole.items()


def killed_replacements(
    folder: Path, verb: Verb, name: str, count: int, goes_on: Callable[[], bool] = lambda: True
) -> Outcome:
    """`kill -9` while an output is replaced: the old one is intact, or the new one complete.

    Every other trial is killed at a change of what is written, as these moments are short and the ones that
    count; the rest at any time. `folder / "old"` holds the old output.
    """
    old = visible(folder / "old")
    shutil.copytree(folder / "old", folder / "new")
    began = time.monotonic()
    changes = Changes(folder / "new")
    kill_when(verb.command(folder / "new"), folder, lambda: changes.seen() < 0)
    length = time.monotonic() - began
    new = visible(folder / "new")
    assert new != old
    outcome = Outcome(name)
    rng = random.Random(1)
    interrupted = 0
    kept = 0
    while outcome.trials < count and goes_on():
        out = folder / f"trial{outcome.trials}"
        shutil.copytree(folder / "old", out)
        with outcome.trial():
            own = Changes(out)
            last = rng.randint(1, changes.count)
            at_change = partial(_has_reached, own, last)
            due = after(rng.uniform(0.3, 1.05) * length) if outcome.trials % 2 else at_change
            interrupted += kill_when(verb.command(out), folder, due)
            left = visible(out) if out.is_dir() else {}
            kept += left == old
            if left not in (old, new):
                outcome.failures.append(f"trial {outcome.trials}: neither the old output nor the new one")
            again = verb.run(out)
            if again.returncode != 0 or visible(out) != new:
                outcome.failures.append(f"trial {outcome.trials}: differs after one more run: {again.stderr}")
            hidden = [p.name for p in folder.iterdir() if p.name.startswith(f".{out.name}.")]
            if hidden:
                outcome.failures.append(f"trial {outcome.trials}: left behind: {hidden}")
        shutil.rmtree(out, ignore_errors=True)
    outcome.remark = f"{interrupted} still running when killed, {kept} left the old output"
    return outcome


def _has_reached(changes: Changes, count: int) -> bool:
    return changes.seen() >= count


# --------------------------------------------------------------------------- disks, rights, handles


@contextmanager
def small_disk(folder: Path, size: str, options: str = "") -> Iterator[Path]:
    """A file system of a size, mounted at `folder`. Raises PermissionError where one may not mount."""
    folder.mkdir(parents=True, exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}{options}", "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise PermissionError("no mount") from error
    if done.returncode:
        raise PermissionError(done.stderr)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], capture_output=True, check=False)


def resize(folder: Path, size: str) -> None:
    command = ["mount", "-o", f"remount,rw,size={size}", str(folder)]
    subprocess.run(command, capture_output=True, check=True)


def full_disks(
    folder: Path, sizes: Sequence[str], *, name: str = "full disk", write: Write = write_logs
) -> Outcome:
    """Ingest onto disks that are too small: refused by name, nothing partial; resumes once there is room."""
    write(folder / "logs", 3, 60)
    verb = Verb(("ingest", str(folder / "logs"), "-q", "-o"))
    assert verb.run(folder / "whole").returncode == 0
    whole = visible(folder / "whole")
    outcome = Outcome(name)
    for size in sizes:
        with outcome.trial(), small_disk(folder / f"disk{outcome.trials}", size) as disk:
            done = verb.run(disk / "data")
            if done.returncode or visible(disk / "data") != whole:  # else the disk was large enough
                _refused(outcome, size, done, disk / "data", whole, ("No space left", "MB"))
            resize(disk, "64m")
            again = verb.run(disk / "data")
            if again.returncode != 0 or visible(disk / "data") != whole:
                outcome.failures.append(f"{size}: does not resume: {again.stderr}")
    return outcome


def read_only_disks(folder: Path) -> Outcome:
    """Targets that cannot be written to."""
    outcome = Outcome("read-only disk")
    write_logs(folder / "logs", 1)
    verb = Verb(("ingest", str(folder / "logs"), "-q", "-o"))
    with outcome.trial(), small_disk(folder / "ro", "1m", ",ro") as disk:
        _refused(outcome, "read-only", verb.run(disk / "data"), disk / "data", {}, ("Read-only",))
    return outcome


def limited(
    folder: Path, limits: Sequence[str], *, name: str = "ulimit", write: Write = write_logs
) -> Outcome:
    """Ingest under `ulimit`: of a file's size (-f, in kB) or of open files (-n); then without."""
    write(folder / "logs", 3, 60)
    verb = Verb(("ingest", str(folder / "logs"), "-q", "-o"))
    assert verb.run(folder / "whole").returncode == 0
    whole = visible(folder / "whole")
    outcome = Outcome(name)
    for limit in limits:
        out = folder / f"data{outcome.trials}"
        with outcome.trial():
            command = ["bash", "-c", f'ulimit {limit}; exec "$@"', "-", *verb.command(out)]
            done = subprocess.run(command, cwd=folder, env=PLACE, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                _refused(outcome, limit, done, out, whole, ())
            again = verb.run(out)
            if again.returncode != 0 or visible(out) != whole:
                outcome.failures.append(f"{limit}: does not resume: {again.stderr}")
    return outcome


def _refused(
    outcome: Outcome,
    what: str,
    done: subprocess.CompletedProcess[str],
    out: Path,
    whole: dict[str, str],
    words: tuple[str, ...],
) -> None:
    """Exit 1, words that name the path and the need, no traceback, nothing partial."""
    outcome.raised += done.returncode == 1
    if done.returncode not in (1, 3) or "Traceback" in done.stderr:
        outcome.failures.append(f"{what}: ended with {done.returncode}: {done.stderr[-600:]}")
    missing = [word for word in (*words, "" if not words else str(out)) if word not in done.stderr]
    if missing:
        outcome.failures.append(f"{what}: does not say {missing}: {done.stderr}")
    left = visible(out) if out.exists() else {}
    if not left.items() <= whole.items():
        outcome.failures.append(f"{what}: left {sorted(left.items() - whole.items())}")


# ------------------------------------------------------------------------------ runs, and their equality


def small_data(folder: Path) -> Path:
    """Four flights of 12 s of the linear plants, ingested."""
    from flysid.ingest.synth.synth import WRITERS, Order, flights

    (folder / "logs").mkdir(parents=True)
    for i, recording in enumerate(flights(Order(duration_s=12.0))):
        suffix, encode = WRITERS["tlog"]
        if i < 4:
            (folder / "logs" / f"{recording.name}{suffix}").write_bytes(encode(recording))
    done = Verb(("ingest", str(folder / "logs"), "-q", "-o")).run(folder / "data")
    assert done.returncode == 0, done.stderr
    return folder / "data"


def fit_verb(data: Path, *more: str) -> Verb:
    return Verb(
        (
            "fit",
            str(data),
            "--recipe",
            "ardrone-synthetic",
            "--rules",
            "2",
            "--no-rotate",
            "-q",
            "--force",
            *more,
            "-o",
        )
    )


def quick_fit(data: Path, *more: str) -> Verb:
    """A fit of one channel with models that take no time: what is written, and how, is that of any other."""
    return Verb(fit_verb(data, "--channel", "vertical", *more).arguments, "tests.quick_flysid")


def killed_fits(folder: Path, count: int, goes_on: Callable[[], bool] = lambda: True) -> Outcome:
    """`kill -9` while a run is fitted in place of another."""
    data = small_data(folder)
    assert quick_fit(data, "--seed", "1").run(folder / "old").returncode == 0
    return killed_replacements(folder, quick_fit(data), "fit", count, goes_on)


def killed_validations(folder: Path, count: int, goes_on: Callable[[], bool] = lambda: True) -> Outcome:
    """`kill -9` while a report is written in place of another."""
    data = small_data(folder)
    for seed in ("1", "2"):
        done = quick_fit(data, "--seed", seed).run(folder / f"run{seed}")
        assert done.returncode == 0, done.stderr
    assert Verb(("validate", str(folder / "run1"), "-q", "-o")).run(folder / "old").returncode == 0
    verb = Verb(("validate", str(folder / "run2"), "-q", "--force", "-o"))
    return killed_replacements(folder, verb, "validate", count, goes_on)


def _channels(*names: str) -> list[str]:
    return [word for name in names for word in ("--channel", name)]


def equal_runs(folder: Path, workers: Sequence[int]) -> Outcome:
    """The same fit and judgement again and again, with these numbers of workers: the same bytes."""
    data = small_data(folder)
    outcome = Outcome("fit and validate")
    first: dict[str, str] = {}
    for count in workers:
        run = folder / f"run{outcome.trials}"
        with outcome.trial():
            done = fit_verb(data, *_channels("vertical", "lateral"), "--jobs", str(count)).run(run)
            judged = Verb(("validate", str(run), "-q", "--csv", "-o")).run(folder / f"report{outcome.trials}")
            if done.returncode or judged.returncode:
                outcome.failures.append(done.stderr + judged.stderr)
            report = visible(folder / f"report{outcome.trials}").get("report.json", "")
            found = visible(run) | {"report.json": report, "stdout": judged.stdout}
            first = first or found
            if found != first:
                unlike = sorted(k for k in found | first if found.get(k) != first.get(k))
                outcome.failures.append(f"run {outcome.trials} with {count} workers differs: {unlike}")
    return outcome
