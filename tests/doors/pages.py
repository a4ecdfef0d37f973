"""What a page prints: command lines, and what they answer."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pytest

from tests.command import ROOT

PAGES = sorted(
    str(path.relative_to(ROOT))
    for path in (ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("docs/tutorials/*.md"))
    if re.search(r"^\$ ", path.read_text("utf-8"), re.MULTILINE)
)
_FENCE = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_INDENTED = re.compile(r"^    (flysid .*)$", re.MULTILINE)
_RULE = re.compile("-{3,}")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_ADDRESS = re.compile(r":\d+/\?token=\S+")


@dataclass(frozen=True)
class Line:
    """A command line as it stands on the page, and the lines that the page prints below it."""

    text: str
    answer: tuple[str, ...] = ()

    @property
    def command(self) -> str:
        """Without what the page remarks behind it."""
        return re.sub(r"\s+# .*", "", self.text)


def read(page: str) -> str:
    """The text of a page."""
    return (ROOT / page).read_text("utf-8")


def lines_of(page: str) -> list[Line]:
    """The command lines of a page, in its order: those of console blocks, and those set in by four blanks."""
    text = read(page)
    found = [(m.start(), list(_console(m[2]))) for m in _FENCE.finditer(text) if m[1] == "console"]
    prose = _FENCE.sub(lambda m: re.sub(r"[^\n]", "x", m[0]), text)
    found += [(m.start(), [Line(m[1])]) for m in _INDENTED.finditer(prose)]
    return [line for _, lines in sorted(found) for line in lines]


def scripts_of(page: str) -> list[str]:
    """The Python blocks of a page."""
    return [m[2] for m in _FENCE.finditer(read(page)) if m[1] == "python"]


def answers_of(page: str) -> list[tuple[str, ...]]:
    """The blocks without a language: what a page shows of a command's output apart from the command."""
    return [tuple(m[2].splitlines()) for m in _FENCE.finditer(read(page)) if not m[1]]


def _console(block: str) -> Iterator[Line]:
    command = ""
    answer: list[str] = []
    for line in block.splitlines():
        if line.startswith("$ "):
            if command:
                yield Line(command, tuple(answer))
            command = line[2:]
            answer = []
        else:
            answer.append(line)
    yield Line(command, tuple(answer))


def check_answer(line: Line, shown: Sequence[str]) -> None:
    """What was printed is as the page prints it, from its first line on; three dots leave lines out."""
    parts = re.split(r"^\.\.\.$", "\n".join(line.answer), flags=re.MULTILINE)
    rest = list(shown)
    for part in parts:
        block = part.strip("\n").splitlines()
        start = place_of(block, rest)
        assert start is not None, f"{line.text}\nnot found:\n{part}\namong:\n" + "\n".join(rest)
        assert start == 0 or part is not parts[0], f"{line.text}\nnot at the beginning:\n{part}"
        rest = rest[start + len(block) :]


def place_of(block: Sequence[str], shown: Sequence[str]) -> int | None:
    """Where the lines of a block stand in what was shown, one below the other."""
    starts = range(len(shown) - len(block) + 1)
    return next((n for n in starts if all(map(alike, shown[n : n + len(block)], block))), None)


def alike(shown: str, told: str) -> bool:
    """The same words, and numbers within a tenth: last bits, and so widths, depend on the machine."""
    shown, told = (_ADDRESS.sub("", _RULE.sub("---", text)) for text in (shown, told))
    if _NUMBER.sub("#", shown).split() != _NUMBER.sub("#", told).split():
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(told), strict=True)
    return all(float(a) == pytest.approx(float(b), rel=0.1) for a, b in pairs)
