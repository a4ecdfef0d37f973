"""Row 13: 500 hostile names of topics, fields and files: none leaves the folder or reaches the terminal."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from flysid.store import list_flights
from soak import Budget, Campaign, Outcome
from tests.samplelogs.mcap import Topic, json_topic, mcap_file, ros1_topic

ROOT = Path(__file__).resolve().parents[1]
NAMES = 500
TOGETHER = 50
PARTS = [
    *(
        "../",
        "..\\",
        "/",
        "etc",
        "passwd",
        "\0",
        "\n",
        "\r",
        "\x1b[31m",
        "\x1b]0;x\x07",
        "a",
        "A",
        "é",
        "e\u0301",
    ),
    *("con", "nul", ".", "..", " ", "x" * 300, "%s", "{}", "'", '"', "$(id)", "`", "\u202e", "~", "-rf", "*"),
]


def hostile(count: int) -> list[str]:
    """Names of one to five hostile parts."""
    rng = random.Random(13)
    return ["".join(rng.choices(PARTS, k=rng.randint(1, 5))) for _ in range(count)]


def log(names: list[str]) -> bytes:
    """An MCAP file with a topic per name, whose JSON field has that name too, and one of ROS 1."""
    topics: list[Topic] = [json_topic(name, {}, [{name: k, "x": k} for k in range(2)]) for name in names]
    return mcap_file([*topics, ros1_topic("/b", "p/T", "uint32 k\n", [struct.pack("<I", 7)])])


def file_names(names: list[str]) -> list[str]:
    """What of these names a file system takes, each once, besides case."""
    safe = [name.replace("/", "\u2215").replace("\0", "")[:60] + f"{k}.mcap" for k, name in enumerate(names)]
    return [name for name in safe if len(name.encode()) < 250]


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome for names inside logs, one for names of logs; 50 names a trial."""
    goes_on = budget.clock()
    names = hostile(NAMES)
    inside = Outcome("topics and fields")
    files = Outcome("files")
    for k in range(0, NAMES, TOGETHER):
        some = names[k : k + TOGETHER]
        if goes_on():
            _ingest(inside, {f"log{k}.mcap": log(some)})
            _ingest(files, {name: log([f"/{i}"]) for i, name in enumerate(file_names(some))})
    yield inside
    yield files


def _ingest(outcome: Outcome, logs: dict[str, bytes]) -> None:
    """Ingest, list and survey logs; look at what was written and said."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, "logs")
        data = Path(place, "data")
        folder.mkdir()
        for name, blob in logs.items():
            (folder / name).write_bytes(blob)
        paths = [str(folder / name) for name in logs]
        texts = []
        with outcome.trial():
            for words in (["ingest", *paths, "-o", str(data)], ["ls", str(data)], ["doctor", *paths[:1]]):
                done = _said(words)
                texts.append(done.stdout + done.stderr)
                if done.returncode not in (0, 3) or b"Traceback" in done.stderr:
                    outcome.failures.append(f"{words[0]}: {done.returncode} {done.stderr[-200:]!a}")
        outcome.keep(len(list_flights(data)), len(logs))
        if outcome.lost:
            outcome.failures.append(f"{outcome.lost} of {len(logs)} logs lost")
        stray = [p for p in Path(place).iterdir() if p.name not in ("logs", "data")]
        if stray or sorted(p.name for p in folder.iterdir()) != sorted(logs):
            outcome.failures.append(f"written outside: {stray}")
        if any(code in text for text in texts for code in (b"\x1b[31m", b"\x1b]0;", b"\0", b"\x07")):
            outcome.failures.append("control characters reach the terminal")


def _said(words: list[str]) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "flysid", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=False, timeout=300)


CAMPAIGN = Campaign(13, "hostile names", run)
