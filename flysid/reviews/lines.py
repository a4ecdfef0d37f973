"""A review in lines: for a terminal, and as Markdown for a pull request."""

from __future__ import annotations

from collections.abc import Iterator

from flysid.escaping import markdown as escaped
from flysid.reviews.fact import Action, Fact, Grade, Section
from flysid.reviews.reviewed import Review
from flysid.showing import counted

MARKS = {Grade.GOOD: "+", Grade.PLAIN: " ", Grade.WATCH: "!", Grade.BAD: "!!"}
SHOWN_FACTS = 4
"""Of a section on the terminal; all of them stand on the page."""


def terminal_lines(review: Review) -> Iterator[str]:
    """Whose log, the answer, what to do next, and each section in a line: 25 lines of a terminal at most."""
    yield head(review)
    yield ""
    first, *rest = review.findings
    yield f"{first.text}.{_small(first.more)}"
    for finding in rest:
        yield f"  {MARKS[finding.grade]:2} {finding.text}{_small(finding.more)}"
    if review.actions:
        yield ""
        yield "Do next:"
        yield from (f"  {i}. {action_words(action)}" for i, action in enumerate(review.actions, 1))
    yield ""
    yield from filter(None, map(_section_line, review.sections))
    yield from (f"note: {sentence}" for sentence in review.broken)


def head(review: Review) -> str:
    """The log, its vehicle, how long it flew."""
    whose = ", ".join(
        review.info[key] for key in ("vehicle", "autopilot", "firmware") if review.info.get(key)
    )
    flown = review.fact("trust.flown")
    how_long = f"{flown.value:.0f} s in the air" if flown and isinstance(flown.value, float) else ""
    return "  ".join(part for part in (review.name, whose, how_long) if part)


def action_words(action: Action) -> str:
    """An action in one line: what, which parameters, what it brings, what it risks."""
    changes = ", ".join(change.words for change in action.changes)
    parts = [action.title + (f": {changes}" if changes else ""), capital(action.reason)]
    if action.predicted:
        parts.append(f"Predicted: {action.predicted}")
    if action.risk:
        parts.append(f"Risk: {action.risk}")
    return ". ".join(part.rstrip(".") for part in parts if part) + "."


def capital(sentence: str) -> str:
    """With a capital at its beginning."""
    return sentence[:1].upper() + sentence[1:]


def _section_line(section: Section) -> str:
    """The facts that matter most of a section: bad ones first, then in their order."""
    known = [fact for fact in section.facts if fact.value is not None]
    unknown = len(section.facts) - len(known)
    shown = sorted(known, key=lambda fact: -max(fact.grade.rank, Grade.PLAIN.rank))[:SHOWN_FACTS]
    texts = [f"{fact.label} {fact.words}" for fact in shown]
    if unknown:
        texts.append(f"{counted(unknown, 'figure')} not determined")
    return f"{section.title}: {', '.join(texts)}" if texts else ""


def _small(more: str) -> str:
    return f" ({more})" if more else ""


def markdown(review: Review) -> str:
    """Headline, findings, actions, and a table of every fact by section.

    What stands in a log cannot end a table's cell or start markup.
    """
    first, *rest = review.findings
    lines = [f"### {escaped(first.text)}", "", escaped(head(review)), ""]
    lines += [f"- {escaped(finding.text + _small(finding.more))}" for finding in rest]
    if review.actions:
        lines += ["", "**Do next**", ""]
        lines += [f"{i}. {escaped(action_words(action))}" for i, action in enumerate(review.actions, 1)]
    for section in review.sections:
        if section.facts:
            lines += ["", f"**{section.title}**", "", "| | | |", "|---|---|---|"]
            lines += [_row(fact) for fact in section.facts]
    return "\n".join([*lines, ""])


def _row(fact: Fact) -> str:
    aside = fact.remedy if fact.value is None else fact.note
    return f"| {escaped(fact.label)} | {escaped(fact.words)} | {escaped(aside)} |"
