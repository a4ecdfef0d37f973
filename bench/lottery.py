"""The lottery test: how far the delivered model hangs on what means nothing.

`python -m bench.lottery JOURNAL [--plants N] [--first NUMBER] [--sets NAME...] [--settings] [--beside OTHER]`

Every record, `N` drawn plants (`bench.drawn_plants`) and public sets, is fitted as it is and with changes
that mean nothing: first samples dropped, 98 and 99 % of it, flights in another order, other units. With
`--settings` each number of the search is tried 20 % larger and smaller as well. Each fit is one line of the
journal, and is not done again when the command is repeated. Drawn plants are scored on flights without noise,
public sets on their test parts, in per cent of the spread, started as `flysid.compare` starts a run.

Printed are by how much the error moves (the larger over the smaller, less one), flips between linear and
rules with their cost, and the error of every record. `--beside` adds the ratio to those of another journal.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench import accuracy_data, drawn_plants
from bench.ts_experiment import off
from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.rules.search_settings import NORMAL, QUARTERS, SearchSettings
from flysid.model.ts import TS

Change = Callable[[Dataset], Dataset]
Row = Mapping[str, Any]
MOST_ROWS = 3_000
"""Of a public record that is learned from."""
AS_IT_IS = "as it is"
EXCHANGED = " exchanged"
"""How the name of a public set ends whose training and test parts change places."""
BEYOND = 0.15
"""A move that is counted."""
SETTINGS = "setting "
"""How the name of a change of the search begins."""


@dataclass(frozen=True, eq=False)
class Record:
    """What is learned from, and what the model is scored on."""

    train: Dataset
    validation: Dataset | None
    test: Dataset


def dropped(samples: int, data: Dataset) -> Dataset:
    """Without the first samples of every segment."""
    return data.with_segments([s.slice(samples, len(s), data.dt_s) for s in data.segments])


def shortened(share: float, data: Dataset) -> Dataset:
    """The first part of every segment."""
    return data.with_segments([s.slice(0, round(share * len(s)), data.dt_s) for s in data.segments])


def turned(data: Dataset) -> Dataset:
    """The segments in the opposite order."""
    return data.with_segments(data.segments[::-1])


def in_units(inputs: float, outputs: float, data: Dataset) -> Dataset:
    """The same record in other units."""
    return data.with_segments([replace(s, u=s.u * inputs, y=s.y * outputs) for s in data.segments])


DEGREES = 180.0 / np.pi
CHANGES: Mapping[str, Change] = {
    **{f"first {n} dropped": partial(dropped, n) for n in (7, 20, 40, 60)},
    **{f"{percent} %": partial(shortened, percent / 100.0) for percent in (98, 99)},
    "flights turned": turned,
    "units": partial(in_units, DEGREES, 1.0 / DEGREES),
}


def changed_settings() -> Iterator[tuple[str, SearchSettings]]:
    """Every number of the search 20 % more and less; a whole one at least by one."""
    for field in fields(NORMAL):
        known = getattr(NORMAL, field.name)
        if isinstance(known, bool):
            continue
        for sign in (-1, 1):
            if isinstance(known, int):
                found: Any = known + sign * max(1, round(0.2 * known))
            elif isinstance(known, tuple):
                found = tuple((1.0 + 0.2 * sign) * value for value in known)
            else:
                found = (1.0 + 0.2 * sign) * known
            if field.name == "folds" and found > QUARTERS:
                continue
            yield f"{SETTINGS}{field.name} {found}", replace(NORMAL, **{field.name: found})


def records(options: argparse.Namespace) -> Iterator[tuple[str, Callable[[], Record]]]:
    """Name and maker of every record that is asked for."""
    first = drawn_plants.FIRST if options.first is None else options.first
    for number in range(first, first + options.plants):
        yield f"{number} {drawn_plants.kind_of(number)}", partial(of_plant, number)
    for name in options.sets:
        yield name, partial(of_set, name)


def of_plant(number: int) -> Record:
    """A drawn plant."""
    plant = drawn_plants.drawn(number)
    return Record(plant.train, None, plant.test)


def of_set(name: str) -> Record:
    """A public set, or one whose halves change places; the first rows of a long one."""
    case = accuracy_data.CASES[name.removesuffix(EXCHANGED)]()
    tests = [segment for data in case.tests.values() for segment in data.segments]
    train, test = case.train, case.train.with_segments(tests)
    if name.endswith(EXCHANGED):
        train, test = test, train
    rows = [s.slice(0, min(len(s), MOST_ROWS), train.dt_s) for s in train.segments]
    return Record(train.with_segments(rows), case.validation, test)


SETS = (*accuracy_data.CASES, *(f"{n}{EXCHANGED}" for n in ("tanks", "robot-arm", "dryer", "gas-furnace")))


def fitted(record: Record, change: Change, search: SearchSettings = NORMAL) -> Row:
    """What one fit delivers: its error, rules, structure, and seconds of CPU."""
    begin = time.process_time()
    try:
        validation = None if record.validation is None else change(record.validation)
        model = TS(search=search).fit(change(record.train), validation)
    except FlysidError as error:
        return {"refused": error.message, "cpu": time.process_time() - begin}
    cpu = time.process_time() - begin
    test = change(record.test) if change is CHANGES["units"] else record.test
    return {"error": off(model, test), "rules": len(model.rules()), "is": model.structure, "cpu": cpu}


def played(journal: Path, options: argparse.Namespace) -> Iterator[Row]:
    """Every fit, from the journal where it is there."""
    known = {(row["record"], row["change"]): row for row in read(journal)}
    tries: list[tuple[str, Change, SearchSettings]] = [(AS_IT_IS, lambda data: data, NORMAL)]
    tries += [(name, change, NORMAL) for name, change in CHANGES.items()]
    if options.settings:
        tries += [(name, lambda data: data, search) for name, search in changed_settings()]
    for name, make in records(options):
        missing = [t for t in tries if (name, t[0]) not in known]
        record = make() if missing else None
        for title, change, search in tries:
            if (name, title) not in known:
                assert record is not None
                known[name, title] = {"record": name, "change": title, **fitted(record, change, search)}
                with journal.open("a") as file:
                    file.write(json.dumps(known[name, title]) + "\n")
            yield known[name, title]


def read(journal: Path) -> list[Row]:
    """The lines of a journal; none where there is none."""
    return [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []


def errors_of(rows: list[Row]) -> dict[str, list[float]]:
    """Errors by record, the one as it is first."""
    found: dict[str, list[float]] = {}
    for row in rows:
        if "error" in row and not row["change"].startswith(SETTINGS):
            found.setdefault(row["record"], []).append(row["error"])
    return found


def is_linear(row: Row) -> bool:
    """Whether what was delivered is linear."""
    return bool(row["rules"] == 1)


def moves(rows: list[Row]) -> tuple[FloatArray, list[float], int]:
    """Moves of the error, those of flips between linear and rules, and changes of the count of rules."""
    plain = {row["record"]: row for row in rows if row["change"] == AS_IT_IS and "error" in row}
    found, costs, counts = [], [], 0
    for row in rows:
        known = plain.get(row["record"])
        if known is None or row is known or "error" not in row:
            continue
        pair = sorted((row["error"], known["error"]))
        found.append(pair[1] / pair[0] - 1.0)
        counts += row["rules"] != known["rules"]
        if is_linear(row) != is_linear(known):
            costs.append(found[-1])
    return np.array(found), costs, counts


def in_words(title: str, rows: list[Row]) -> str:
    """One line: moves, flips, counts, refusals."""
    moved, costs, counts = moves(rows)
    if not len(moved):
        return f"{title}: nothing"
    middle, high = np.quantile(moved, (0.5, 0.9))
    refused = sum("refused" in row for row in rows)
    cost = f", at most {100 * max(costs):.0f} %" if costs else ""
    return (
        f"{title}: {len(moved)} fits; median {100 * middle:.1f} %, 90th percentile {100 * high:.0f} %, worst "
        f"{100 * moved.max():.0f} %, beyond {100 * BEYOND:.0f} % in {100 * (moved > BEYOND).mean():.0f} %; "
        f"flips {len(costs)}{cost}; other counts of rules {counts}; refused {refused}"
    )


def main() -> int:
    """Play, and print what came of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("journal", type=Path)
    parser.add_argument("--plants", type=int, default=40)
    parser.add_argument("--first", type=int)
    parser.add_argument("--sets", nargs="*", default=SETS, metavar="NAME")
    parser.add_argument("--settings", action="store_true")
    parser.add_argument("--beside", type=Path)
    options = parser.parse_args()
    rows = []
    for row in played(options.journal, options):
        rows.append(row)
        said = row.get("refused") or f"{row['error']:8.3f} {row['is']:5s} {row['rules']}"
        print(f"{row['record']:28s} {row['change']:24s} {said}  {row['cpu']:5.1f} s", flush=True)
    other = errors_of(read(options.beside)) if options.beside else {}
    ratios = []
    for name, errors in errors_of(rows).items():
        mean = float(np.mean(errors))
        ratio = ""
        if name in other:
            ratios.append(mean / float(np.mean(other[name])))
            ratio = f"  {ratios[-1]:.3f} of {options.beside}"
        print(f"{name:28s} as it is {errors[0]:8.3f}, mean {mean:8.3f} % of the spread{ratio}")
    if ratios:
        print(f"geometric mean of the ratios {np.exp(np.mean(np.log(ratios))):.3f}")
    data = [row for row in rows if not row["change"].startswith(SETTINGS)]
    print(in_words("data", data))
    if options.settings:
        plain = [row for row in rows if row["change"] == AS_IT_IS]
        print(in_words("settings", [*plain, *(r for r in rows if r["change"].startswith(SETTINGS))]))
    print(f"CPU {np.median([row['cpu'] for row in rows]):.1f} s in the median")
    return 0


if __name__ == "__main__":
    sys.exit(main())
