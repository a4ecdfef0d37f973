"""Printed figures held against the truth, on records drawn at random.

`python -m bench.truth [RECORDS] [--draw WHAT] [--journal FILE] [--by KIND] [--seed FIRST]`: plants of eight
kinds, six kinds of noise, seven of logging, four of excitation, open or in a loop with a reference added at
the plant's input. Every figure that `tf` and `step` print of them is scored: trials, intervals that hold the
truth with the exact 95 % bounds of that share, their median width relative to the truth, refused though there
is a truth, and printed though there is none ("false"). Seeds are fresh every run unless `--seed` names the
first. With `--journal` every record is kept as it ends: the same command goes on where it stopped. `--by
plant` (or noise, logging, excitation, loop, bend) adds a table of the shares by kind.

`--draw` takes others: "stamps", outputs stamped late or by a clock of their own; "loops", PI and PID at the
input or a setpoint, and a pilot that no reference shows; "bent", plants with a saturation, a dead zone, a
Hammerstein or a Wiener bend, backlash, drag, dry friction, or a lag that depends on its speed, scored against
the best linear approximation at the sizes that were flown; "gains", the loops of simulated PX4 and ArduPilot
flights; "fit", verdicts of `fit` against 120 fresh flights, some 5 s of CPU each.
"""

from __future__ import annotations

import argparse
import json
import secrets
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import betaincinv

from bench.truth.records import DRAWS, draw_record
from bench.truth.verbs import Score, scores
from bench.truth.whole import score_fit, score_gains

SEEDS = 2**40
WHOLE = {"gains": score_gains, "fit": score_fit}


def main() -> None:
    """Run, keep, print."""
    parser = argparse.ArgumentParser(prog="python -m bench.truth")
    parser.add_argument("records", type=int, nargs="?", default=200)
    parser.add_argument("--journal", type=Path, help="append every record to this file, go on where it ends")
    parser.add_argument(
        "--by", choices=["plant", "noise", "logging", "excitation", "loop", "bend"], help="a table by kind"
    )
    parser.add_argument("--draw", choices=[*DRAWS, *WHOLE], default=DRAWS[0], help="what is drawn")
    parser.add_argument("--seed", type=int, help="the first of consecutive seeds")
    order = parser.parse_args()
    kept = read_journal(order.journal)
    first = order.seed if order.seed is not None else _first_seed(kept)
    done = {line["seed"] for line in kept}
    print(f"seeds from {first}", flush=True)
    for seed in range(first, first + order.records):
        if seed in done:
            continue
        line = run(seed, order.draw)
        kept.append(line)
        if order.journal:
            with order.journal.open("a") as file:
                file.write(json.dumps(line) + "\n")
    print("\n".join(table(kept)))
    if order.by:
        print("\n".join(["", *shares_by(kept, order.by)]))


def run(seed: int, draw: str) -> dict[str, Any]:
    """A line of the journal: seed, kinds, scores."""
    if draw in WHOLE:
        kinds, found = WHOLE[draw](seed)
    else:
        record = draw_record(seed, draw)
        kinds, found = record.kinds, scores(record)
    return {"seed": seed, "kinds": kinds, "scores": [s.to_dict() for s in found]}


def read_journal(journal: Path | None) -> list[dict[str, Any]]:
    """The records of an earlier run; a line that a kill cut short is left out."""
    if journal is None or not journal.exists():
        return []
    lines = []
    for text in journal.read_text().splitlines():
        try:
            lines.append(json.loads(text))
        except json.JSONDecodeError:
            continue
    return lines


def _first_seed(kept: Sequence[Mapping[str, Any]]) -> int:
    return min((line["seed"] for line in kept), default=secrets.randbelow(SEEDS))


def _by_figure(lines: Iterable[Mapping[str, Any]]) -> dict[str, list[Score]]:
    found: dict[str, list[Score]] = {}
    for line in lines:
        for score in line["scores"]:
            found.setdefault(score["figure"], []).append(Score(**score))
    return found


def table(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """One row per figure."""
    rows = ["| figure | trials | held | exact 95 % bounds, % | median width, % | refused | false |"]
    rows.append("| --- " * 7 + "|")
    for figure, found in _by_figure(lines).items():
        right = [s for s in found if s.true is not None]
        printed = [s for s in right if s.low is not None]
        false = sum(s.true is None and s.low is not None for s in found)
        held = sum(s.held for s in printed)
        low, high = exact_bounds(held, len(printed))
        widths = [100.0 * (s.high - s.low) / abs(s.true) for s in printed if s.true]  # type: ignore[operator]
        width = f"{np.median(widths):.2g}" if widths else "-"
        rows.append(
            f"| {figure} | {len(right)} | {held} of {len(printed)} | {100 * low:.0f} to {100 * high:.0f} "
            f"| {width} | {len(right) - len(printed)} | {false} |"
        )
    return rows


def shares_by(lines: Sequence[Mapping[str, Any]], kind: str) -> list[str]:
    """Held of printed, figure by figure, for every kind."""
    kinds = sorted({line["kinds"].get(kind, "-") for line in lines})
    rows = [f"| figure | {' | '.join(kinds)} |", "| --- " * (len(kinds) + 1) + "|"]
    parts = {k: _by_figure(line for line in lines if line["kinds"].get(kind, "-") == k) for k in kinds}
    for figure in _by_figure(lines):
        cells = []
        for k in kinds:
            printed = [s for s in parts[k].get(figure, []) if s.true is not None and s.low is not None]
            cells.append(f"{sum(s.held for s in printed)} of {len(printed)}")
        rows.append(f"| {figure} | {' | '.join(cells)} |")
    return rows


def exact_bounds(held: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Of a share (Clopper and Pearson, 1934, Biometrika 26)."""
    tail = (1.0 - level) / 2.0
    low = float(betaincinv(held, trials - held + 1, tail)) if held else 0.0
    high = float(betaincinv(held + 1, trials - held, 1.0 - tail)) if held < trials else 1.0
    return low, high


if __name__ == "__main__":
    main()
