"""Gains for every rule of a run's models, beside the robust PID's figures: an expert's option."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flysid.design.designing import Wish, none_left, ready_channel, wished_channels
from flysid.design.firmware import SAFETY
from flysid.design.law import LoopParts
from flysid.design.rule_gains import law_figures, search_rule_gains
from flysid.design.rule_plants import RuleLaw, rule_plant
from flysid.errors import DataError, UsageError
from flysid.model.structures import kind_of, leaders
from flysid.progress import tell
from flysid.showing import counted
from flysid.validate.runs.run import Run, held_out

FORMAT = "flysid-rule-gains"
FILE = "rule_gains.json"
PROVED = (
    "Proved in exact fractions, from the numbers in this file: the model's loop contracts under any blend of "
    "its rules, without limits of the input and without the rules' constants. "
    "Nothing is proved of the vehicle."
)


@dataclass(frozen=True, eq=False)
class RuleAxis:
    """One channel's law, and the worst of its figures over all rules and plants."""

    channel: str
    model: str
    units: tuple[str, str]
    law: RuleLaw
    ms: float
    peak: float
    noise: float
    tracking: float

    def lines(self) -> list[str]:
        """For people."""
        u, v = self.units
        return [
            f"{self.channel}: gains for {len(self.law.gains)} rules of {self.model!r} over "
            f"{counted(self.law.plant.order, 'measured state')}, proved",
            f"  at worst: Ms {self.ms:.2f}, peak {self.peak:.2f}, squared error of a step "
            f"{self.tracking:.2f} m^2 s, 1 {v} of noise moves the input by {self.noise:.3g} {u}",
            f"  the input stays inside its limit from errors of position up to {self.law.reach_m:.1f} m",
        ]

    def table(self) -> list[tuple[str, ...]]:
        """No rows: the gains of every rule and state stand in the file."""
        return []

    def to_dict(self) -> dict[str, Any]:
        """JSON types only: u = - sum_r w_r(z) gains_r xi, z = scheduling xi."""
        p = self.law.plant
        names = [f"output(k-{i})" for i in range(p.speeds)] + [f"input(k-{i + 1})" for i in range(p.sent)]
        arrays = ("a", "b", "scheduling", "centre", "width", "low", "high")
        return {
            "channel": self.channel,
            "model": self.model,
            "dt_s": p.dt_s,
            "states": [*names, "position less reference", "its sum over time"],
            "gains": self.law.gains.tolist(),
            **{name: getattr(p, name).tolist() for name in arrays},
            "metric": self.law.metric.tolist(),
            "decay": self.law.decay,
            "figures": {k: getattr(self, k) for k in ("ms", "peak", "noise", "tracking")},
        }


@dataclass(frozen=True, eq=False)
class RuleDesign:
    """What was found, and channel -> (why not, what to do) of the others."""

    run: str
    axes: tuple[RuleAxis, ...]
    refused: Mapping[str, tuple[str, str]]

    @property
    def caution(self) -> str:
        """What everybody who reads the gains must know."""
        return f"{PROVED} {SAFETY}"

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "format": FORMAT,
            "version": 1,
            "safety": SAFETY,
            "certificate": PROVED,
            "run": self.run,
            "axes": [axis.to_dict() for axis in self.axes],
        }

    def files(self) -> dict[str, str]:
        """Name -> text."""
        return {FILE: json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"}


def design_rules(run: Run, wish: Wish, data: str | Path | None = None) -> RuleDesign:
    """Certified gains for the rules of every channel that identifies a plant.

    `wish`: with the input's limit; present gains and feed-forward are for the PID.
    Raises UsageError: no limit, or no such channel. Raises DataError: no channel can be designed for.
    """
    if wish.limit is None:
        raise UsageError("gains of rules are found inside the input's limit", hint="--limit, in its unit")
    axes: list[RuleAxis] = []
    refused: dict[str, tuple[str, str]] = {}
    for item in held_out(wished_channels(run, wish), data):
        tell("searching for gains of every rule", channel=item.channel.name)
        try:
            ready = ready_channel(item, wish)
            rules = [n for n, m in ready.data.models.items() if kind_of(m.structure) == "rules"]
            label = next((n for n in leaders() if n in rules), "")
            if not label:
                raise DataError("no good model of rules was fitted", hint="--method pid")
            plant = rule_plant(ready.data.models[label])
            if ready.sign < 0.0:
                raise DataError(
                    "the output falls as the input rises", hint="reverse the sign of the channel's input"
                )
            law = search_rule_gains(plant, ready.plants, ready.bounds, wish.limit)
        except (DataError, UsageError) as error:
            refused[item.channel.name] = (error.message, error.hint or "")
            continue
        found = law_figures(law, ready.plants, LoopParts.at(ready.plants.omega, ready.plants.dt_s))
        train = ready.data.train
        worst = (float(v.max()) for v in (found.ms, found.peak, found.noise, found.tracking))
        units = (train.inputs[0].unit, train.outputs[0].unit)
        axes.append(RuleAxis(item.channel.name, label, units, law, *worst))
    if not axes:
        raise none_left(refused)
    return RuleDesign(str(run.folder), tuple(axes), refused)
