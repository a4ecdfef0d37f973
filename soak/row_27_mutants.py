"""Row 27: 150 random changes of our own code, each against the tests that reach it, then against the doors.

`soak.mutating` says which changes there are and which are left out, `soak.reach` which tests reach one. Every
change is made in a private copy of the repository. A failure counts only if the test holds in the unchanged
copy right afterwards. Passes when at least 80 % are noticed of those that change anything:
`soak/equal_changes.toml` names the others, found by reading, each with its reason.

`.bench/mutants/<stamp of code and tests>` keeps the tests that reach each line, taken over from the latest
stamp where neither line nor test has changed, and what became of each change, a line each. A campaign that
was ended goes on where it stopped, with its seed; `--seed` repeats another one, or begins it.
"""

from __future__ import annotations

import json
import secrets
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from pathlib import Path

from scipy.stats import binomtest

from soak import Budget, Campaign, Outcome
from soak.mutating import Mutant, draw, find_sites
from soak.private_tree import copy_tree, forget_compiled, stamp
from soak.reach import DOORS, FOLDERS, Mentions, Reach
from soak.ready import load
from soak.recorder import REACH_FILE, STARTED
from soak.running import Loaded, Ran, environment_of, run_tests

ROOT = Path(__file__).resolve().parents[1]
COUNT = 150
LEAST_NOTICED = 0.8
NEAR = ("tests/model", "tests/validate")
FAR = (*NEAR, "tests/flysid", DOORS)


@dataclass(frozen=True)
class Turn:
    """What is spent on a change.

    Attributes
    ----------
    tests_s : CPU of the tests that reach it, as measured under coverage, with what they share.
    doors_s : CPU of the doors that reach it, or one of these.
    folders : of tests; their map is measured when the first change has this turn.
    """

    tests_s: float
    doors_s: float = 0.0
    folders: tuple[str, ...] = NEAR


TURNS = (Turn(3.0), Turn(12.0), Turn(25.0, 25.0, FAR))
"""Every change has a turn before one that nobody noticed has the next."""
NOT_NOTICED = "not noticed"
Run = tuple[list[str], float]
"""Node ids, and the CPU seconds that they should take."""
Runner = Callable[[Sequence[str], float], Ran]


@dataclass(frozen=True)
class Trial:
    """What became of one change.

    Attributes
    ----------
    key, change, kind : of the mutant.
    noticed_by : the test; NOT_NOTICED if there is none.
    tests : how many were chosen, of `reaching` that reach the change.
    doubted : tests that failed in the unchanged copy as well, and so did not count.
    cpu_s : of all runs of this change.
    turns : how many of TURNS it had.
    """

    key: str
    change: str
    kind: str
    noticed_by: str
    tests: int
    reaching: int
    doubted: list[str] = field(default_factory=list)
    cpu_s: float = 0.0
    turns: int = 1

    @property
    def is_noticed(self) -> bool:
        return self.noticed_by != NOT_NOTICED

    @property
    def is_over(self) -> bool:
        return self.is_noticed or self.turns == len(TURNS)

    def __add__(self, later: Trial) -> Trial:
        """All turns as one."""
        return replace(
            later,
            tests=self.tests + later.tests,
            doubted=[*self.doubted, *later.doubted],
            cpu_s=round(self.cpu_s + later.cpu_s, 1),
        )


