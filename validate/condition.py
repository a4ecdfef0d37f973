"""`--fail-if EXPRESSION`: a condition on the JSON document, so that a pipeline can guard a model.

    or       := and ("or" and)*
    and      := not ("and" not)*
    not      := "not" not | "(" or ")" | compare
    compare  := operand (">" | ">=" | "<" | "<=" | "==" | "!=") operand
    operand  := number | 'text' | word | path
    path     := [channel "."] horizon "." field ("." field)*
    horizon  := "free_run" | steps

Fields are the document's: change_pct, verdict, ci95.low, ci95.high, models.ts.rmse (or ts.rmse) and so on.
A path without a channel is tried on every channel, and the condition holds when it holds on any. Nothing is
evaluated but this grammar. "better" and "same" are said of another flight: a verdict of these flights only is
neither. A change that is null because a model diverged counts as infinitely large (verdict "worse") or small
("better"). A guard that cannot judge fails: a condition that asks for any other number that does not exist,
such as the change where both models diverged, holds, and says why.
"""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flysid.errors import UsageError
from flysid.validate.intervals import Scope
from flysid.validate.verdict import Verdict

_TOKEN = re.compile(
    r"""\s*(?:
        (?P<op>>=|<=|==|!=|>|<|\(|\))
      | (?P<path>(?:"[^"]*"|'[^']*'|[^\W\d][\w/:-]*|\d+)(?:\.(?:"[^"]*"|[^\W\d][\w/:-]*|\d+(?=\.)))+)
      | (?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
      | (?P<text>"[^"]*"|'[^']*')
      | (?P<word>[^\W\d][\w-]*)
    )""",
    re.VERBOSE,
)
_COMPARE: Mapping[str, Callable[[Any, Any], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
}
DEEPEST = 50
WIDE = (Verdict.BETTER, Verdict.SAME)
"""Verdicts that are said of another flight without more words; "worse" is bad news whatever its scope."""
EXAMPLE = "write for example 'free_run.change_pct > 5' or 'roll.free_run.verdict == worse'"

Value = float | str | None
Channels = Mapping[str, Mapping[str, Any]]


def matching_channels(expression: str, document: Mapping[str, Any]) -> dict[str, str]:
    """The channels of a `to_json` document on which the condition holds; all where it names its channels.

    With each stands why it could not be judged, or "".

    Raises
    ------
    UsageError : the expression is not understood, or names what the document does not hold.
    """
    tokens, channels = _tokens(expression), document["channels"]
    skipped = document.get("skipped", {})
    found: dict[str, str] = {}
    for name in channels:
        parser = _Parser(tokens, channels, name, skipped)
        if parser.run() or parser.unjudged:
            found[name] = "; ".join(dict.fromkeys(parser.unjudged))
    return found


def check_condition(expression: str, expected: Mapping[str, Any]) -> None:
    """Raise UsageError where a condition cannot be understood, before there is a document.

    Parameters
    ----------
    expected : channels and fields that the document will have, with values of their types.
    """
    matching_channels(expression, expected)


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str


def _tokens(expression: str) -> list[_Token]:
    tokens: list[_Token] = []
    position = 0
    text = expression.rstrip()
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            raise UsageError(f"condition not understood at {text[position:][:20]!r}", hint=EXAMPLE)
        tokens.append(_Token(match.lastgroup, match[match.lastgroup]))
        position = match.end()
    return tokens


class _Parser:
    """Recursive descent over the tokens, evaluated for one channel."""

    def __init__(
        self, tokens: Sequence[_Token], channels: Channels, channel: str, skipped: Mapping[str, str]
    ) -> None:
        self._tokens = list(tokens)
        self._channels = channels
        self._channel = channel
        self._skipped = skipped
        self._at = 0
        self._depth = 0
        self.unjudged: list[str] = []

    def run(self) -> bool:
        """Whether the condition holds; UsageError where something stands behind its end."""
        result = self._or()
        if self._at < len(self._tokens):
            raise UsageError(f"condition goes on with {self._tokens[self._at].text!r}", hint=EXAMPLE)
        return result

    def _next_is(self, *words: str) -> bool:
        return self._at < len(self._tokens) and self._tokens[self._at].text in words

    def _take(self) -> _Token:
        if self._at >= len(self._tokens):
            raise UsageError("condition ends too early", hint=EXAMPLE)
        self._at += 1
        return self._tokens[self._at - 1]

    def _or(self) -> bool:
        result = self._and()
        while self._next_is("or"):
            self._take()
            result = self._and() or result
        return result

    def _and(self) -> bool:
        result = self._not()
        while self._next_is("and"):
            self._take()
            result = self._not() and result
        return result

    def _not(self) -> bool:
        self._depth += 1
        if self._depth > DEEPEST:
            raise UsageError(f"condition is nested deeper than {DEEPEST}")
        try:
            if self._next_is("not"):
                self._take()
                return not self._not()
            if self._next_is("("):
                self._take()
                result = self._or()
                if self._take().text != ")":
                    raise UsageError("condition lacks a ')'", hint=EXAMPLE)
                return result
            return self._compare()
        finally:
            self._depth -= 1

    def _compare(self) -> bool:
        begin = self._at
        left = self._operand()
        sign = self._take()
        if sign.text not in _COMPARE:
            raise UsageError(f"condition needs a comparison, not {sign.text!r}", hint=EXAMPLE)
        right = self._operand()
        end = self._at - 1
        self._check_sides(self._tokens[begin], self._tokens[end])
        if left is None or right is None:
            return True
        if isinstance(left, str) != isinstance(right, str):
            word, other = (begin, end) if isinstance(left, str) else (end, begin)
            raise UsageError(
                f"condition compares {self._tokens[other].text!r}, a number, with "
                f"{self._tokens[word].text!r}, a word",
                hint=EXAMPLE,
            )
        if isinstance(left, str) and sign.text not in ("==", "!="):
            raise UsageError(f"words are equal or not, {sign.text!r} does not order them", hint=EXAMPLE)
        return _COMPARE[sign.text](left, right)

    def _check_sides(self, *sides: _Token) -> None:
        """Two constants always compare alike, and would guard nothing."""
        if not any(t.kind == "path" for t in sides):
            fields = sorted(_field_names(self._channels[self._channel]), key=lambda f: f.count("."))
            words = [t.text for t in sides if t.kind == "word"]
            meant = [f for f in fields if f.rpartition(".")[2] in words]
            said = " and ".join(repr(t.text.strip("\"'")) for t in sides)
            raise UsageError(
                f"condition compares {said}, and neither is a field of the comparison",
                hint=f"did you mean {meant[0]!r}?" if meant else EXAMPLE,
            )
        _check_verdict(*sides)

    def _operand(self) -> Value:
        token = self._take()
        if token.kind == "number":
            return float(token.text)
        if token.kind == "text":
            return token.text[1:-1]
        if token.kind == "path":
            return self._look_up(token.text)
        if token.kind == "word" and token.text not in ("and", "or", "not"):
            return token.text
        raise UsageError(f"condition has {token.text!r} where a value must stand", hint=EXAMPLE)

    def _look_up(self, path: str) -> Value:
        parts = [p.strip("\"'") for p in re.findall(r"\"[^\"]*\"|'[^']*'|[^.]+", path)]
        channel = self._channels[self._channel]
        if parts[0] not in channel:
            if parts[0] in self._skipped:
                raise UsageError(f"channel {parts[0]!r} was skipped: {self._skipped[parts[0]]}")
            channel = _member(self._channels, parts.pop(0), "channel or horizon", (*self._channels, *channel))
        if not parts:
            raise UsageError(f"{path!r} names a channel and nothing in it", hint=EXAMPLE)
        entry = _member(channel, parts.pop(0), "horizon")
        value = _field(entry, parts, path)
        if value is None:
            self.unjudged.append(f"{path} does not exist ({entry.get('reason', 'no number')})")
        return value


def _check_verdict(*sides: _Token) -> None:
    """A verdict compared with a word that none of them is would never hold, and guard nothing."""
    if not any(t.kind == "path" and t.text.endswith(".verdict") for t in sides):
        return
    for token in sides:
        word = token.text.strip("\"'")
        known = [*map(str, Verdict), *(f"{v} on {s}" for v in WIDE for s in Scope if s is not Scope.ANOTHER)]
        if token.kind in ("text", "word") and word not in known:
            near = difflib.get_close_matches(word, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(map(repr, known))}"
            raise UsageError(f"no verdict {word!r}", hint=hint)


def _field(entry: Mapping[str, Any], parts: list[str], path: str) -> Value:
    value: Any = entry
    for i, part in enumerate(parts):
        if part in ("low", "high") and isinstance(value, list):
            value = value[part == "high"]
        elif i == 0 and part not in entry and part in entry["models"]:
            value = entry["models"][part]
        elif isinstance(value, Mapping):
            value = _member(value, part, "field", (*value, *entry["models"]) if i == 0 else (), entry)
        else:
            raise UsageError(f"{path!r} goes on below a plain value", hint=EXAMPLE)
    if isinstance(value, bool) or not (value is None or isinstance(value, (int, float, str))):
        raise UsageError(f"{path!r} is not a single value", hint=EXAMPLE)
    owner = _owner(entry, parts)
    if value is None and parts[-1] in ("change_pct", "low", "high"):
        verdict = entry.get("verdict") if parts[0] == "ci95" else owner.get("verdict")
        return {"worse": math.inf, "better": -math.inf}.get(str(verdict))
    if parts[-1] == "verdict" and value in WIDE and owner.get("scope") not in (None, Scope.ANOTHER):
        return f"{value} on {owner['scope']}"
    return value


def _owner(entry: Mapping[str, Any], parts: Sequence[str]) -> Mapping[str, Any]:
    """The mapping that holds the last part of a path known to exist."""
    owner = entry
    for part in parts[:-1]:
        below = owner[part] if part in owner else owner["models"][part]
        owner = below if isinstance(below, Mapping) else owner
    return owner


def _member(
    holder: Mapping[str, Any],
    name: str,
    what: str,
    names: Sequence[str] = (),
    entry: Mapping[str, Any] | None = None,
) -> Any:
    """`holder[name]`; an error with what is near.

    Parameters
    ----------
    names : all that could have stood there, where that is more than what `holder` holds.
    entry : where a field that is elsewhere is looked for.
    """
    if name in holder:
        return holder[name]
    raise UsageError(
        f"no {what} {name!r} in this comparison", hint=_near(name, names or [*holder], entry or {})
    )


def _near(name: str, names: Sequence[str], entry: Mapping[str, Any]) -> str:
    """ "did you mean 'change_pct'?": where else that name stands, what is spelt alike, or all there is."""
    elsewhere = [path for path in _field_names(entry) if path.rpartition(".")[2] == name]
    near = elsewhere[::-1] or difflib.get_close_matches(name, names, n=3, cutoff=0.55)
    if near:
        return f"did you mean {' or '.join(map(repr, near[:3]))}?"
    return f"there is: {', '.join(map(repr, names))}"


def _field_names(holder: Mapping[str, Any]) -> list[str]:
    """Names of the single values of a horizon or a model, in depth: "models.ts.rmse"."""
    names = []
    for name, value in holder.items():
        if isinstance(value, Mapping):
            names += [f"{name}.{below}" for below in _field_names(value)]
        elif not isinstance(value, list):
            names.append(name)
    return names
