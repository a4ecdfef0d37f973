"""What counts as a command that is advised."""

from __future__ import annotations

import re

import pytest

from tests.command import ROOT
from tests.doors.advice import commands_in

FOLDED = """\
pitch (1 flight): recorded in closed loop, which may bias a fit, and therefore; try: flysid tf
  flight.bin -r ardupilot-attitude
"""


@pytest.mark.parametrize(
    ("printed", "commands"),
    [
        ("next: flysid validate run", ["flysid validate run"]),
        (
            "next: two sets: flysid step a -r R --against b; take the larger",
            ["flysid step a -r R --against b"],
        ),
        ("  try:   'flysid ls data' lists its flights", ["flysid ls data"]),
        ("error: no flight\n  try:   'flysid tf' tells", []),
        ("run 'flysid ls data' if you like", []),
        (FOLDED, ["flysid tf flight.bin -r ardupilot-attitude"]),
    ],
)
def test_advice_is_read_as_a_user_reads_it(printed: str, commands: list[str]) -> None:
    assert commands_in(printed) == commands


def test_no_line_that_says_what_is_next_leaves_a_word_to_be_filled_in() -> None:
    files = [
        file for part in ("flysid", "ingest", "model", "validate") for file in (ROOT / part).rglob("*.py")
    ]
    told = [
        (file.name, line)
        for file in files
        for line in file.read_text("utf-8").splitlines()
        if "next: " in line
    ]
    assert len(told) > 5
    assert [(name, line) for name, line in told if re.search(r"flysid .*\b[A-Z]{3,}\b", line)] == []