class Equals:
    """Changes that change nothing that anybody could see, as `soak/equal_changes.toml` lists them.

    A change is known by its file, the text of its line, and what becomes of it: lines may move.

    Attributes
    ----------
    reasons : by file, line and change.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        text = (root / "soak" / "equal_changes.toml").read_text("utf-8")
        self.reasons: dict[tuple[str, str, str], str] = {
            (c["file"], c["line"], c["change"]): c["why"] for c in tomllib.loads(text).get("change", [])
        }

    def why(self, mutant: Mutant) -> str:
        """The reason; "" for a change that is not listed."""
        path = mutant.place.path
        line = (self._root / path).read_text("utf-8").splitlines()[mutant.line - 1].strip()
        return self.reasons.get((path, line, mutant.change), "")


class Record:
    """The trials of one seed, in a file with a line each, safe against a kill at any time."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.trials: dict[str, Trial] = {}
        for line in file.read_text("utf-8").splitlines() if file.exists() else []:
            try:
                trial = Trial(**json.loads(line))
            except json.JSONDecodeError:  # cut off by a kill
                continue
            self.trials[trial.key] = trial

    @property
    def seed(self) -> int:
        return int(self._file.stem)

    def add(self, trial: Trial) -> None:
        """Keep a trial."""
        self.trials[trial.key] = trial
        end = "\n" if self._is_cut() else ""
        with self._file.open("a", encoding="utf-8") as file:
            file.write(f"{end}{json.dumps(asdict(trial))}\n")

    def waiting(self, mutants: Sequence[Mutant]) -> list[Mutant]:
        """Those that are not over; those that had the fewest turns come first."""
        turns = {m: self.trials[m.key].turns if m.key in self.trials else 0 for m in mutants}
        left = [m for m in mutants if not turns[m] or not self.trials[m.key].is_over]
        return sorted(left, key=turns.__getitem__)

    def _is_cut(self) -> bool:
        text = self._file.read_bytes() if self._file.exists() else b""
        return text != b"" and not text.endswith(b"\n")


def open_record(folder: Path, seed: int | None, drawn: Callable[[int], Sequence[Mutant]]) -> Record:
    """The record of a seed; without one, the last that is not complete, or a new one of a fresh seed.

    Parameters
    ----------
    folder : of the records; it exists.
    seed : None for any.
    drawn : the mutants of a seed.
    """
    if seed is not None:
        return Record(folder / f"{seed}.jsonl")
    for file in sorted(folder.glob("*.jsonl"), key=lambda file: file.stat().st_mtime, reverse=True):
        record = Record(file)
        if record.waiting(drawn(record.seed)):
            return record
    return Record(folder / f"{secrets.randbits(32)}.jsonl")


