"""`--fail-if EXPRESSION`: a condition on the JSON document, so that a pipeline can guard a model.

    free_run.change_pct > 5 or not (roll.10.verdict == same and free_run.ts.rmse < 0.3)

Python parses it (`ast`), with "and", "or", "not", parentheses and comparisons, and nothing else is evaluated.
What is compared are numbers, words, 'text' and paths, [CHANNEL.]HORIZON.FIELD[.FIELD...]; HORIZON is
"free_run" or a number of steps. Fields are the document's: change_pct, verdict, ci95.low, ci95.high,
models.ts.rmse (or ts.rmse) and so on. A query language such as JMESPath would take a misspelt field for null,
and guard nothing.

A path without a channel is tried on every channel, and the condition holds when it holds on any. "better" and
"same" hold for another flight: a verdict of these flights only is neither. A change that is null because a
model diverged counts as infinitely large (verdict "worse") or small ("better"). A guard that cannot judge
fails: a condition that asks for any other number that does not exist, such as the change where both models
diverged, holds, and says why.
"""

from __future__ import annotations

import ast
import difflib
import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from flysid.errors import UsageError
from flysid.validate.compare.intervals import Scope
from flysid.validate.compare.verdict import Verdict

_TERM = re.compile(
    r"""
        (?P<path>(?:"[^"]*"|'[^']*'|[^\W\d][\w/:-]*|\d+)(?:\.(?:"[^"]*"|[^\W\d][\w/:-]*|\d+(?=\.)))+)
      | (?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
      | (?P<text>"[^"]*"|'[^']*')
      | (?P<word>(?!(?:and|or|not)\b)[^\W\d][\w-]*)
    """,
    re.VERBOSE,
)
_GRAMMAR = re.compile(r"(?:\s|and\b|or\b|not\b|[()]|[<>]=?|[=!]=)*")
_COMPARE: Mapping[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
WIDE = (Verdict.BETTER, Verdict.SAME)
"""Verdicts that are of unseen flights without more words; "worse" is bad news whatever its scope."""
EXAMPLE = "write for example 'free_run.change_pct > 5' or 'roll.free_run.verdict == worse'"

Value = float | str | None
Path = tuple[str, ...]


def matching_channels(expression: str, document: Mapping[str, Any]) -> dict[str, str]:
    """The channels of a `to_json` document on which the condition holds; all where it names its channels.

    With each stands why it could not be judged, or "". Raises UsageError: the expression is not understood,
    or names what the document does not hold.
    """
    terms: list[_Term] = []
    try:
        tree = ast.parse(_with_names(expression, terms), mode="eval").body
        found: dict[str, str] = {}
        for channel in document["channels"]:
            guard = _Guard(document, channel, terms)
            if guard.holds(tree) or guard.unjudged:
                found[channel] = "; ".join(dict.fromkeys(guard.unjudged))
        return found
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise UsageError(f"condition not understood: {expression.strip()[:60]!r}", hint=EXAMPLE) from error


def check_grammar(expression: str) -> None:
    """Raise UsageError where a condition is no comparison, whatever the document will hold.

    >>> check_grammar("power.sag > 0.5 and not vibration.clips == 0")
    """
    try:
        tree = ast.parse(_with_names(expression, []), mode="eval").body
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise UsageError(f"condition not understood: {expression.strip()[:60]!r}", hint=EXAMPLE) from error
    if not isinstance(tree, ast.BoolOp | ast.UnaryOp | ast.Compare):
        raise UsageError("condition needs a comparison", hint=EXAMPLE)


def check_condition(expression: str, expected: Mapping[str, Any]) -> None:
    """Raise UsageError where a condition cannot be understood, before there is a document.

    `expected`: channels and fields that the document will have, with values of their types.
    """
    matching_channels(expression, expected)


@dataclass(frozen=True)
class _Term:
    """What is compared: a "path", "number", "text" or "word"."""

    kind: str
    text: str

    @property
    def parts(self) -> Path:
        """Of a path, or the one word of a text."""
        return tuple(p.strip("\"'") for p in re.findall(r"\"[^\"]*\"|'[^']*'|[^.]+", self.text))


def _with_names(expression: str, terms: list[_Term]) -> str:
    """The expression with "_0", "_1", ... in place of its terms, which Python could not read."""
    source = ""
    position = 0
    while position < len(expression):
        grammar = _GRAMMAR.match(expression, position)
        position = grammar.end() if grammar else position
        source += grammar[0] if grammar else ""
        term = _TERM.match(expression, position)
        if term is None and position < len(expression):
            raise UsageError(f"condition not understood at {expression[position:][:20]!r}", hint=EXAMPLE)
        if term is not None:
            source += f" _{len(terms)} "
            terms.append(_Term(str(term.lastgroup), term[0]))
            position = term.end()
    return " ".join(source.split())


@dataclass
class _Guard:
    """A condition tried on one channel; `unjudged` are the numbers that it asks for and that do not exist."""

    document: Mapping[str, Any]
    channel: str
    terms: Sequence[_Term]
    unjudged: list[str] = field(default_factory=list)

    def holds(self, node: ast.expr) -> bool:
        """Whether it holds; every part is looked at, so that a mistake shows on every document."""
        match node:
            case ast.BoolOp():
                parts = [self.holds(part) for part in node.values]
                return all(parts) if isinstance(node.op, ast.And) else any(parts)
            case ast.UnaryOp(op=ast.Not()):
                return not self.holds(node.operand)
            case ast.Compare():
                sides = [self._term(side) for side in (node.left, *node.comparators)]
                held = [self._compare(*pair) for pair in zip(sides, node.ops, sides[1:], strict=False)]
                return all(held)
        raise UsageError("condition needs a comparison", hint=EXAMPLE)

    def _term(self, node: ast.expr) -> _Term:
        if not isinstance(node, ast.Name):
            raise UsageError("condition compares what is neither a field nor a value", hint=EXAMPLE)
        return self.terms[int(node.id[1:])]

    def _compare(self, left: _Term, sign: ast.cmpop, right: _Term) -> bool:
        self._check_constants(left, right)
        a = self._value(left)
        b = self._value(right)
        if a is None or b is None:
            return True
        if isinstance(a, str) != isinstance(b, str):
            word, other = (left, right) if isinstance(a, str) else (right, left)
            raise UsageError(
                f"condition compares {other.text!r}, a number, with {word.text!r}, a word", hint=EXAMPLE
            )
        if isinstance(a, str) and not isinstance(sign, ast.Eq | ast.NotEq):
            raise UsageError("words can only be compared with == and !=", hint=EXAMPLE)
        return _COMPARE[type(sign)](a, b)

    def _value(self, term: _Term) -> Value:
        if term.kind == "number":
            return float(term.text)
        if term.kind != "path":
            return term.parts[0]
        path = self._whole(term.parts)
        values = _values(self.document)
        found = path if path in values else (*path[:2], "models", *path[2:])
        if found not in values:
            whole = any(known[: len(path)] == path for known in values)
            raise UsageError(
                f"{term.text!r} is not {'a single value' if whole else 'a field'} of this comparison",
                hint=_near(term.parts, values),
            )
        if values[found] is None:
            reason = self.document["channels"][path[0]][path[1]].get("reason", "no number")
            self.unjudged.append(f"{term.text} does not exist ({reason})")
        return values[found]

    def _whole(self, parts: Path) -> Path:
        """A path with its channel."""
        skipped = self.document.get("skipped", {})
        if parts[0] in self.document["channels"][self.channel]:
            return (self.channel, *parts)
        if parts[0] in skipped:
            raise UsageError(f"channel {parts[0]!r} was skipped: {skipped[parts[0]]}")
        return parts

    def _check_constants(self, *sides: _Term) -> None:
        """Two constants always compare alike, a verdict and no verdict, too; both would guard nothing."""
        constants = [side for side in sides if side.kind != "path"]
        if len(constants) == len(sides):
            said = " and ".join(repr(side.text.strip("\"'")) for side in sides)
            fields = sorted((path[1:] for path in _values(self.document)), key=len)
            meant = next((f for f in fields if (f[-1],) in [side.parts for side in sides]), None)
            raise UsageError(
                f"condition compares {said}, and neither is a field of the comparison",
                hint=f"did you mean {'.'.join(meant)!r}?" if meant else EXAMPLE,
            )
        if any(side.kind == "path" and side.parts[-1] == "verdict" for side in sides):
            for side in constants:
                if side.kind != "number":
                    _check_verdict(side.parts[0])


def _check_verdict(word: str) -> None:
    known = [*map(str, Verdict), *(f"{v} on {s}" for v in WIDE for s in Scope if not s.is_unseen)]
    if word not in known:
        near = difflib.get_close_matches(word, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(map(repr, known))}"
        raise UsageError(f"no verdict {word!r}", hint=hint)


def _near(parts: Path, values: Mapping[Path, Value]) -> str:
    """ "did you mean 'free_run.change_pct'?": paths that end alike, else those that are spelt alike."""
    horizons = {path[1] for path in values}
    skip = 1 if parts[0] in horizons or len(parts) < 3 else 0
    known = dict.fromkeys(path[skip:] for path in values)
    alike = [path for path in known if path[-1] == parts[-1]]
    pool = [".".join(path) for path in alike or known]
    near = difflib.get_close_matches(".".join(parts), pool, 2, cutoff=0.0 if alike else 0.6)
    return f"did you mean {' or '.join(map(repr, near))}?" if near else EXAMPLE


def _values(document: Mapping[str, Any]) -> dict[Path, Value]:
    """Every single value of every channel by its path: ("roll", "free_run", "models", "ts", "rmse")."""
    return dict(_below((), document["channels"]))


def _below(place: Path, holder: Mapping[str, Any]) -> Iterator[tuple[Path, Value]]:
    limit = {"worse": math.inf, "better": -math.inf}.get(str(holder.get("verdict")))
    for name, value in holder.items():
        path = (*place, name)
        if isinstance(value, Mapping):
            yield from _below(path, value)
        elif name == "ci95":
            yield from (
                ((*path, end), limit if v is None else v)
                for end, v in zip(("low", "high"), value, strict=True)
            )
        elif name == "change_pct":
            yield path, limit if value is None else value
        elif (
            name == "verdict" and value in WIDE and not Scope(holder.get("scope") or Scope.ANOTHER).is_unseen
        ):
            yield path, f"{value} on {holder['scope']}"
        elif not isinstance(value, bool | list):
            yield path, value
