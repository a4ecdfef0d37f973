"""What stands beside a result: an extra is tried, and where it breaks one sentence stands in its place.

A result is a fitted model, or a comparison with its verdict. Words, certificates, pictures, side checks and
histories are extras: none of them may take the result down. Each is made through `extra`, which catches what
breaks. Its sentence goes to whoever listens: the run that is fitted, the report that is
made, the terminal. Python code that nobody listens for gets a `MissingExtra` warning.

What is the result itself is never made through `extra`: it raises.

>>> missing = Missing()
>>> with missing.gathering():
...     extra(Extra.CERTIFICATE, lambda: 1 / 0, None, of="ts on roll")
>>> print(*missing.sentences)
The stability certificate of ts on roll could not be given: an internal computation failed \
(ZeroDivisionError: division by zero).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import Enum
from typing import TypeVar

from flysid.errors import FlysidError, WriteError

T = TypeVar("T")
D = TypeVar("D")


class Extra(Enum):
    """Every extra that there is, as its sentence names it."""

    # beside logs
    SUGGESTION = "the suggestion"
    # beside a fit
    DOUBTS = "the doubts about the data"
    INSTRUMENTS = "the comparison of the instruments"
    LOOP = "the test for a closed loop"
    NONLINEARITY = "the share that no linear model explains"
    BEYOND = "the note on the band that the flights explain"
    MODEL_TEXT = "the file that explains the model in words"
    TRANSFER_TEXT = "the transfer functions in words"
    GAIN_SETS = "the note on the logged gains"
    # of a model of rules
    CONDITION = "the condition in words"
    CONCLUSION = "the equation in words"
    PUSH = "the meaning of the constant"
    MEANING = "the meaning of the rules"
    BEHAVIOUR = "the behaviour in sentences"
    OPERATING_POINTS = "the behaviour at rest"
    INTERVALS_AT_REST = "the intervals of the behaviour at rest"
    # side checks of a comparison
    GAINS = "the meaning of the logged gains"
    FLIGHTS = "the facts about the flights"
    DIAGNOSIS = "the diagnosis"
    WHITENESS = "the whiteness of the residuals"
    DEPENDENCE = "the dependence of the error on the inputs"
    RESPONSES = "the measured frequency responses"
    OUTSIDE = "the share outside the training range"
    POLES = "the largest pole radius"
    RULE_USE = "the use of the rules"
    NEARNESS = "the distance to the training samples"
    ROBUSTNESS = "the long free run"
    CONDITIONING = "the condition of the regressors"
    INTERVALS = "the intervals of the parameters"
    CERTIFICATE = "the stability certificate"
    SIMPLER = "the price of simpler rules"
    CAUTIONS = "a caution"
    PHYSICS = "the physical parameters in words"
    DIAGNOSIS_NUMBERS = "the diagnosis in numbers"
    # the page and its pictures
    PAGE = "the page with its pictures"
    MASTHEAD = "the head of the page"
    TELLING = "the picture of the ten seconds that differ most"
    ANSWER = "the answer to a step in words"
    INTERVAL_BAR = "the picture of the interval"
    STRIPS = "the picture of the free runs"
    BANDS = "the bands of the free runs"
    CURVES = "the curve of the frequency response"
    PANEL = "the panel"
    RULE_TABLE = "the table of the rules"
    RULE_KEY = "the key to the rules"
    CHECK_TABLE = "the table of checks"
    COEFFICIENTS = "the table of coefficients"
    LOOP_PANELS = "the panels of the loops"
    FIGURES = "the figures for a paper"
    PLOT = "the plot"
    LOOP_FIGURES = "the figures of the closed loop"
    # of a review
    REVIEWED = "the section"
    REVIEW_PICTURE = "the picture of the section"
    SERIES = "the comparison of the flights"
    # beside what is printed
    MEASURED = "the measured response in figures"
    FIT_SHARE = "the share that the free run explains"
    STAMPS = "what the stamps leave open of the delay"
    WHOSE = "whose the measured response is"
    SETS_TABLE = "the table of the sets of gains"
    RULE_TABLES = "the tables of rules"
    # histories
    REMEMBERED = "the copy of the report in the run"
    INDEX = "the index of the runs"
    # of a fleet
    GROUP_RESPONSE = "the frequency response"
    SCATTER = "the scatter between flights"
    # the studio's views
    RUN_LISTED = "the run's row"
    WORST = "the second of the largest error"
    EXPLAINED = "the reasons of the rules"
    RECURSION = "what the page computes a free run from"
    VOICES = "the voices of the rules"


class MissingExtra(UserWarning):
    """An extra could not be given; the result is not affected."""


Listener = Callable[[str], None]
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def extra(which: Extra, make: Callable[[], T], instead: D, of: str = "") -> T | D:
    """What `make` gives; where it breaks `instead`, and one sentence to whoever listens.

    No warning of NumPy or SciPy about its numbers reaches the screen. Memory that is short and a disk that
    refuses are no fault of the extra, and raise.

    `of`: what it is of, for the sentence: "ts on roll".
    Raises MemoryError, WriteError: as above.

    >>> extra(Extra.PLOT, lambda: "drawn", "")
    'drawn'
    """
    try:
        return attempt(which, make)
    except (MemoryError, WriteError):
        raise
    except Exception as error:  # noqa: BLE001 - whatever breaks, the result does not
        _say(sentence(which, error, of))
        return instead


def attempt(which: Extra, make: Callable[[], T]) -> T:  # noqa: ARG001 - tests break one of them here
    """The extra itself, its numbers' warnings left aside."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # LinAlgWarning is one
        return make()


def sentence(which: Extra, error: Exception, of: str = "") -> str:
    """ "The plot of roll could not be given: CAUSE."

    >>> sentence(Extra.PLOT, FlysidError("no band", hint="fly longer"), "roll")
    'The plot of roll could not be given: no band; try: fly longer.'
    """
    if isinstance(error, FlysidError):
        cause = error.advice
    else:
        what = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
        cause = f"an internal computation failed ({what})"
    name = f"{which.value} of {of}" if of else which.value
    return f"{name[0].upper()}{name[1:]} could not be given: {cause.removesuffix('.')}."


def _say(words: str) -> None:
    listener = _listener.get()
    if listener is None:
        warnings.warn(words, MissingExtra, stacklevel=3)
    else:
        listener(words)


@contextmanager
def hearing(listener: Listener) -> Iterator[None]:
    """Hand every sentence about an extra that breaks in the block to `listener`, and to no other."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


class Missing:
    """Sentences about extras that could not be given, each once, in the order in which they came."""

    def __init__(self, *sentences: str) -> None:
        self._sentences = dict.fromkeys(sentences)

    @property
    def sentences(self) -> tuple[str, ...]:
        """All of them so far."""
        return tuple(self._sentences)

    def to_dict(self) -> dict[str, list[str]]:
        """{"missing": [...]}, for a JSON document; {} where nothing is."""
        return {"missing": list(self._sentences)} if self._sentences else {}

    @contextmanager
    def gathering(self) -> Iterator[None]:
        """Keep what breaks in the block."""
        with hearing(lambda words: self._sentences.update({words: None})):
            yield
