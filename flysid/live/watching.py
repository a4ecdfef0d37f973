"""Compare a stream of samples with a run's models, and raise an alarm when the vehicle behaves otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.errors import DataError, UsageError
from flysid.live.causes import likely, likely_of_effort, meaning_of, visibility
from flysid.live.traces import Trace
from flysid.model.base import Fitted
from flysid.model.in_pieces import in_pieces
from flysid.validate.diagnose.detect import (
    DETECTORS,
    GLR_S,
    LEVEL_EVERY_S,
    LEVEL_S,
    Sums,
    Thresholds,
    calibrate,
    level_at_end,
    run_at_end,
    run_samples,
    shortest_run,
)
from flysid.validate.runs.run import HeldOut

# An alarm ends when all statistics were below half their thresholds for so long; what was outside is judged
# again when it was inside for so long.
OVER_S = 5.0


@dataclass(frozen=True)
class Notice:
    """Something to say about a channel.

    `kind`: "alarm", "over" (an alarm ended), "outside" (an input outside what the model knows), "inside".
    `time_s`: vehicle time.
    `detector`, `statistic`, `threshold`: of an alarm.
    `since_s`: since when, by the CUSUM.
    `shift`: mean of measured less expected since then, in `unit`; `share` of the output's usual size.
    `text`: all of it in words.
    """

    kind: str
    channel: str
    output: str
    time_s: float
    flight: str = ""
    detector: str = ""
    statistic: float = 0.0
    threshold: float = 0.0
    since_s: float = 0.0
    shift: float = 0.0
    share: float = 0.0
    unit: str = ""
    text: str = ""

    def to_dict(self) -> dict[str, Any]:
        """As JSON types."""
        return asdict(self)


@dataclass
class _Output:
    """The detectors of one output."""

    thresholds: Thresholds
    sums: Sums
    level: float = 0.0
    level_before: float = 0.0
    alarmed: bool = False
    quiet: int = 0


@dataclass
class ChannelWatch:
    """Watches one channel with one model.

    `name`: the channel.
    `model`: predicts one step ahead and runs freely.
    `thresholds`: one per output (`flysid.validate.diagnose.detect.calibrate`).
    `known`: (2, n_u) lowest and highest inputs that are judged (`known_inputs`).
    `trace`: keeps what was seen, for a page; None where nobody looks.
    """

    name: str
    model: Fitted
    thresholds: tuple[Thresholds, ...]
    known: FloatArray
    trace: Trace | None = None
    latest: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        longest = round(GLR_S / self.model.dt_s)
        self._outputs = [_Output(t, Sums(t.drift, longest)) for t in self.thresholds]
        self._meanings = [meaning_of(o, self.model.inputs) for o in self.model.outputs]
        self._keep = run_samples(self.model)
        self.restart()

    def restart(self) -> None:
        """The next samples do not follow on those before."""
        self._ahead = in_pieces(self.model)
        self._u = np.empty((0, len(self.model.inputs)))
        self._y = np.empty((0, len(self.model.outputs)))
        self._seen = 0
        self._clean = 0  # samples since an input was last outside
        self._outside = False
        self._next_level = shortest_run(self.model)
        for output in self._outputs:
            output.sums.forget()
            output.level = output.level_before = 0.0
            output.alarmed = False

    @property
    def is_outside(self) -> bool:
        """Whether an input is outside what the model knows, so that nothing is judged."""
        return self._outside

    @property
    def visibility(self) -> list[str]:
        """What this channel can show, a line for each output."""
        return [visibility(self.name, o, self.model.inputs) for o in self.model.outputs]

    def run(self, segment: Segment) -> list[Notice]:
        """All events of a segment."""
        self.restart()
        step = max(1, round(LEVEL_EVERY_S / self.model.dt_s))
        events = []
        for k in range(0, len(segment), step):
            time_s = segment.t0_ns * 1e-9 + k * self.model.dt_s
            events += self.feed(segment.u[k : k + step], segment.y[k : k + step], time_s, segment.flight)
        return events

    def feed(self, u: FloatArray, y: FloatArray, time_s: float, flight: str = "") -> list[Notice]:
        """Events of the next samples; `time_s` is that of the first."""
        self._u = np.concatenate([self._u[-self._keep :], u])
        self._y = np.concatenate([self._y[-self._keep :], y])
        errors = np.nan_to_num(y - self._ahead.feed(u, y))
        if self.trace is not None:
            self.trace.add(time_s, self.model.dt_s, y, y - errors)
        self._seen += len(u)
        was_outside = self._outside
        events = self._judge_inputs(u, time_s, flight)
        if self._outside:  # and after it, for the past that a prediction rests on is outside as well
            errors[0 if was_outside else self._first_outside(u) :] = 0.0
        for output in self._outputs:
            output.level_before = output.level
        self._judge_level()
        for j, output in enumerate(self._outputs):
            stats, since = output.sums.feed(errors[:, j] / output.thresholds.sigma)
            events += self._judge(j, stats, since, errors[:, j], time_s, flight)
        return events

    def _judge_inputs(self, u: FloatArray, time_s: float, flight: str) -> list[Notice]:
        """Whether the inputs are those that the model has seen; where not, nothing is judged."""
        outside = (u < self.known[0]) | (u > self.known[1])
        self._clean = 0 if outside.any() else self._clean + len(u)
        if self._outside and self._clean * self.model.dt_s >= OVER_S:
            self._outside = False
            return [Notice("inside", self.name, "", time_s, flight, text=f"{self.name} is judged again")]
        if self._outside or not outside.any():
            return []
        self._outside = True
        row, k = np.argwhere(outside)[0]
        signal = self.model.inputs[k]
        low = self.known[0, k]
        high = self.known[1, k]
        text = (
            f"{self.name} is outside what the model knows: {signal.name} {u[row, k]:.3g} {signal.unit}, "
            f"known {low:.3g} to {high:.3g}; not judged meanwhile"
        )
        causes = likely_of_effort(signal, self._meanings[0], u[row, k] - high)
        if causes:
            text += f". Where it lasts, likely: {causes}"
        return [Notice("outside", self.name, "", time_s + float(row) * self.model.dt_s, flight, text=text)]

    def _first_outside(self, u: FloatArray) -> int:
        """The first row in which an input is outside."""
        return int(np.argmax(((u < self.known[0]) | (u > self.known[1])).any(axis=1)))

    def _judge_level(self) -> None:
        """A free run now and then, where its whole stretch is known."""
        if self._seen < self._next_level:
            return
        self._next_level = self._seen + max(1, round(LEVEL_EVERY_S / self.model.dt_s))
        clean = self._clean >= min(self._seen, self._keep)
        level = np.zeros(len(self._outputs))
        if clean or self.trace is not None:
            free = run_at_end(self.model, self._u, self._y)
            if self.trace is not None:
                self.trace.add_run(free)
            if clean:
                level = level_at_end(self.model, self._y, free)[0]
        for j, output in enumerate(self._outputs):
            output.level = float(level[j])

    def _judge(
        self, j: int, stats: FloatArray, since: Any, errors: FloatArray, time_s: float, flight: str
    ) -> list[Notice]:
        """An alarm where a statistic passes its threshold, and its end."""
        output = self._outputs[j]
        signal = self.model.outputs[j]
        limits = output.thresholds
        ratios = np.empty((len(stats), len(DETECTORS)))
        ratios[:, 0] = np.abs(stats[:, 0]) / limits.cusum
        ratios[:, 1] = stats[:, 1] / limits.glr
        ratios[:, 2] = abs(output.level_before) / limits.level
        ratios[-1, 2] = abs(output.level) / limits.level  # known when the last of these samples is
        self.latest[signal.name] = float(ratios[-1].max())
        if output.alarmed:
            return self._judge_end(output, signal.name, ratios, time_s, flight)
        over = (ratios > 1.0).any(axis=1)
        if not over.any():
            return []
        k = int(np.argmax(over))
        which = int(np.argmax(ratios[k]))
        values = (abs(float(stats[k, 0])), float(stats[k, 1]), abs(output.level))
        bounds = (limits.cusum, limits.glr, limits.level)
        output.alarmed = True
        output.quiet = 0
        shift = self._shift(j, errors, int(since[k]), which)
        at = time_s + k * self.model.dt_s
        began = at - (LEVEL_S if which == 2 else since[k] * self.model.dt_s)
        event = Notice(
            "alarm", self.name, signal.name, at, flight, DETECTORS[which], values[which], bounds[which],
            float(began), shift, shift / limits.typical if limits.typical else 0.0, self._unit(j),
        )  # fmt: skip
        return [Notice(**{**event.to_dict(), "text": self._sentence(event, j)})]

    def _judge_end(
        self, output: _Output, name: str, ratios: FloatArray, time_s: float, flight: str
    ) -> list[Notice]:
        output.quiet = output.quiet + len(ratios) if (ratios < 0.5).all() else 0
        if output.quiet * self.model.dt_s < OVER_S:
            if (ratios[-1] > 2.0).any():
                output.sums.forget()  # what is known need not be summed up: it would take as long to forget
            return []
        output.alarmed = False
        return [Notice("over", self.name, name, time_s, flight, text=f"{name} is back in its band")]

    def _shift(self, j: int, errors: FloatArray, since: int, which: int) -> float:
        """How far the output is from where the model expects it: by the free run, else by one-step errors."""
        if self._meanings[j].kind == "turning":
            return float(errors[-max(1, since) :].mean()) / self.model.dt_s
        if which == 2:
            return self._outputs[j].level
        n = min(self._keep, len(self._u))
        if n > self.model.n_init + max(2, since):
            start = max(n - self._keep, n - since - self.model.n_init - round(1.0 / self.model.dt_s))
            u = self._u[-n:][start:]
            y = self._y[-n:][start:]
            apart = (y - self.model.simulate(u, y[: self.model.n_init]))[-max(1, since) :, j]
            return float(apart.mean())
        return float(errors[-max(1, since) :].mean())

    def _unit(self, j: int) -> str:
        """Of the shift: what turns is off by an acceleration, for its free run knows no level."""
        unit = self.model.outputs[j].unit
        return f"{unit} per s" if self._meanings[j].kind == "turning" else unit

    def _sentence(self, event: Notice, j: int) -> str:
        signal = self.model.outputs[j]
        inputs = ", ".join(s.name for s in self.model.inputs)
        meaning = self._meanings[j]
        size = f"{event.shift:+.3g} {event.unit}".rstrip()
        if meaning.kind == "effort" and event.share:
            size = f"{100 * event.share:+.0f} %"
        return (
            f"{signal.name} <- {inputs} left its band: {size} for {event.time_s - event.since_s:.1f} s "
            f"({event.detector} {event.statistic:.3g}, threshold {event.threshold:.3g}). "
            f"Likely: {likely(meaning, event.shift)}."
        )


def watch_of(held: HeldOut, label: str | None, false_alarms_1_h: float) -> ChannelWatch:
    """The watch of a run's channel: thresholds from its held-out flights.

    `label`: of the model; the channel's baseline when None.
    `false_alarms_1_h`: an hour, for this channel.
    Raises UsageError: no such model. Raises DataError: too little held-out flight.
    """
    label = label or held.channel.baseline
    if label not in held.models:
        raise UsageError(f"channel {held.channel.name!r} has no model {label!r}", hint=", ".join(held.models))
    model = held.models[label]
    share = false_alarms_1_h / (len(DETECTORS) * len(model.outputs))
    known = known_inputs(held.train.segments)
    return ChannelWatch(held.channel.name, model, calibrate(model, held.test.segments, share), known)


def known_inputs(training: Sequence[Segment], *, margin: float = 0.1) -> FloatArray:
    """(2, n_u) the inputs of the training flights, a tenth of their span added at both ends."""
    u = np.concatenate([segment.u for segment in training])
    low = u.min(axis=0)
    high = u.max(axis=0)
    return np.stack([low - margin * (high - low), high + margin * (high - low)])


def watches_of(
    held: Sequence[HeldOut], label: str | None, false_alarms_1_h: float
) -> tuple[list[ChannelWatch], dict[str, str]]:
    """Watches of a run's channels, effort first, and why others cannot be watched.

    The false alarms an hour are the vehicle's: channels and detectors share them.
    """
    found = []
    skipped = {}
    for one in held:
        try:
            found.append(watch_of(one, label, false_alarms_1_h / len(held)))
        except (DataError, UsageError) as error:
            skipped[one.channel.name] = error.advice
    order = {
        id(w): all(not meaning_of(o, w.model.inputs).shows_what_stays for o in w.model.outputs) for w in found
    }
    return sorted(found, key=lambda w: order[id(w)]), skipped
