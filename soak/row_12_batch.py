"""Row 12: 200 logs, 10 of them unreadable in 10 ways, in one `flysid ingest`."""

from __future__ import annotations

import gzip
import io
import os
import socket
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import zstandard

from soak import Budget, Campaign, Outcome
from tests.format_trials import FORMATS, module_of, read_or_none, sample

ROOT = Path(__file__).resolve().parents[1]
LOGS = 200
BAD = 10
TIMEOUT_S = 900


def fill(folder: Path) -> list[str]:
    """190 readable logs of all formats that bear zeros at their end, and 10 others; what to ingest.

    Each log has a content of its own.
    """
    names: list[str] = []
    kinds = [kind for kind in FORMATS if read_or_none(kind, sample(kind) + b"\0", Outcome("")) is not None]
    for k in range(LOGS - BAD):
        kind = kinds[k % len(kinds)]
        path = folder / f"good{k:03}{module_of(kind).SUFFIX}"
        path.write_bytes(sample(kind) + bytes(k // len(kinds)))  # a few stray zeros make each its own
        names.append(str(path))
    return names + [str(path) for path in unreadable(folder)]


def unreadable(folder: Path) -> list[Path]:
    """Empty, cut, of another kind, a folder, a pipe, a socket, a loop, a broken link, a device, a picture."""
    blobs = {"empty.tlog": b"", "cut.mcap": sample("mcap")[:9], "notes.bin": b"notes\n" * 99}
    blobs["picture.ulg"] = b"\x89PNG\r\n\x1a\n" + bytes(500)
    paths = [folder / name for name in blobs]
    for path, blob in zip(paths, blobs.values(), strict=True):
        path.write_bytes(blob)
    others = [
        folder / n for n in ("pipe.tlog", "socket.bin", "loop.ulg", "broken.log", "null.mcap", "zeros.bag")
    ]
    os.mkfifo(others[0])
    with socket.socket(socket.AF_UNIX) as link:
        link.bind(str(others[1]))
    others[2].symlink_to(others[2])
    others[3].symlink_to(folder / "nowhere")
    others[4].symlink_to("/dev/null")
    others[5].write_bytes(bytes(5000))
    return paths + others


def fill_packed(folder: Path) -> list[str]:
    """The same logs, a third each as .gz, as .zst and in one archive, and 10 that cannot be unpacked."""
    plain = folder / "plain"
    plain.mkdir()
    logs = [Path(name) for name in fill(plain)[: LOGS - BAD]]
    names: list[str] = []
    with zipfile.ZipFile(folder / "flights.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for k, log in enumerate(logs):
            if k % 3 == 0:
                archive.write(log, log.name)
                continue
            pack, suffix = (gzip.compress, ".gz") if k % 3 == 1 else (zstandard.compress, ".zst")
            names.append(str(folder / (log.name + suffix)))
            Path(names[-1]).write_bytes(pack(log.read_bytes()))
    bad = not_unpacked()
    for name, blob in bad.items():
        (folder / name).write_bytes(blob)
    return [*names, str(folder / "flights.zip"), *(str(folder / name) for name in bad)]


def not_unpacked() -> dict[str, bytes]:
    """Empty, cut, damaged, packed too often, encrypted, not a log, not an archive."""
    log = sample("tlog")
    one = _zipped("one.tlog", log)
    encrypted = bytearray(one)
    encrypted[6] |= 1
    encrypted[one.index(b"PK\x01\x02") + 8] |= 1
    return {
        "empty.tlog.gz": gzip.compress(b""),
        "cut.tlog.gz": gzip.compress(log)[:12],
        "damaged.tlog.zst": zstandard.compress(log)[:9] + bytes(500),
        "twice.tlog.gz": gzip.compress(gzip.compress(log)),
        "inside.tlog.zst": zstandard.compress(one),
        "outer.zip": _zipped("inner.zip", one),
        "encrypted.zip": bytes(encrypted),
        "notes.txt.gz": gzip.compress(b"windy\n" * 99),
        "empty.zip": b"PK\x05\x06" + bytes(18),
        "page.zip": b"<!doctype html><title>Sign in</title>" * 9,
    }


def _zipped(name: str, blob: bytes) -> bytes:
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, blob)
    return whole.getvalue()


def run(budget: Budget) -> Iterator[Outcome]:  # noqa: ARG001 - two trials
    """One outcome for logs as they are, one for packed ones."""
    yield batch(Outcome("200 logs, 10 unreadable"), fill)
    yield batch(Outcome("200 packed logs, 10 unreadable"), fill_packed)


def batch(outcome: Outcome, filling: Callable[[Path], list[str]]) -> Outcome:
    """One `flysid ingest` of everything."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        names = filling(folder)
        command = [sys.executable, "-m", "flysid", "ingest", *names, "-o", str(folder / "data")]
        with outcome.trial():
            done = subprocess.run(
                command, cwd=ROOT, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
            )
        ids = done.stdout.split()
        skipped = [line for line in done.stderr.splitlines() if line.startswith("skipped:")]
        outcome.keep(len(ids), LOGS - BAD)
        outcome.remark = f"{len(ids)} ingested, {len(skipped)} named, exit {done.returncode}"
        if (len(ids), len(skipped), done.returncode) != (LOGS - BAD, BAD, 3):
            outcome.failures.append(outcome.remark + ": " + done.stderr[-300:])
        if "Traceback" in done.stderr:
            outcome.failures.append("a traceback")
    return outcome


CAMPAIGN = Campaign(12, "a batch of 200", run)
