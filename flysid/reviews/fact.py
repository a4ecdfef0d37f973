"""What a review states: facts in sections, findings for the first screen, actions, and pictures.

Nothing here computes. A section computes its facts from a log; pages, documents and the terminal show them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from flysid.dataset import FloatArray
from flysid.showing import significant


class Grade(Enum):
    """How a fact stands against its limit, best first; PLAIN where no limit is known."""

    GOOD = "good"
    PLAIN = "plain"
    WATCH = "watch"
    BAD = "bad"

    @property
    def rank(self) -> int:
        """0 for the best."""
        return list(Grade).index(self)


@dataclass(frozen=True)
class Fact:
    """One figure of a review, or the reason why the log does not hold it.

    Attributes
    ----------
    key : path in the document, "power.hover_throttle": what `--fail-if` and JSON call it.
    label : what people call it, "hover throttle".
    value : None where it is not determined.
    unit : of the value.
    interval : of 95 %; None where none is known.
    grade : against its limit.
    note : what limits the figure, or the limit that it stands against.
    fields : each a `STREAM.FIELD` that it was computed from: its evidence.
    at_s : seconds on the log's clock at which it shows best; None where no moment stands out.
    missing : why it is not determined; "" where it is.
    remedy : what logs it next time, with the parameter's name.
    least_s : seconds in the air below which it is not stated.

    Examples
    --------
    >>> Fact("power.sag", "battery sag", 0.93, "V", (0.9, 0.96)).words
    '0.93 V [0.9, 0.96]'
    >>> Fact("power.sag", "battery sag", missing="no current is logged").words
    'not determined: no current is logged'
    """

    key: str
    label: str
    value: float | str | None = None
    unit: str = ""
    interval: tuple[float, float] | None = None
    grade: Grade = Grade.PLAIN
    note: str = ""
    fields: tuple[str, ...] = ()
    at_s: float | None = None
    missing: str = ""
    remedy: str = ""
    least_s: float = 0.0

    @property
    def words(self) -> str:
        """The value with its unit and interval, or why there is none."""
        if self.value is None:
            return f"not determined: {self.missing}" if self.missing else "not determined"
        if isinstance(self.value, str):
            return self.value
        text = f"{significant(self.value)} {self.unit}".rstrip()
        if self.interval is None:
            return text
        low, high = (significant(edge) for edge in self.interval)
        return f"{text} [{low}, {high}]"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "label": self.label,
            "value": self.value if self.value is None or isinstance(self.value, str) else float(self.value),
            "unit": self.unit,
            "ci95": [float(edge) for edge in self.interval] if self.interval else None,
            "grade": self.grade.value,
            "note": self.note,
            "fields": list(self.fields),
            "at_s": None if self.at_s is None else float(self.at_s),
            "missing": self.missing,
            "remedy": self.remedy,
        }


@dataclass(frozen=True)
class Finding:
    """A sentence that may stand on the first screen.

    Attributes
    ----------
    text : one short sentence with its figure, a capital at its beginning, no full stop at its end.
    grade : BAD and WATCH come first.
    weight : among findings of one grade, how much it matters, 0 to 1.
    fact : key of the fact that is its evidence.
    more : a few words in small print: the limit, or what the log cannot separate.
    topic : findings of one topic are about one thing: the first of them stands for all; "" for its own.
    """

    text: str
    grade: Grade
    weight: float
    fact: str
    more: str = ""
    topic: str = ""

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"text": self.text, "grade": self.grade.value, "fact": self.fact, "more": self.more}


@dataclass(frozen=True)
class Change:
    """A parameter, as it was flown and as it is proposed."""

    name: str
    old: float
    new: float
    unit: str = ""

    @property
    def words(self) -> str:
        """ "MPC_THR_HOVER 0.5 -> 0.66"."""
        return f"{self.name} {significant(self.old)} -> {significant(self.new)} {self.unit}".rstrip()

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"name": self.name, "old": float(self.old), "new": float(self.new), "unit": self.unit}


@dataclass(frozen=True)
class Action:
    """What to do next, from evidence in the log.

    Attributes
    ----------
    title : an order of a few words.
    reason : what the log shows.
    changes : of parameters; () for a repair or a flight.
    predicted : what it will change, with its interval; "" where that is not known.
    risk : what may go wrong.
    weight : how much it gains, 0 to 1.
    fact : key of the fact that is its evidence.
    """

    title: str
    reason: str
    changes: tuple[Change, ...] = ()
    predicted: str = ""
    risk: str = ""
    weight: float = 0.5
    fact: str = ""

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "title": self.title,
            "reason": self.reason,
            "changes": [change.to_dict() for change in self.changes],
            "predicted": self.predicted,
            "risk": self.risk,
            "fact": self.fact,
        }


@dataclass(frozen=True, eq=False)
class PictureLine:
    """A line of a picture: (N,) x and y, NaN where it breaks.

    `style` is its colour: "measured", "setpoint", or "r1" to "r8".
    """

    name: str
    x: FloatArray
    y: FloatArray
    style: str = "measured"


@dataclass(frozen=True, eq=False)
class Picture:
    """Lines on two axes.

    `title`, `aside`: at its top left and right.
    `x_label`, `y_label`: with units.
    `lines`: drawn in their order.
    `marks`: x -> words: a peak, an impact.
    `hidden_from`: x from which on the log cannot show anything, such as half of its rate; None for nowhere.
    """

    title: str
    x_label: str
    y_label: str
    lines: tuple[PictureLine, ...]
    aside: str = ""
    marks: Mapping[float, str] = field(default_factory=dict)
    hidden_from: float | None = None


@dataclass(frozen=True, eq=False)
class HeatMap:
    """A quantity over two axes, such as a spectrum over time or throttle: (rows, columns) values in dB."""

    title: str
    x_label: str
    y_label: str
    x: FloatArray
    y: FloatArray
    values: FloatArray
    aside: str = ""


@dataclass(frozen=True, eq=False)
class MotorPlan:
    """Motors from above: for each its place (forward, right; -1 to 1) and its mean share of the range."""

    title: str
    places: tuple[tuple[float, float], ...]
    shares: tuple[float, ...]
    names: tuple[str, ...]
    aside: str = ""


@dataclass(frozen=True, eq=False)
class TopView:
    """A vehicle from above: what its motors do to it.

    `places`: of each motor, forward and right, -1 to 1.
    `names`: of each motor.
    `spins`: 1 for a rotor that turns clockwise as seen from above, -1 against it, 0 where that is not known.
    `is_known`: whether the flights determine where each motor stands.
    """

    title: str
    places: tuple[tuple[float, float], ...]
    names: tuple[str, ...]
    spins: tuple[int, ...]
    is_known: tuple[bool, ...]
    aside: str = ""


@dataclass(frozen=True)
class Table:
    """Headings and rows of cells; a cell that is a number of seconds on the log's clock stands in `times`."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    times: tuple[float, ...] = ()


