"""The sections of a review in the order of the page, one row each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module

from flysid.reviews.fact import Section
from flysid.reviews.logged import LoggedFlight

Reviewer = Callable[[LoggedFlight], Section]
SECTIONS: Mapping[str, str] = {
    "tracking": "flysid.reviews.tracking",
    "vibration": "flysid.reviews.vibration",
    "power": "flysid.reviews.power",
    "estimator": "flysid.reviews.estimator",
    "happened": "flysid.reviews.happened",
    "trust": "flysid.reviews.trust",
}
"""Key of a section -> the module whose `review` computes it."""


def load_sections() -> None:
    """Import what the sections need: while another process reads the log, it costs no time."""
    for module in SECTIONS.values():
        import_module(module)


def section_of(key: str) -> Reviewer:
    """The function that computes a section."""
    review: Reviewer = import_module(SECTIONS[key]).review
    return review
