"""Row 25: the studio under damaged uploads with hostile names and random queries; a run is the command's.

No answer says 500, no file appears outside the studio's folders, memory does not grow, the server goes on.
"""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from flysid.ingest.lake.workers import anonymous_bytes
from soak import Budget, Campaign, Outcome
from soak.row_13_names import hostile
from tests.flysid.studio.server import FIT, SAMPLES, Server, studio

UPLOADS = 1000
QUERIES = 5000
WAITING = 100
STUCK_S = 120.0  # no job ends for so long
MOST_GROWN_MB = 50.0
PATHS = (
    "series", "align", "flights", "runs", "jobs", "recipes", "uploads/x", "flights/x", "flights/x/track",
    "runs/x", "runs/x/report.html", "runs/x/explanation", "runs/x/models/a/b", "jobs/x", "jobs/x/events",
    "recipes/x", "comparisons/x/report.html", "about",
)  # fmt: skip
WORDS = ("f", "s", "t0", "t1", "w", "q", "most", "r", "ch", "segment", "row", "\u00e9", "", "f[]")


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome each for uploads, queries, and a run beside the command's own."""
    trials = {"uploads": damaged_uploads, "queries": random_queries, "the command's run": same_run}
    names = budget.chosen(list(trials))
    for name, share in zip(names, budget.shares(len(names)), strict=True):
        with tempfile.TemporaryDirectory() as place:
            yield trials[name](Path(place), share)


def damaged_uploads(place: Path, budget: Budget) -> Outcome:
    """Sample logs cut, flipped and filled with noise, dropped under names that lead elsewhere."""
    outcome = Outcome("uploads")
    goes_on = budget.clock()
    rng = random.Random(25)
    logs = [path.read_bytes() for path in sorted(SAMPLES.glob("*.tlog")) + sorted(SAMPLES.glob("*.mcap"))]
    names = hostile(UPLOADS)
    with studio(place / "data") as server:
        before = settled_mb(server)
        for name in names:
            if not goes_on():
                break
            body = bytearray(rng.choice(logs)[: rng.randint(1, 40_000)])
            for _ in range(rng.randint(0, 40)):
                body[rng.randrange(len(body))] = rng.randrange(256)
            began = time.monotonic()
            answer = server.send("POST", "uploads?name=" + quote(name), bytes(body))
            outcome.trials += 1
            outcome.slowest_s = max(outcome.slowest_s or 0.0, time.monotonic() - began)
            if answer.status not in (202, 400):
                outcome.failures.append(f"{name!r}: {answer.status} {answer.body[:80]!r}")
            outcome.raised += answer.status == 400
            if outcome.trials % WAITING == 0:
                settle(server)
        settle(server)
        judge_server(server, outcome, before)
        check_places(place, outcome)
    return outcome


def random_queries(place: Path, budget: Budget) -> Outcome:
    """Every route with words and values that make no sense."""
    outcome = Outcome("queries")
    goes_on = budget.clock()
    rng = random.Random(26)
    with studio(place / "data") as server:
        before = settled_mb(server)
        flight = server.get("flights").json["flights"][0]["id"]
        values = [flight, *hostile(60), "nan", "-1", "1e400", "9" * 400, "made:a", "null", "[]", "0", "1200"]
        for _ in range(QUERIES):
            if not goes_on():
                break
            query = [(rng.choice(WORDS), rng.choice(values)) for _ in range(rng.randint(0, 6))]
            path = rng.choice(PATHS).replace("x", quote(rng.choice(values), safe=""))
            answer = server.get(path, query)
            outcome.trials += 1
            outcome.raised += answer.status in (400, 404)
            if answer.status not in (200, 307, 400, 404, 405):
                outcome.failures.append(f"{path} {query}: {answer.status} {answer.body[:80]!r}")
        judge_server(server, outcome, before)
        check_places(place, outcome)
    return outcome


def same_run(place: Path, _: Budget) -> Outcome:
    """A fit of the page and the same words typed: the same bytes of every model."""
    outcome = Outcome("the command's run", trials=1)
    with studio(place / "data") as server:
        sent = server.send("POST", "uploads?name=a.tlog", (SAMPLES / "01-multisine-seed1.tlog").read_bytes())
        server.wait(sent.json["job"]["id"])
        job = server.wait(server.send("POST", "fits", FIT).json["id"], 600)
        typed = place / "typed"
        subprocess.run([sys.executable, "-m", "flysid", *job["words"][:-1], str(typed)], check=True)
        made = Path(job["words"][-1])
        for path in sorted(typed.rglob("*.json")):
            if path.name != "run.json":  # it says how long each model took
                theirs = made / path.relative_to(typed)
                if not theirs.is_file() or theirs.read_bytes() != path.read_bytes():
                    outcome.failures.append(f"{path.name} differs")
    return outcome


def waiting(server: Server) -> int:
    """Jobs that have not ended."""
    return sum(job["state"] in ("queued", "running") for job in server.get("jobs").json["jobs"])


def settle(server: Server) -> None:
    """Wait until no job is left: one that goes on would write into a folder that is being removed."""
    left = waiting(server)
    until = time.monotonic() + STUCK_S
    while left and time.monotonic() < until:
        time.sleep(0.5)
        now = waiting(server)
        if now < left:
            until = time.monotonic() + STUCK_S
        left = now


def settled_mb(server: Server) -> float:
    """Its memory when all is imported that an upload needs: the address answers before that."""
    server.get("runs/none/worst")  # waits for the last room
    body = (SAMPLES / "01-steps-seed2.tlog").read_bytes()
    sent = server.send("POST", "uploads?name=a.tlog", body).json
    server.wait(sent["job"]["id"])
    server.get("flights")
    return anonymous_mb(server)


def anonymous_mb(server: Server) -> float:
    """Memory of the server that no file backs."""
    return anonymous_bytes(server.process.pid) / 1e6


def judge_server(server: Server, outcome: Outcome, before_mb: float) -> None:
    """It answers still, and has not grown."""
    if server.get("flights").status != 200:
        outcome.failures.append("the server does not answer any more")
    outcome.peak_mb = anonymous_mb(server) - before_mb
    if outcome.peak_mb > MOST_GROWN_MB:
        outcome.failures.append(f"the server has grown by {outcome.peak_mb:.0f} MB")


def check_places(place: Path, outcome: Outcome) -> None:
    """Nothing stands beside the data and the studio's folder."""
    beside = {path.name for path in place.iterdir()} - {"data", "data.studio"}
    if beside:
        outcome.failures.append(f"files outside the studio's folders: {sorted(beside)[:5]}")


CAMPAIGN = Campaign(row=25, name="the studio under attack", run=run)
