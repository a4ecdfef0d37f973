"""Dead times of a dataset's pairs, in words and as the delays that the model stage tries besides its own.

They are estimated on the data they are given: give the training part, so that nothing of the held-out part
leaks into a model. Where several inputs act at once and move alike (rotor speeds), the dead time of one
pair means little; with more than two inputs none is handed over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.ingest.excitation.delay import Delay, estimate_delay
from flysid.ingest.excitation.excitation import spectrum

LONGEST_S = 0.5
LATE = 2  # samples: the hold's own is 1


@dataclass(frozen=True)
class DeadTime:
    """The dead time of one pair of signals.

    `input`, `output`: names; `column` is the input's number.
    `delay`: what was estimated; None where it cannot be.
    `dt_s`: sample time.
    `reason`: why there is none, or why it is not handed over; '' where it is.
    """

    input: str
    output: str
    column: int
    dt_s: float
    delay: Delay | None
    reason: str = ""

    @property
    def words(self) -> str:
        """One sentence for people."""
        pair = f"dead time {self.input} -> {self.output}"
        if self.delay is None:
            return f"{pair}: not used, {self.reason}"
        low = 1e3 * self.delay.low_s
        high = 1e3 * self.delay.high_s
        found = f"{pair}: {1e3 * self.delay.delay_s:.0f} ms [{low:.0f}, {high:.0f}]"
        if self.reason:
            return f"{found}, not used: {self.reason}"
        floor = f", and rules none below {self.least}" if self.least else ""
        if self.delay.nk < LATE:
            return f"{found}: within the delays that every model tries"
        return f"{found}; the models also try nk = {self.delay.nk}{floor}"

    @property
    def least(self) -> int:
        """Samples before which the log shows no answer, certainly; 0 where that is not certain."""
        if self.delay is None or self.reason or self.delay.feedback:
            return 0
        return round(self.delay.low_s / self.dt_s)


def dead_times(data: Dataset, *, most_inputs: int = 2) -> tuple[DeadTime, ...]:
    """Of every input and output; () where there are more than two inputs."""
    if len(data.inputs) > most_inputs:
        return ()
    return tuple(_pair(data, i, j) for j in range(len(data.outputs)) for i in range(len(data.inputs)))


def delays_to_try(found: Sequence[DeadTime], inputs: int) -> tuple[int, ...]:
    """One delay in samples per input, the shortest over outputs.

    () unless every input has one and some are longer than what every model tries by itself.
    """
    known = {
        i: min((d.delay.nk for d in found if d.column == i and d.delay and not d.reason), default=None)
        for i in range(inputs)
    }
    delays = [nk for nk in known.values() if nk is not None]
    return tuple(delays) if len(delays) == inputs and max(delays) >= LATE else ()


def least_delays(found: Sequence[DeadTime], inputs: int) -> tuple[int, ...]:
    """Delays in samples, one per input, below which no output answers for certain; () where all are 0."""
    floors = [min((d.least for d in found if d.column == i), default=0) for i in range(inputs)]
    return tuple(floors) if any(floors) else ()


def _pair(data: Dataset, column: int, output: int) -> DeadTime:
    names = data.inputs[column].name, data.outputs[output].name
    try:
        delay = estimate_delay(data, column, output, LONGEST_S)
    except DataError as error:
        return DeadTime(*names, column, data.dt_s, None, error.message)
    return DeadTime(*names, column, data.dt_s, delay, _doubt(data, delay, (column, output)))


def _doubt(data: Dataset, delay: Delay, pair: tuple[int, int]) -> str:
    """Why an estimate says nothing, or ''."""
    if spectrum(data, *pair).band_hz() is None:
        return "the output is not shown to follow the input at any frequency"
    if delay.high_s >= LONGEST_S - 0.5 * data.dt_s:
        return f"the data do not bound it below {1e3 * LONGEST_S:.0f} ms"
    return ""
