"""What the verbs print of one log, side by side: bandwidth, delay, gain, crossover, margins.

`python -m bench.verbs_agree [LOG ...] [--journal FILE]`: every log of `../shared/logs` by default. Each verb
runs as a user runs it, in a process of its own, and its JSON is read: `tf`, `step`, `gains`, `review`,
`predict` and `design` of the present loop, `fit` (linear models, by the recipe that `tf` takes) and `plan` of
its run. One row per log and axis: what each verb states of the same quantity, with its
95 % interval. A pair whose intervals do not meet is named, with the caution that a verb printed of it, or
"no caution".

Two quantities are the same only where both verbs mean the same signals: `gains`, `predict`, `design` of a log
and `review` speak of the rate loop; `tf`, `step`, `fit` and `plan` of the channels of the recipe that fits.
`fit` states the dead time, and `plan` the steady gain of its baseline. A dead time is no more than the time
to 10 % of a step.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

LOGS = Path("../shared/logs")
SLOWEST_S = 900.0
"""After that a verb counts as one that gave no answer."""
AXES = ("roll", "pitch", "yaw")
OF_LOOPS = {
    "crossover_hz": "crossover, Hz",
    "phase_deg": "phase margin, deg",
    "gain_db": "gain margin, dB",
    "delay_ms": "delay margin, ms",
    "ms": "Ms",
    "bandwidth_hz": "bandwidth, Hz",
}
"""Name in JSON -> quantity."""
OF_REVIEWS = {
    "rate_{}_overshoot": "overshoot, %",
    "{}_crossover": "crossover, Hz",
    "{}_phase_margin": "phase margin, deg",
    "{}_gain_margin": "gain margin, dB",
    "{}_delay_margin": "delay margin, ms",
    "{}_sensitivity": "Ms",
    "{}_bandwidth": "bandwidth, Hz",
}
"""Fact of an axis -> quantity."""
DEAD_TIME = re.compile(r"dead time \S+ -> (\S+): .*? ms \[([\d.]+), ([\d.]+)\]")


@dataclass(frozen=True)
class Stated:
    """A figure that a verb prints of an axis, with its interval; `of` names the signals."""

    verb: str
    of: str
    quantity: str
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.verb} [{self.low:.3g}, {self.high:.3g}]"


def main() -> None:
    """Run, keep, print."""
    parser = argparse.ArgumentParser(prog="python -m bench.verbs_agree")
    parser.add_argument("logs", type=Path, nargs="*")
    parser.add_argument("--journal", type=Path, help="append every log to this file, go on where it ends")
    order = parser.parse_args()
    kept = _read(order.journal)
    for log in order.logs or sorted(p for p in LOGS.rglob("*") if p.is_file() and p.suffix != ".md"):
        if str(log) in kept:
            continue
        kept[str(log)] = run(log)
        if order.journal:
            with order.journal.open("a") as file:
                file.write(json.dumps({"log": str(log), "verbs": kept[str(log)]}) + "\n")
        print(f"{log}: {', '.join(v for v, body in kept[str(log)].items() if body)}", flush=True)
    print("\n".join(table(kept)))


def _read(journal: Path | None) -> dict[str, dict[str, Any]]:
    if journal is None or not journal.exists():
        return {}
    lines = (json.loads(line) for line in journal.read_text().splitlines())
    return {line["log"]: line["verbs"] for line in lines}


def run(log: Path) -> dict[str, Any]:
    """What each verb prints of a log as JSON; None where it refuses."""
    place = str(log.resolve())
    found = {
        "tf": _answer("tf", place, "--quiet"),
        "step": _answer("step", place, "--quiet"),
        "gains": _answer("gains", place),
        "review": _answer("review", place),
        "design": _answer("design", place, "--quiet"),
    }
    same = _present_gain(found["gains"])
    found["predict"] = _answer("predict", place, "--set", same) if same else None
    return found | _fitted(place, (found["tf"] or {}).get("recipe"))


def _fitted(place: str, recipe: str | None) -> dict[str, Any]:
    """The channels of a run of linear models, and what `plan` states of it; None where there is no run."""
    nothing = {"fit": None, "plan": None}
    if not recipe:
        return nothing
    quick = ("--models", "line", "--effort", "quick", "--no-rotate", "--jobs", "1")
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        if _printed("fit", place, "--recipe", recipe, *quick, "--output", str(run), "--quiet") is None:
            return nothing
        document = run / "run.json"
        if not document.is_file():
            return nothing
        channels = json.loads(document.read_text("utf-8"))["channels"]
        return {"fit": channels, "plan": _answer("plan", str(run), "--quiet")}


def _answer(*words: str) -> Any:
    """A verb's JSON; None where it refuses or takes too long."""
    try:
        return json.loads(_printed(*words, "--json") or "")
    except json.JSONDecodeError:
        return None


