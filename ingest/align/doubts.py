"""Reasons in the data themselves not to trust any model of them, each with what to do about it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flysid.dataset import Dataset
from flysid.ingest.align.recipe import ChannelSpec
from flysid.ingest.excitation.enough import too_short_alone
from flysid.ingest.excitation.excitation import GOOD_COHERENCE, Excitation, excitation, is_narrow, spectrum
from flysid.ingest.excitation.share import Share, share_explained

REMARKS = ("holes", "band")


@dataclass(frozen=True)
class Doubt:
    """One reason.

    `kind`: "quiet", "slow", "short", "unexplained", "narrow", "holes", "pooled" or "band"; REMARKS are no
        faults. "kinematics" where instruments disagree (`flysid.ingest.kinematics`).
    `text`: what is the matter, no full stop.
    `todo`: what to log, to fly or to choose next time.
    """

    kind: str
    text: str
    todo: str

    def __str__(self) -> str:
        return f"{self.text}; {self.todo}" if self.todo else self.text


class BestInput(NamedTuple):
    """An output, the input that explains most of it, the share it explains, and the band in which it does.

    `below_hz` is the end of the band of the input, in which the share is.
    """

    output: str
    input: str
    share: Share
    below_hz: float
    band_hz: tuple[float, float] | None


def doubt_lines(found: Sequence[Doubt]) -> Iterator[str]:
    """Lines for the terminal during a fit: faults, and inputs of few values. The page shows the band."""
    for doubt in found:
        if doubt.kind != "band":
            yield f"{'remark' if doubt.kind in REMARKS else 'caution'}: {doubt}"


def doubts(data: Dataset, spec: ChannelSpec) -> tuple[Doubt, ...]:
    """All reasons to doubt models of a dataset, worst first; `spec` tells how fast its dynamics are."""
    moves = [excitation(data, i) for i in range(len(data.inputs))]
    best = [_best_input(data, j, moves) for j in range(len(data.outputs))]
    found = (
        _quiet(data, moves), _slow(data, spec), _short(data), _unexplained(best), _pooled(data), _holes(data),
        _band(best),
    )  # fmt: skip
    return tuple(itertools.chain.from_iterable(found))


def _quiet(data: Dataset, moves: Sequence[Excitation]) -> Iterator[Doubt]:
    for signal, own in zip(data.inputs, moves, strict=True):
        if own.quiet:
            yield Doubt(
                "quiet",
                f"input {signal.name} moves by {own.rms:.2g} {signal.unit} rms only, less than the noise "
                "of sensors of this unit: no model can be identified",
                "fly steps, doublets or a sweep",
            )


def _slow(data: Dataset, spec: ChannelSpec) -> Iterator[Doubt]:
    rate = 1.0 / data.dt_s
    if rate < 0.99 * spec.min_rate_hz:
        yield Doubt(
            "slow",
            f"{rate:.3g} Hz resolves dynamics up to {rate / 2:.2g} Hz only, this channel needs "
            f"{spec.min_rate_hz:.3g} Hz",
            spec.remedy or "log faster",
        )


def _short(data: Dataset) -> Iterator[Doubt]:
    seconds = len(data) * data.dt_s
    if len(data.flights) == 1 and (todo := too_short_alone(seconds)):
        words, _, remedy = todo.partition(": ")
        yield Doubt("short", words, remedy)


def _unexplained(best: Sequence[BestInput]) -> Iterator[Doubt]:
    for output, name, share, below_hz, band in best:
        if share.high < GOOD_COHERENCE:
            yield Doubt(
                "unexplained",
                f"{share.words} of the power of {output} below {below_hz:.2g} Hz follows {name}",
                "excite this axis alone, in calm air; or look for a missing input",
            )
        elif band is None and share.low == 0.0:
            yield Doubt(
                "unexplained",
                f"{output} is not shown to follow {name} at any frequency",
                "record longer, excite this axis alone, in calm air; or look for a missing input",
            )
        elif band is not None and is_narrow(band):
            yield Doubt(
                "narrow",
                f"{output} follows {name} {_between(*band)} only, less than an octave: an oscillation "
                "rather than a response",
                "excite this axis alone, in calm air",
            )


def _between(low_hz: float, high_hz: float) -> str:
    """ "from 4.8 to 5 Hz", or "at 5 Hz" where both are the same in words."""
    low, high = (f"{f:.2g}" for f in (low_hz, high_hz))
    return f"at {high} Hz" if low == high else f"from {low} to {high} Hz"


def vehicles_of(data: Dataset) -> list[str]:
    """The vehicles that a dataset is known to be of, each once."""
    return sorted({str(s.marks["vehicle"]) for s in data.segments if s.marks.get("vehicle")})


def _pooled(data: Dataset) -> Iterator[Doubt]:
    vehicles = vehicles_of(data)
    if len(vehicles) > 1:
        yield Doubt(
            "pooled",
            f"flights of {len(vehicles)} vehicles are pooled ({_few(vehicles)}): a model is their average",
            "--vehicle fits one of them; flysid compare sets two runs side by side",
        )


def _holes(data: Dataset, *, most_levels: int = 5) -> Iterator[Doubt]:
    """Of an input that takes at most `most_levels` values, what lies between them is not known."""
    for i, signal in enumerate(data.inputs):
        levels = np.unique(np.concatenate([s.u[:, i] for s in data.segments]))
        if 1 < len(levels) <= most_levels:
            values = ", ".join(f"{v:.3g}" for v in levels)
            yield Doubt(
                "holes",
                f"input {signal.name} takes {len(levels)} distinct values ({values} {signal.unit}".rstrip()
                + ")",
                "rules learn nothing between them: fly more levels, or a sweep",
            )


def _band(best: Sequence[BestInput]) -> Iterator[Doubt]:
    for output, name, _, _, band in best:
        if band is not None and not is_narrow(band):
            yield Doubt(
                "band",
                f"{output} follows {name} from {band[0]:.2g} to {band[1]:.2g} Hz",
                "do not trust a model of these data outside this band",
            )


def _best_input(data: Dataset, output: int, moves: Sequence[Excitation]) -> BestInput:
    """The input that explains most of an output."""
    shares = [share_explained(data, own, i, output) for i, own in enumerate(moves)]
    best = max(range(len(shares)), key=lambda i: shares[i].value)
    names = data.outputs[output].name, data.inputs[best].name
    return BestInput(*names, shares[best], moves[best].band_hz, spectrum(data, best, output).band_hz())


def _few(names: list[str], *, most: int = 4) -> str:
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")
