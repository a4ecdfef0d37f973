"""The part of MATLAB that a saved linear model is written in, read without running it.

Assignments of literals and constructor calls, one behind another:

    A = [1, -0.97];
    sys = idpoly(A, [0, 0.02], [], [], [], [], 0.02);
    sys.InputName = {'theta_in'};
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from flysid.errors import FormatError

TOKEN = re.compile(
    r"""(?P<space>[ \t\r]+|\.\.\.[^\n]*\n)
      |(?P<comment>%[^\n]*)
      |(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
      |(?P<name>[A-Za-z]\w*(?:\.[A-Za-z]\w*)?)
      |(?P<text>"(?:[^"\n]|"")*")
      |(?P<end>[\n;])
      |(?P<mark>[-+*/^=,()\[\]{}'])""",
    re.VERBOSE,
)
QUOTED = re.compile(r"'(?:[^'\n]|'')*'")
HINT = (
    "write the model as literals: sys = idpoly(A, B, C, D, F, [], Ts), idss(A, B, C, D, K, 'Ts', Ts), "
    "idtf(num, den, Ts), ss, tf or filt; or save it as .mat"
)
VALUE_ENDS = ("number", "name", "text")
CLOSING = {"[": "]", "{": "}"}
SIGNS: Mapping[str, float] = {"+": 1.0, "-": -1.0}


@dataclass(frozen=True)
class Token:
    """A word of the text, where it stands, and whether a space stands before it."""

    kind: str
    text: str
    line: int
    apart: bool


@dataclass(frozen=True)
class Call:
    """A constructor with its arguments: idpoly(...), ss(...)."""

    name: str
    arguments: tuple[Any, ...]
    properties: Mapping[str, Any] = field(default_factory=dict)


def read_matlab_text(text: str) -> dict[str, Any]:
    """Name -> array, text, list of lists (a cell) or `Call`, in the order of assignment.

    Raises FormatError: anything but literals, and calls of them; it names the line.
    """
    return _Reader(_tokens(text)).statements()


def _tokens(text: str) -> list[Token]:
    found: list[Token] = []
    at = 0
    line = 1
    apart = False
    while at < len(text):
        quoted = text[at] == "'" and not (found and not apart and _ends_a_value(found[-1]))
        match = (QUOTED if quoted else TOKEN).match(text, at)
        if match is None:
            raise FormatError(f"line {line}: {text[at : at + 20]!r} is not understood", hint=HINT)
        kind = "text" if quoted else str(match.lastgroup)
        if kind not in ("space", "comment"):
            found.append(Token(kind, match[0], line, apart))
        apart = kind == "space"
        line += match[0].count("\n")
        at = match.end()
    return [*found, Token("end", "\n", line, False)]


def _ends_a_value(token: Token) -> bool:
    """Whether an apostrophe right behind it transposes."""
    return token.kind in VALUE_ENDS or token.text in ")]}'"


class _Reader:
    """Reads the statements one after another; knows what was assigned before."""

    def __init__(self, tokens: Sequence[Token]) -> None:
        self._tokens = tokens
        self._at = 0
        self._known: dict[str, Any] = {}

    def statements(self) -> dict[str, Any]:
        while self._at < len(self._tokens):
            token = self._tokens[self._at]
            if token.kind == "end" or token.text == ",":
                self._at += 1
            elif token.text in ("function", "end", "return", "clear", "clc"):
                self._skip_line()
            else:
                self._assignment()
        return self._known

    def _skip_line(self) -> None:
        while self._tokens[self._at].kind != "end":
            self._at += 1

    def _assignment(self) -> None:
        target = self._take("name")
        self._take_mark("=")
        value = self._sum()
        if self._tokens[self._at].kind != "end" and self._tokens[self._at].text != ",":
            self._fail(self._tokens[self._at])
        owner, _, prop = target.text.partition(".")
        if not prop:
            self._known[owner] = value
            return
        made = self._known.get(owner)
        if not isinstance(made, Call):
            self._fail(target)
        self._known[owner] = Call(made.name, made.arguments, {**made.properties, prop: value})

    # -- expressions -------------------------------------------------------------------------------------

    def _sum(self, *, cell: bool = False) -> Any:
        """Terms; inside brackets "1 -2" are two elements."""
        value = self._product()
        while (token := self._tokens[self._at]).text in ("+", "-"):
            after = self._tokens[self._at + 1]
            if cell and token.apart and not after.apart:
                break
            self._at += 1
            value = self._number(value, token) + SIGNS[token.text] * self._number(self._product(), token)
        return value

    def _product(self) -> Any:
        value = self._sign()
        while (token := self._tokens[self._at]).text in ("*", "/", "^"):
            self._at += 1
            left = self._number(value, token)
            right = self._number(self._sign(), token)
            with np.errstate(all="ignore"):
                value = {"*": np.multiply, "/": np.divide, "^": np.power}[token.text](left, right)
        return value

    def _sign(self) -> Any:
        token = self._tokens[self._at]
        if token.text in SIGNS:
            self._at += 1
            return SIGNS[token.text] * self._number(self._sign(), token)
        return self._transpose(self._value())

    def _transpose(self, value: Any) -> Any:
        while (token := self._tokens[self._at]).text == "'" and token.kind == "mark":
            self._at += 1
            value = np.atleast_2d(self._number(value, token)).T
        return value

    def _value(self) -> Any:
        token = self._next()
        if token.kind == "number":
            return np.array(float(token.text))
        if token.kind == "text":
            return token.text[1:-1].replace(token.text[0] * 2, token.text[0])
        if token.text in CLOSING:
            rows = self._rows(CLOSING[token.text])
            return rows if token.text == "{" else self._matrix(rows, token)
        if token.text == "(":
            value = self._sum()
            self._take_mark(")")
            return value
        if token.kind != "name":
            self._fail(token)
        if self._tokens[self._at].text == "(":
            return self._call(token)
        constants = {"Inf": np.array(np.inf), "inf": np.array(np.inf), "pi": np.array(np.pi)}
        if token.text in self._known or token.text in constants:
            return (constants | self._known)[token.text]
        return self._fail(token)

    def _rows(self, closing: str) -> list[list[Any]]:
        rows: list[list[Any]] = [[]]
        while (token := self._tokens[self._at]).text != closing:
            if token.kind == "end":
                if self._at == len(self._tokens) - 1:
                    self._fail(token)
                rows.append([])
                self._at += 1
            elif token.text == ",":
                self._at += 1
            else:
                rows[-1].append(self._sum(cell=True))
        self._at += 1
        return [row for row in rows if row]

    def _matrix(self, rows: list[list[Any]], token: Token) -> Any:
        if rows and all(isinstance(v, str) for row in rows for v in row):
            return "".join(v for row in rows for v in row)
        try:
            blocks = [[np.atleast_2d(self._number(v, token)) for v in row] for row in rows]
            return np.block(blocks) if blocks else np.zeros((0, 0))
        except ValueError:
            return self._fail(token)

    def _call(self, name: Token) -> Any:
        self._take_mark("(")
        arguments: list[Any] = []
        while self._tokens[self._at].text != ")":
            if arguments:
                self._take_mark(",")
            arguments.append(self._sum())
        self._at += 1
        plain: dict[str, Callable[..., Any]] = {"zeros": np.zeros, "ones": np.ones, "eye": np.eye}
        if name.text in plain:
            sizes = [int(self._number(a, name)) for a in arguments]
            if not sizes or max(sizes) > 1000 or min(sizes) < 0:
                self._fail(name)
            shape = sizes * 2 if len(sizes) == 1 else sizes[:2]
            return plain[name.text](*(shape if name.text == "eye" else (shape,)))
        first = next((i for i, a in enumerate(arguments) if isinstance(a, str)), len(arguments))
        pairs = arguments[first:]
        if len(pairs) % 2 or not all(isinstance(key, str) for key in pairs[::2]):
            self._fail(name)
        return Call(
            name.text, tuple(arguments[:first]), dict(zip(map(str, pairs[::2]), pairs[1::2], strict=True))
        )

    # -- words -------------------------------------------------------------------------------------------

    def _number(self, value: Any, token: Token) -> Any:
        return value if isinstance(value, np.ndarray | np.generic) else self._fail(token)

    def _next(self) -> Token:
        token = self._tokens[self._at]
        if token.kind == "end":
            self._fail(token)
        self._at += 1
        return token

    def _take(self, kind: str) -> Token:
        token = self._next()
        return token if token.kind == kind else self._fail(token)

    def _take_mark(self, text: str) -> None:
        token = self._next()
        if token.text != text:
            self._fail(token)

    def _fail(self, token: Token) -> NoReturn:
        fault = "the statement ends early" if token.kind == "end" else f"{token.text!r} is not understood"
        raise FormatError(f"line {token.line}: {fault}", hint=HINT)
