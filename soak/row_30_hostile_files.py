"""Row 30: 500 hostile files, one at a time, among 100 sound logs: the 100 are ingested every time.

By folder, by path, from a bucket (SeaweedFS) and in the studio. The sound logs are one of each format, and
tables. They are ingested once. Before each trial a few that are drawn leave the data, with whatever else
came in (in a bucket: a few get another content), so that a trial reads those anew beside the hostile file
and finds the rest unchanged. What was tried is noted in `build/soak`, by the commit that it was tried on:
the same command goes on from there.
"""

from __future__ import annotations

import json
import random
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

import flysid
from flysid.place import Place
from soak import Budget, Campaign, Outcome
from tests.command import call
from tests.flysid.studio.server import studio
from tests.hostile_files import contents, kinds, lay, suffix_of
from tests.ingest.lake.sound_logs import sound_mixture, sound_table
from tests.s3server import seaweedfs

ROOT = Path(__file__).resolve().parents[1]
SOUND = 100
FILES = 500
ANEW = 5
"""Sound logs that a trial reads anew."""
SOUND_LOGS = sound_mixture(SOUND)
Trial = Callable[[str, int], set[str]]
"""A kind and a seed; the names of the logs that became flights."""


def ledger() -> Path:
    """Where the trials of this commit are noted."""
    commit = ["git", "rev-parse", "--short", "HEAD"]
    found = subprocess.run(commit, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    path = ROOT / "build" / "soak" / f"row_30_{found or 'unknown'}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per way that logs are taken in."""
    path = ledger()
    done = {}
    if path.exists():
        noted = [json.loads(line) for line in path.read_text().splitlines()]
        done = {(note["way"], note["trial"]): note for note in noted}
    names = budget.chosen(list(WAYS))
    for name, share in zip(names, budget.shares(len(names)), strict=True):
        outcome = Outcome(name)
        goes_on = share.clock()
        with (
            TemporaryDirectory() as folder,
            WAYS[name](Path(folder)) as trial,
            path.open("a") as notes,
        ):
            if trial is None:
                outcome.remark = "the server is not installed"
            for number in range(FILES if trial is not None else 0):
                if (name, number) not in done and goes_on():
                    assert trial is not None
                    note = {"way": name, "trial": number} | tried(trial, number, outcome)
                    notes.write(json.dumps(note) + "\n")
                    notes.flush()
                    done[name, number] = note
        mine = [note for (way, _), note in done.items() if way == name]
        outcome.trials = len(mine)
        outcome.keep(sum(note["kept"] for note in mine), SOUND * len(mine))
        outcome.failures = [note["failure"] for note in mine if note["failure"]]
        yield outcome
    if len(done) == FILES * len(WAYS):
        path.unlink()


def tried(trial: Trial, number: int, outcome: Outcome) -> dict[str, object]:
    """How many sound logs were taken in beside one hostile file, and what went wrong."""
    every = kinds()
    kind = every[number % len(every)]
    kept = 0
    failure = ""
    with outcome.trial():
        try:
            kept = len(trial(kind, number) & SOUND_LOGS.keys())
        except Exception as error:  # noqa: BLE001 - this is what the trials look for
            failure = f"{kind}, seed {number}: {type(error).__name__}: {error}"
    if kept < SOUND and not failure:
        failure = f"{kind}, seed {number}: {kept} of {SOUND} logs"
    return {"kept": kept, "failure": failure}


def _ingest(given: list[Path] | list[str], data: Path | str, folder: Path) -> set[str]:
    """Names of the logs that the data holds afterwards."""
    done = call("ingest", *given, "-o", data, cwd=folder)
    if done.returncode not in (0, 3) or "Traceback" in done.stderr:
        raise RuntimeError(f"exit {done.returncode}: {done.stderr[-300:]}")
    return {facts.log for facts in flysid.open(data).facts}


def _outdated(data: Path | str, draw: random.Random) -> list[str]:
    """Flights to take out of the data: a few sound ones, and those that earlier trials brought in."""
    facts = flysid.open(data).facts
    sound = sorted(fact.id for fact in facts if fact.log in SOUND_LOGS)
    return [*draw.sample(sound, ANEW), *(fact.id for fact in facts if fact.log not in SOUND_LOGS)]


def _write(folder: Path) -> list[Path]:
    folder.mkdir()
    for name, content in SOUND_LOGS.items():
        (folder / name).write_bytes(content)
    return [folder / name for name in SOUND_LOGS]


def _locally(folder: Path, given: Callable[[list[Path], Path], list[Path]]) -> Trial:
    """A trial that lays a hostile file beside the sound logs, and takes in what is `given`."""
    logs, data = folder / "logs", folder / "data"
    sound = _write(logs)
    _ingest(list(sound), data, folder)

    def trial(kind: str, seed: int) -> set[str]:
        draw = random.Random(seed)
        for flight in _outdated(data, draw):
            shutil.rmtree(data / "flights" / flight)
        hostile = lay(kind, logs, draw)
        try:
            return _ingest(given(sound, hostile), data, folder)
        finally:
            shutil.rmtree(hostile) if hostile.is_dir() and not hostile.is_symlink() else hostile.unlink()

    return trial


@contextmanager
def by_folder(folder: Path) -> Iterator[Trial]:
    """`flysid ingest FOLDER`."""
    yield _locally(folder, lambda _, hostile: [hostile.parent])


@contextmanager
def by_path(folder: Path) -> Iterator[Trial]:
    """`flysid ingest LOG LOG ...`."""
    yield _locally(folder, lambda sound, hostile: [*sound, hostile])


@contextmanager
def from_a_bucket(folder: Path) -> Iterator[Trial | None]:
    """`flysid ingest s3://BUCKET/IN`; None where there is no server."""
    server = seaweedfs(folder / "weed")
    if server is None:
        yield None
        return
    server.start()
    try:
        with pytest.MonkeyPatch.context() as patch:
            for name, value in (server.environment | {"XDG_CACHE_HOME": str(folder / "cache")}).items():
                patch.setenv(name, value)
            place = Place("s3://tests/trials")
            given, lake = [place.at("in")], place.at("lake")
            for name, content in SOUND_LOGS.items():
                place.put(f"in/{name}", content)
            _ingest(given, lake, folder)

            now = {name: sha256(content).hexdigest() for name, content in SOUND_LOGS.items()}
            tables = [name for name in SOUND_LOGS if name.endswith(".csv")]

            def trial(kind: str, seed: int) -> set[str]:
                draw = random.Random(seed)
                for name in draw.sample(tables, ANEW):
                    content = sound_table(SOUND + draw.getrandbits(30))
                    place.put(f"in/{name}", content)
                    now[name] = sha256(content).hexdigest()
                hostile = f"in/hostile{suffix_of(kind)}"
                if kind in contents():
                    place.put(hostile, contents()[kind](draw))
                try:
                    _ingest(given, lake, folder)
                finally:
                    place.delete([hostile] if kind in contents() else [])
                there = {(facts.log, facts.sha256) for facts in flysid.open(lake).facts}
                return {name for name, content in now.items() if (name, content) in there}

            yield trial
    finally:
        server.kill()


@contextmanager
def in_the_studio(folder: Path) -> Iterator[Trial]:
    """A hostile log is dropped on the page; the listing answers with all flights."""
    data = folder / "data"
    _ingest(list(_write(folder / "logs")), data, folder)
    with studio(data) as running:

        def trial(kind: str, seed: int) -> set[str]:
            if kind in contents():
                blob = contents()[kind](random.Random(seed)) or b"\0"
                sent = running.send("POST", f"uploads?name=hostile{suffix_of(kind)}", blob)
                look = running.get(f"uploads/{sent.json['upload']}")
                running.wait(sent.json["job"]["id"])
                if (sent.status, look.status) != (202, 200):
                    raise RuntimeError(f"{sent.status}, {look.status}")
            listed = running.get("flights", {"most": 100_000})
            if listed.status != 200:
                raise RuntimeError(f"the listing answers {listed.status}")
            return {flight["log"] for flight in listed.json["flights"]}

        yield trial


WAYS: Mapping[str, Callable[[Path], AbstractContextManager[Trial | None]]] = {
    "by folder": by_folder,
    "by path": by_path,
    "from a bucket": from_a_bucket,
    "in the studio": in_the_studio,
}
CAMPAIGN = Campaign(30, "hostile files among sound logs", run)
