"""Words of a program for comments in code that is written of it: signals, past values, regressors."""

from __future__ import annotations

from collections.abc import Sequence

from flysid.dataset import Signal
from flysid.export.program import Place, Program
from flysid.export.programs import Member


def plain(text: str) -> str:
    """Text for a comment: names come from logs, and may hold what ends or begins one, or a trigraph."""
    text = "".join(c if c.isprintable() else "_" for c in text)
    for whole, apart in (("*/", "* /"), ("/*", "/ *"), ("??", "? ?"), ("`", "'"), ("\\", "/"), ('"', "'")):
        text = text.replace(whole, apart)
    return text


def name_with_unit(signal: Signal) -> str:
    """ "v_x, m/s"."""
    return plain(f"{signal.name}, {signal.unit}" if signal.unit else signal.name)


def past_with_unit(program: Program, column: int, lag: int) -> str:
    """ "v_x(k-1), m/s"."""
    unit = program.signals[column].unit
    return f"{value_name(program, (column, lag))}, {plain(unit) if unit else 'no unit'}"


def value_name(program: Program, place: Place) -> str:
    """What stands at a place: "1", "v_x(k-1)", "|v_x(k-1)| v_x(k-1)"."""
    column, lag = place
    if column < 0:
        return "1"
    if column < len(program.signals):
        return plain(
            f"{program.signals[column].name}(k-{lag})" if lag else f"{program.signals[column].name}(k)"
        )
    worked = program.worked[column - len(program.signals)]
    a = value_name(program, worked.a)
    if worked.operation == "magnitude":
        return f"|{a}|"
    if worked.operation == "sign":
        return f"sign({a})"
    if worked.operation == "held":
        return f"{a} inside its range"
    b = value_name(program, worked.b)
    return f"({a} - {b})" if worked.operation == "change" else f"{a} {b}"


def states_with_units(program: Program) -> list[str]:
    """Of every cell that one step leaves to the next, in the order of `Program.memory`."""
    return [past_with_unit(program, column, lag) for column, lag in program.memory]


def states_of(members: Sequence[Member]) -> list[str]:
    """`states_with_units` of all members, one behind another; of several, each says whose it is."""
    if len(members) == 1:
        return states_with_units(members[0].program)
    return [
        f"model {number}: {words}"
        for number, member in enumerate(members, 1)
        for words in states_with_units(member.program)
    ]


def title_of(members: Sequence[Member]) -> str:
    """What the model is: its program's title, or how many there are."""
    return members[0].program.title if len(members) == 1 else f"Mean of {len(members)} models"