def _printed(*words: str) -> str | None:
    """What a verb prints; None where it takes too long."""
    order = [sys.executable, "-m", "flysid", *words]
    try:
        done = subprocess.run(order, capture_output=True, text=True, timeout=SLOWEST_S, check=False)
    except subprocess.TimeoutExpired:
        return None
    return done.stdout


def _present_gain(gains: Any) -> str:
    """The first gain that a log states, as `predict --set` takes it, and a little more.

    `predict` refuses what changes nothing; its figures of the present loop are read.
    """
    for axis in gains or ():
        for name, value in axis["gains"].items():
            if value is None:
                continue
            if name.endswith(" P"):
                return f"p_{axis['axis']}={1.001 * value:.6g}"
            if name == "P":
                return f"MC_{axis['axis'].upper()}RATE_P={1.001 * value:.6g}"
            if name.startswith("ATC_RAT") and name.endswith("_P"):
                return f"{name}={1.001 * value:.6g}"
    return ""


def stated(verbs: Mapping[str, Any]) -> Iterator[Stated]:
    """Every figure with an interval, in one unit per quantity."""
    for channel in (verbs["tf"] or {"channels": ()})["channels"]:
        yield from _of_transfers(channel)
    for step in (verbs["step"] or {"steps": ()})["steps"]:
        figures = step["figures"]
        yield from _kept("step", step["channel"], "gain", figures["final value"])
        yield from _kept("step", step["channel"], "time to 10 %, ms", figures["latency"])
        yield from _kept("step", step["channel"], "overshoot, %", figures["overshoot"])
    for axis in verbs["gains"] or ():
        yield from _of_loop("gains", axis["axis"], axis.get("figures") or {})
    for verb in ("predict", "design"):
        for axis in (verbs.get(verb) or {"axes": ()})["axes"]:
            yield from _of_loop(verb, axis["axis"], axis["before"]["figures"])
    yield from _of_review(verbs["review"])
    yield from _of_fit(verbs.get("fit") or ())
    yield from _of_plan((verbs.get("plan") or {"known": ()})["known"])


def _of_review(review: Any) -> Iterator[Stated]:
    tracking = ((review or {}).get("sections") or {}).get("tracking", {"facts": {}})
    for axis in AXES:
        for name, quantity in OF_REVIEWS.items():
            fact = tracking["facts"].get(name.format(axis))
            if fact and fact["ci95"]:
                yield Stated("review", f"{axis}_rate", quantity, *fact["ci95"])


def _of_fit(channels: Sequence[Mapping[str, Any]]) -> Iterator[Stated]:
    """Dead times of the channels with one input, where `fit` uses what it found."""
    for channel in channels:
        found = [DEAD_TIME.match(words) for words in channel["dead_times"] if ", not used" not in words]
        if len(found) == 1 and found[0]:
            low, high = (float(end) for end in found[0].groups()[1:])
            yield Stated("fit", channel["name"], "dead time, ms", low, high)


