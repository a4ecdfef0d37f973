"""A review in lines: for a terminal, and as Markdown for a pull request."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flysid.escaping import markdown as escaped
from flysid.escaping import one_line
from flysid.reviews.fact import Action, Fact, Finding, Grade, Section, order
from flysid.reviews.reviewed import Review
from flysid.showing import counted, fold

MARKS = {Grade.GOOD: "+", Grade.PLAIN: " ", Grade.WATCH: "!", Grade.BAD: "!!"}
MOST_LINES = 25
SHARED = 3
"""Kinds of complaints that several logs share, on the terminal."""
SHOWN_FACTS = 4
"""Of a section on the terminal, where there is room; all of them stand on the page."""


def terminal_text(review: Review) -> str:
    """Whose log, the answer, what to do next, and as much of each section as 25 lines leave room for."""
    for most in range(SHOWN_FACTS, -1, -1):
        lines = [fold(one_line(line)) for line in _lines(review, most)]
        text = "\n".join(lines)
        if text.count("\n") < MOST_LINES:
            break
    return text


def _lines(review: Review, most: int) -> Iterator[str]:
    """The lines with so many facts of a section; the answer and what to do next are whole."""
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
    yield from filter(None, (_section_line(section, most) for section in review.sections))
    yield from (f"note: {sentence}" for sentence in review.broken)


def shared_findings(reviews: Sequence[Review]) -> list[str]:
    """What several logs complain of, one line a kind: how many do, and the gravest of them."""
    kinds: dict[str, list[Finding]] = {}
    for review in reviews:
        for finding in review.findings:
            if finding.grade.rank > Grade.PLAIN.rank:
                kinds.setdefault(finding.fact, []).append(finding)
    by_count = sorted(kinds.values(), key=lambda found: -len(found))[:SHARED]
    return [
        f"{MARKS[order(found)[0].grade]:2} {len(found)} of {len(reviews)} flights: {order(found)[0].text}"
        for found in by_count
    ]


def headline(review: Review) -> str:
    """A log in one line: its name and its first sentence."""
    first = review.findings[0]
    return f"{MARKS[first.grade]:2} {review.name}: {first.text}"


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


def _section_line(section: Section, most: int) -> str:
    """The facts that matter most of a section: bad ones first, then in their order."""
    known = [fact for fact in section.facts if fact.value is not None]
    unknown = len(section.facts) - len(known)
    shown = sorted(known, key=lambda fact: -max(fact.grade.rank, Grade.PLAIN.rank))[:most]
    texts = [f"{fact.label} {fact.words}" for fact in shown]
    if unknown and texts:
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
