"""Row 13: 500 hostile names of topics, fields and files: none leaves the folder or reaches the terminal."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.samplelogs.mcap import Topic, json_topic, mcap_file, ros1_topic
from tests.soak import Budget, Campaign, Outcome

ROOT = Path(__file__).resolve().parents[2]
NAMES = 500
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


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome for names inside logs, one for names of logs."""
    goes_on, names = budget.clock(), hostile(NAMES)
    inside, files = Outcome("topics and fields"), Outcome("files")
    for k in range(0, NAMES, 50):
        if goes_on():
            _ingest(inside, f"log{k}.mcap", log(names[k : k + 50]))
    for name in names[: NAMES // 25]:
        safe = name.replace("/", "\u2215").replace("\0", "")[:60] or "x"
        if goes_on() and safe not in (".", ".."):
            _ingest(files, safe + ".mcap", log(["/a"]))
    yield inside
    yield files


def _ingest(outcome: Outcome, file_name: str, blob: bytes) -> None:
    """Ingest, list and survey one log; look at what was written and said."""
    with tempfile.TemporaryDirectory() as place:
        logs, data = Path(place, "logs"), Path(place, "data")
        logs.mkdir()
        (logs / file_name).write_bytes(blob)
        texts = []
        with outcome.trial():
            for words in (["ingest", str(logs), "-o", str(data)], ["ls", str(data)], ["doctor", str(logs)]):
                done = subprocess.run(
                    [sys.executable, "-m", "flysid", *words],
                    cwd=ROOT,
                    capture_output=True,
                    check=False,
                    timeout=300,
                )
                texts.append(done.stdout + done.stderr)
                if done.returncode not in (0, 3) or b"Traceback" in done.stderr:
                    outcome.failures.append(
                        f"{file_name!a} {words[0]}: {done.returncode} {done.stderr[-200:]!a}"
                    )
        stray = [p for p in Path(place).iterdir() if p.name not in ("logs", "data")]
        if stray or len(list(logs.iterdir())) != 1:
            outcome.failures.append(f"{file_name!a}: written outside: {stray}")
        if any(code in text for text in texts for code in (b"\x1b[31m", b"\x1b]0;", b"\0", b"\x07")):
            outcome.failures.append(f"{file_name!a}: control characters reach the terminal")


CAMPAIGN = Campaign(13, "hostile names", run)
