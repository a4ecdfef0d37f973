"""`make soak`: runs long campaigns and writes their outcomes into `docs/reliability.md`.

    python -m soak [NAME...] [--minutes M] [--subject S] [--seed N] [--list] [--dry]

NAME is a row number or a part of a campaign's name; all campaigns run without one. `--minutes` bounds each
campaign; without it each runs at its full size. `--seed` repeats the draws of a campaign that prints its
seed. Ends with 1 where a promise was broken.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from soak import Budget, Campaign, Outcome
from soak.table import Line, line, merge

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reliability.md"
SHOWN = 5


def campaigns() -> dict[str, Campaign]:
    """Module name -> campaign, for every `row_*.py` of this folder, by row."""
    names = sorted(path.stem for path in Path(__file__).parent.glob("row_*.py"))
    found = {name: importlib.import_module(f"soak.{name}").CAMPAIGN for name in names}
    return dict(sorted(found.items(), key=lambda item: (item[1].row, item[0])))


def chosen(words: list[str]) -> dict[str, Campaign]:
    """Campaigns that the words name. Raises SystemExit where a word names none."""
    every = campaigns()
    if not words:
        return every
    found = {}
    for word in words:
        same = {
            module: campaign
            for module, campaign in every.items()
            if (str(campaign.row) == word if word.isdigit() else word.lower() in campaign.name.lower())
        }
        if not same:
            raise SystemExit(f"no campaign {word!r}; there are: " + ", ".join(c.name for c in every.values()))
        found.update(same)
    return found


def run_apart(module: str, budget: Budget) -> Iterator[Outcome]:
    """The outcomes of one campaign as they come, run in a process of its own; a crash is an outcome too."""
    command = [sys.executable, "-m", "soak", "--inside", module]
    command += [] if budget.seconds is None else ["--minutes", str(budget.seconds / 60)]
    command += [word for subject in budget.subjects for word in ("--subject", subject)]
    command += [] if budget.seed is None else ["--seed", str(budget.seed)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for text in process.stdout:
            if text.startswith("{"):
                yield Outcome(**json.loads(text))
    if process.returncode:
        yield Outcome("(the campaign itself)", failures=[f"ended with {process.returncode}"])


def run_inside(module: str, budget: Budget) -> None:
    """Run one campaign here, and print an outcome a line."""
    campaign: Campaign = importlib.import_module(f"soak.{module}").CAMPAIGN
    for outcome in campaign.run(budget):
        sys.stdout.write(json.dumps(asdict(outcome)) + "\n")
        sys.stdout.flush()


def report(campaign: Campaign, outcome: Outcome, cells: Line) -> None:
    """One line for a person, and the first failures."""
    sys.stdout.write(f"row {campaign.row:2} {campaign.name}, {outcome.subject}: {' | '.join(cells[3:10])}\n")
    for failure in outcome.failures[:SHOWN]:
        sys.stdout.write(f"    {failure}\n")
    sys.stdout.flush()


def main() -> int:
    """Run what the command line names."""
    parser = argparse.ArgumentParser(prog="python -m soak", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", help="row numbers or parts of names; all without")
    parser.add_argument("--minutes", type=float, help="wall time for each campaign")
    parser.add_argument("--subject", action="append", default=[], help="rows 1 to 5 and 7: this format only")
    parser.add_argument("--seed", type=int, help="row 27: draw with this seed, not with a fresh one")
    parser.add_argument("--list", action="store_true", help="name the campaigns and stop")
    parser.add_argument("--dry", action="store_true", help="leave docs/reliability.md as it is")
    parser.add_argument("--inside", help=argparse.SUPPRESS)
    options = parser.parse_args()
    seconds = None if options.minutes is None else options.minutes * 60
    budget = Budget(seconds, tuple(options.subject), options.seed)
    if options.inside:
        run_inside(options.inside, budget)
        return 0
    failed = False
    for module, campaign in chosen(options.names).items():
        if options.list:
            sys.stdout.write(f"{campaign.row:2} {campaign.name}\n")
            continue
        date = datetime.datetime.now(datetime.UTC).date().isoformat()
        fresh = []
        for outcome in run_apart(module, budget):
            fresh.append(line(campaign, outcome, date))
            report(campaign, outcome, fresh[-1])
            failed |= bool(outcome.failures)
        if not options.dry:
            PAGE.write_text(merge(PAGE.read_text("utf-8"), fresh, bool(options.subject)), "utf-8")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