@dataclass
class Bench:
    """The unchanged copy, and what is known of it.

    Attributes
    ----------
    whole : the copy.
    loaded : a process that has imported it.
    reach : which tests of a turn's folders reach a line.
    mentions : which lines read a name.
    """

    whole: Path
    loaded: Loaded
    reach: Callable[[Turn], Reach]
    mentions: Mentions

    def attempt(self, mutant: Mutant, before: Trial | None) -> Trial:
        """Change a fresh copy, and look for a test that notices: the turn after those it had."""
        turn = before.turns if before else 0
        reaching = self._reaching(mutant, TURNS[turn])
        runs = list(self.chosen(mutant, turn))
        noticed_by, doubted, cpu_s = self._judge(mutant, runs, turn) if runs else (NOT_NOTICED, [], 0.0)
        count = sum(len(names) for names, _ in runs)
        trial = Trial(
            mutant.key,
            str(mutant),
            mutant.kind,
            noticed_by,
            count,
            len(reaching),
            doubted,
            round(cpu_s, 1),
            turn + 1,
        )
        return before + trial if before else trial

    def _judge(self, mutant: Mutant, runs: Sequence[Run], turn: int) -> tuple[str, list[str], float]:
        """What notices, which tests were in doubt, and the CPU seconds.

        Processes that tests start see a change in the last turn, which has a tree of its own.
        """
        if turn + 1 < len(TURNS) and self.loaded.can(mutant):
            return self._look(partial(self.loaded.run, mutant), partial(self.loaded.run, None), runs)
        tree = copy_tree(self.whole, self.whole.parent / "changed")
        try:
            file = tree / mutant.place.path
            file.write_bytes(mutant.apply(file.read_bytes()))
            forget_compiled(tree, mutant.place.path, mutant.line)
            return self._look(partial(run_tests, tree), partial(run_tests, self.whole), runs)
        finally:
            shutil.rmtree(tree)

    def _look(self, run: Runner, run_unchanged: Runner, runs: Sequence[Run]) -> tuple[str, list[str], float]:
        """The test that fails with the change, not without it; the others that fail; the CPU seconds."""
        doubted: list[str] = []
        cpu_s = 0.0
        waiting = list(runs)
        while waiting:
            names, expected_s = waiting.pop(0)
            ran = run(names, expected_s)
            cpu_s += ran.cpu_s
            if ran.passed:
                continue
            blamed = ran.failed or names
            again = run_unchanged(blamed, expected_s)
            cpu_s += again.cpu_s
            if again.passed:
                noticed_by = blamed[0] if ran.failed else f"time or crash in {names[0]} or later"
                return noticed_by, doubted, cpu_s
            doubted += blamed
            left = [name for name in names if name not in blamed]
            waiting[:0] = [(left, expected_s)] if left else []
        return NOT_NOTICED, doubted, cpu_s

    def chosen(self, mutant: Mutant, turn: int) -> Iterator[Run]:
        """Tests of a turn, without those of earlier ones, each run with the CPU seconds that it may take.

        Doors come after the others.
        """
        spent = TURNS[turn]
        reach = self.reach(spent)
        before = {name for earlier in TURNS[:turn] for name in self._bought(mutant, earlier)}
        chosen = [name for name in self._bought(mutant, spent) if name not in before]
        if chosen:
            yield reach.side_by_side(chosen), spent.tests_s
        doors = [name for name in self._reaching(mutant, spent) if name.startswith(DOORS)]
        if doors:
            yield reach.affordable(doors, spent.doors_s, set()), spent.doors_s

    def _reaching(self, mutant: Mutant, turn: Turn) -> list[str]:
        return self.reach(turn).tests_of(mutant.place, self.mentions)

    def _bought(self, mutant: Mutant, turn: Turn) -> list[str]:
        """The tests of a turn in the order of their worth, without doors."""
        tests = [name for name in self._reaching(mutant, turn) if not name.startswith(DOORS)]
        return self.reach(turn).affordable(tests, turn.tests_s, set())


def measure(whole: Path, folder: Path, folders: Sequence[str] = FAR) -> Reach:
    """Which tests of `folders` reach each line: measured for this code, or taken over from an earlier one."""
    return Reach.read([_measured(whole, tests, folder) for tests in folders])


def _measured(whole: Path, tests: str, folder: Path) -> Path:
    """The map of a folder of tests; files of tests that are in no earlier map are measured now."""
    file = folder / f"{tests.replace('/', '-')}.json"
    if file.exists():
        return file
    earlier = max(folder.parent.glob(f"*/{file.name}"), key=lambda path: path.stat().st_mtime, default=None)
    known = Reach.read([earlier]).taken_over(whole) if earlier else Reach()
    there = [path.relative_to(whole).as_posix() for path in sorted((whole / tests).rglob("test_*.py"))]
    wanted = [name for name in there if name not in known.files]
    parts = [folder / f"{file.stem}.{kind}" for kind in ("known", "new")]
    known.write(parts[0])
    if wanted:
        _measure_files(whole, wanted, parts[1])
    Reach.read(part for part in parts if part.exists()).write(parts[0])
    parts[1].unlink(missing_ok=True)
    return parts[0].rename(file)


