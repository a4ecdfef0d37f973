"""A review as a document: JSON, with every fact by its key."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from flysid.version import __version__

if TYPE_CHECKING:
    from flysid.reviews.review import Review

FORMAT = "flysid-review"
VERSION = 1


def to_dict(review: Review) -> dict[str, Any]:
    """The document of one log: `sections.power.facts` holds "hover_throttle" and so on."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "flysid": __version__,
        "log": review.name,
        "vehicle": dict(review.info),
        "clock": review.clock.words,
        "findings": [finding.to_dict() for finding in review.findings],
        "actions": [action.to_dict() for action in review.actions],
        "sections": {
            section.key: {
                "title": section.title,
                "facts": {fact.key.partition(".")[2]: fact.to_dict() for fact in section.facts},
                "findings": [finding.to_dict() for finding in section.findings],
                "actions": [action.to_dict() for action in section.actions],
            }
            for section in review.sections
        },
        "broken": list(review.broken),
    }
