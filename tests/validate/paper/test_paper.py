"""The paper's tables as data, figure by figure, where the paper's text lies beside the repository."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flysid.validate.paper.printed import LOOPS, PaperLoop

PAPER = Path(__file__).resolve().parents[4] / "shared" / "paper"
FIGURE = r"([−-]?) ?(\d\.\d) · 10(?:e([+−-]\d?))?"


def printed(figure: re.Match[str]) -> float:
    """Of "−2.2 · 10e−2", which means -0.022; "10e+" is one."""
    sign, digits, power = figure.groups()
    exponent = int((power or "+").replace("−", "-").ljust(2, "0"))
    return float(f"{sign and '-'}{digits}e{exponent}")


@pytest.fixture(scope="module")
def text() -> str:
    found = sorted(PAPER.glob("*.txt"))
    if not found:
        pytest.skip("needs the paper's text in ../shared/paper")
    return found[0].read_text("utf-8")


@pytest.mark.parametrize("loop", LOOPS, ids=lambda loop: loop.name)
def test_rules_and_centres_are_those_of_the_tables(loop: PaperLoop, text: str) -> None:
    """Powers of the second table's first two columns are scattered over lines; the first table has them."""
    first, second = re.findall(r"\d", loop.tables)
    rules = text.partition(f"Table {first}:")[2]
    for number, rule in enumerate(loop.rules, 1):
        line = re.search(rf"{number}\.? If u Is A{number} Then y = {FIGURE} u ([+−-]) {FIGURE}", rules)
        assert line is not None
        gain, offset = re.finditer(FIGURE, line.group().replace("+ ", "").replace("− ", "−"))
        assert (rule.gain, rule.offset) == (printed(gain), printed(offset))
    centres = text.partition(f"Table {second}:")[2].partition("Centre of Cluster")[2]
    rows = list(re.finditer(FIGURE, centres))
    known = [rule.centre for rule in loop.rules if rule.centre is not None]
    assert known == [printed(row) for row in rows[2 : 3 * len(known) : 3]]