def _measure_files(whole: Path, names: Sequence[str], file: Path) -> None:
    """Run files of tests under coverage, and the processes that they start."""
    for name, text in STARTED.items():
        (whole / name).write_text(text, "utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "soak.recorder", "-p", "no:cacheprovider", *names]
    subprocess.run(
        command,
        cwd=whole,
        env=environment_of(whole) | {REACH_FILE: str(file)},
        stdout=subprocess.DEVNULL,
        check=False,  # a test that fails under coverage is left out
    )
    for name in STARTED:
        (whole / name).unlink()


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per folder of code."""
    folder = ROOT / ".bench" / "mutants" / stamp(ROOT)
    folder.mkdir(parents=True, exist_ok=True)
    goes_on = budget.clock()
    load()
    with tempfile.TemporaryDirectory() as place:
        whole = copy_tree(ROOT, Path(place) / "whole")
        subprocess.run(
            [sys.executable, "-m", "tests.kernels"], cwd=whole, env=environment_of(whole), check=True
        )
        with Loaded(whole) as loaded:
            reach = cache(lambda turn: measure(whole, folder, turn.folders))
            bench = Bench(whole, loaded, reach, Mentions.find(whole))
            sites = find_sites(whole)
            record = open_record(folder, budget.seed, lambda seed: draw(sites, seed, COUNT))
            mutants = [m for m in draw(sites, record.seed, COUNT) if _folder(m) in budget.chosen(FOLDERS)]
            waiting = record.waiting(mutants)
            say(f"seed {record.seed}: {len(waiting)} of {len(mutants)} changes to try, at {len(sites)} sites")
            while waiting and goes_on():
                mutant = waiting[0]
                began = time.monotonic()
                record.add(bench.attempt(mutant, record.trials.get(mutant.key)))
                say(f"{time.monotonic() - began:.0f} s, {describe(record.trials[mutant.key])}")
                waiting = record.waiting(mutants)
        yield from outcomes([m for m in mutants if m.key in record.trials], record, Equals(whole), budget)


def outcomes(mutants: Sequence[Mutant], record: Record, equals: Equals, budget: Budget) -> Iterator[Outcome]:
    """Counts by folder; a failure a change that was not noticed, where these are too many."""
    for name in budget.chosen(FOLDERS):
        own = [m for m in mutants if _folder(m) == name]
        noticed = [m for m in own if record.trials[m.key].is_noticed]
        reasons = {m: equals.why(m) for m in own if m not in noticed}
        missed = [m for m, why in reasons.items() if not why]
        outcome = Outcome(name, len(own))
        outcome.remark = (
            f"noticed {share_of(len(noticed), len(noticed) + len(missed))}; "
            f"{sum(DOORS in record.trials[m.key].noticed_by for m in noticed)} by the doors alone; "
            f"{len(reasons) - len(missed)} change nothing; not noticed: {counts_of(m.kind for m in missed)}; "
            f"tests that fail unchanged: {len({t for m in own for t in record.trials[m.key].doubted})}; "
            f"seed {record.seed}"
        )
        if len(noticed) < LEAST_NOTICED * (len(noticed) + len(missed)):
            outcome.failures += [str(m) for m in missed]
        for m, why in reasons.items():
            say(describe(record.trials[m.key]) + (f": {why}" if why else ""))
        yield outcome


def share_of(count: int, of: int) -> str:
    """A share with its exact 95 % interval (Clopper and Pearson, 1934, Biometrika 26)."""
    if not of:
        return "0 of 0"
    ends = binomtest(count, of).proportion_ci()
    low, high = (f"{100 * end:.0f}" for end in (ends.low, ends.high))
    return f"{count} of {of} ({100 * count / of:.0f} %, {low} to {high})"


def counts_of(words: Iterable[str]) -> str:
    """`2 number, 1 sign`."""
    return ", ".join(f"{n} {word}" for word, n in Counter(words).most_common()) or "none"


def describe(trial: Trial) -> str:
    """One line for a person."""
    return (
        f"{trial.kind} {trial.change}: {trial.noticed_by} "
        f"({trial.tests} tests of {trial.reaching}, {trial.cpu_s:.0f} s of CPU)"
    )


def say(text: str) -> None:
    """A line beside the outcomes."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


def _folder(mutant: Mutant) -> str:
    return mutant.place.path.partition("/")[0]


CAMPAIGN = Campaign(27, "changes of our own code", run)