Drawn = Picture | HeatMap | MotorPlan | TopView
Shown = Drawn | Table


@dataclass(frozen=True, eq=False)
class Section:
    """A part of the page.

    Attributes
    ----------
    key, title : "power", "Power and motors".
    facts : in the order in which they are shown.
    findings, actions : candidates for the first screen.
    shown : pictures and tables.
    """

    key: str
    title: str
    facts: tuple[Fact, ...] = ()
    findings: tuple[Finding, ...] = ()
    actions: tuple[Action, ...] = ()
    shown: tuple[Shown, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """For JSON: facts by what stands behind the section's name in their keys."""
        return {
            "title": self.title,
            "facts": {fact.key.partition(".")[2]: fact.to_dict() for fact in self.facts},
            "findings": [finding.to_dict() for finding in self.findings],
            "actions": [action.to_dict() for action in self.actions],
        }


OSCILLATION = "oscillation"
"""The topic of what shakes a vehicle as a loop or a tone."""


def order(findings: Sequence[Finding]) -> list[Finding]:
    """Findings, the gravest first; of one topic the gravest alone."""
    ranked = sorted(findings, key=lambda finding: (-finding.grade.rank, -finding.weight))
    by_topic = {finding.topic or f"{i}": finding for i, finding in reversed(list(enumerate(ranked)))}
    return [finding for i, finding in enumerate(ranked) if by_topic[finding.topic or f"{i}"] is finding]