def _of_plan(known: Sequence[Mapping[str, Any]]) -> Iterator[Stated]:
    """Steady gains of the channels with one input, where the run determines them."""
    gains = [k for k in known if k["determined"] and k["what"].startswith("gain of ")]
    count = Counter(k["channel"] for k in gains)
    for one in gains:
        if count[one["channel"]] == 1:
            half = abs(one["value"]) * one["known_pct"] / 100.0
            yield Stated("plan", one["channel"], "gain", one["value"] - half, one["value"] + half)


def _of_transfers(channel: Mapping[str, Any]) -> Iterator[Stated]:
    single = len(channel["transfers"]) == 1
    for transfer in channel["transfers"] if single else ():
        yield from _kept("tf", channel["channel"], "gain", transfer["gain"])
        yield from _kept("tf", channel["channel"], "dead time, ms", transfer["dead_time"], 1e3)
    command = channel["figures"].get("command", {})
    yield from _kept("tf", channel["channel"], "bandwidth, Hz", command.get("bandwidth_rads"), 0.159154943)


def _of_loop(verb: str, axis: str, figures: Mapping[str, Any]) -> Iterator[Stated]:
    for name, quantity in OF_LOOPS.items():
        yield from _kept(verb, f"{axis}_rate", quantity, figures.get(name))


def _kept(
    verb: str, of: str, quantity: str, figure: Mapping[str, Any] | None, unit: float = 1.0
) -> Iterator[Stated]:
    """A figure that has both ends, or only one: what lies beyond is open."""
    if figure is None or (figure.get("low") is None and figure.get("high") is None):
        return
    low = -float("inf") if figure.get("low") is None else unit * figure["low"]
    high = float("inf") if figure.get("high") is None else unit * figure["high"]
    yield Stated(verb, of, quantity, low, high)


def apart(figures: Sequence[Stated]) -> list[tuple[Stated, Stated]]:
    """Pairs of one quantity of one axis whose intervals do not meet; a dead time beyond the time to 10 %."""
    found = []
    for a, b in combinations(figures, 2):
        if a.of != b.of:
            continue
        same = a.quantity == b.quantity and (a.low > b.high or b.low > a.high)
        late = a.quantity == "dead time, ms" and b.quantity == "time to 10 %, ms" and a.low > b.high
        if same or late:
            found.append((a, b))
    return found


def table(kept: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """One row per log, axis and quantity that two verbs state; then the pairs that disagree."""
    rows = ["| log | of | quantity | stated |", "| --- | --- | --- | --- |"]
    pairs = []
    compared = 0
    for log, verbs in kept.items():
        figures = list(stated(verbs))
        places = dict.fromkeys((f.of, f.quantity) for f in figures)
        for of, quantity in places:
            beside = [f for f in figures if (f.of, f.quantity) == (of, quantity)]
            if len(beside) > 1:
                compared += len(beside) * (len(beside) - 1) // 2
                rows.append(f"| {Path(log).name} | {of} | {quantity} | {', '.join(map(str, beside))} |")
        cautions = _cautions(verbs)
        for a, b in apart(figures):
            said = cautions.get(a.of, "no caution")
            pairs.append(f"{Path(log).name}, {a.of}: {a.quantity} {a}, {b.quantity} {b}: {said}")
    return [*rows, "", f"{compared} pairs, {len(pairs)} exclude each other", *pairs]


def _cautions(verbs: Mapping[str, Any]) -> dict[str, str]:
    """The caution about another verb that is printed of each channel."""
    found: dict[str, str] = {}
    for channel in (verbs["tf"] or {"channels": ()})["channels"]:
        for caution in channel["cautions"]:
            if "exclude each other" in caution:
                found[channel["channel"]] = caution
    for step in (verbs["step"] or {"steps": ()})["steps"]:
        if step.get("caution"):
            found[step["channel"]] = step["caution"]
    return found


if __name__ == "__main__":
    main()
