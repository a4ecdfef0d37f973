"""TF: transfer functions in s, one per input and output, with dead time; fitted for the free run.

    y(t) = sum_j e^(-tau_j s) N_j(s) / D(s) u_j(t) + c + v(t)

as flight-test engineers identify them: the frequency response is measured, a transfer function is fitted to
it (`frequency/response`, `frequency/fit`), and, from there, its simulation error over the recorded segments
is minimised (`frequency/continuous_error`; the output-error estimate with the parameters of the plant
itself, Ljung, 1999, 4.2 and 10.2). Orders: the zeros by BIC on the measured response, the poles as the
simplest within one standard error of the best validation free run. Where no frequency can be trusted, a
discrete output-error model gives the start. A number of poles that leaves the measured response where it is
known is out, however well it runs free: below the band drift rules the free run.

The fitted model is the transfer functions sampled exactly behind their hold, a linear model like any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.arguments import check_band, check_inputs
from flysid.model.detrend import Trend, detrend
from flysid.model.freerun import Difference
from flysid.model.frequency.assemble import OneTransfer, assemble, runner
from flysid.model.frequency.continuous_transfer import ContinuousTransfer
from flysid.model.frequency.initial_guess import Starts
from flysid.model.frequency.rational import Hold, Rational, forms
from flysid.model.frequency.response import Method, split_references
from flysid.model.frequency.sampling import sample
from flysid.model.last_gates import shortfall
from flysid.model.linear.data import Parts, judging_window
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.difference_equation import from_dict as linear_from_dict
from flysid.model.linear.output_error import ORDER_LOSS, WORSE_FIT
from flysid.model.linear.settings import check_hint
from flysid.model.selection import block_errors, simplest
from flysid.model.settings import Settings
from flysid.model.threads import on_one_thread
from flysid.showing import counted

Auto = Literal["auto"]


@dataclass(frozen=True, eq=False, repr=False)
class FittedTF(FittedLinear):
    """A linear model that knows its transfer functions in s.

    Attributes
    ----------
    transfers : one per output and input, outputs outermost; references have none.
    counts : estimated parameters of every output.
    """

    transfers: tuple[ContinuousTransfer, ...] = ()
    counts: tuple[int, ...] = ()

    @property
    def n_parameters(self) -> int:
        """Estimated parameters of all outputs."""
        return sum(self.counts)

    def transfer(self, output: int = 0, source: int = 0) -> ContinuousTransfer:
        """From one input to one output; references do not count as inputs."""
        return self.transfers[output * (len(self.transfers) // len(self.outputs)) + source]

    def at_rate(self, rate_hz: float) -> FittedTF:
        """The model at so many steps a second, its inputs constant between samples.

        Raises
        ------
        UsageError : an integrating one with a drift of its own.
        """
        dt_s = 1.0 / rate_hz
        n_y = len(self.outputs)
        rows = [self._sampled(i, dt_s) for i in range(n_y)]
        a = np.zeros((max(len(own) for own, _ in rows), n_y, n_y))
        b = np.zeros((max(len(t) for _, taps in rows for t in taps), n_y, len(self.inputs)))
        c = np.zeros(n_y)
        for i, (own, taps) in enumerate(rows):
            a[: len(own), i, i] = own
            c[i] = own.sum() * self._level(i)
            for j, tap in enumerate(taps):
                b[: len(tap), i, j] = tap
        return replace(self, dt_s=dt_s, system=Difference(a, b, c), starts=None)

    def _sampled(self, output: int, dt_s: float) -> tuple[FloatArray, list[FloatArray]]:
        """a and every input's b of one output; all its transfer functions have one denominator."""
        own = [self.transfer(output, j) for j in range(len(self.inputs))]
        dead = np.array([t.dead_time_s for t in own])
        return sample(Rational(own[0].denominator, tuple(t.numerator for t in own), dead), dt_s, "zero")

    def _level(self, output: int) -> float:
        """Where the output rests, from its mean, while the inputs stand at theirs."""
        whole = float(self.system.a[:, output, output].sum())
        constant = float(self.system.c[output])
        if abs(whole) > 1e-9:
            return constant / whole
        if constant == 0.0:
            return 0.0
        raise UsageError(
            "an integrating transfer function with a drift of its own has no other rate",
            hint="leave out --rate, or fit it with offset=False",
        )

    def __str__(self) -> str:
        lines = [f"TF model, {counted(self.n_parameters, 'parameter')}, sample time {self.dt_s:g} s"]
        for transfer in self.transfers:
            lines += ["", str(transfer)]
        return "\n".join([*lines, "", *(f"- {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """As a linear model, with its transfer functions beside."""
        own = {"transfers": [t.to_dict() for t in self.transfers], "counts": list(self.counts)}
        return super().to_dict() | own


def from_dict(document: Mapping[str, Any]) -> FittedTF:
    """Rebuild a model from `to_dict()`; damage raises KeyError, TypeError or ValueError."""
    transfers = tuple(ContinuousTransfer.from_dict(t) for t in document["transfers"])
    return _as_tf(linear_from_dict(document), transfers, tuple(int(c) for c in document["counts"]))


def _as_tf(
    model: FittedLinear, transfers: tuple[ContinuousTransfer, ...], counts: tuple[int, ...]
) -> FittedTF:
    names = [s.name for s in model.inputs]
    own = [name for name in names if name in {t.input for t in transfers}]
    if [(t.output, t.input) for t in transfers] != [(o.name, name) for o in model.outputs for name in own]:
        raise ValueError("the transfer functions do not fit the signals")
    plain = {f.name: getattr(model, f.name) for f in fields(FittedLinear)}
    return FittedTF(**plain, transfers=transfers, counts=counts)


@dataclass(frozen=True)
class TF(Settings):
    """Settings of a continuous-time transfer-function model; the defaults choose by themselves.

    Parameters
    ----------
    poles : of every output, or "auto", at most 4. 0 is a gain with its dead time (to the sample, behind a
        zero-order hold).
    zeros : one number or one per input, or "auto".
    dead_time_s : "auto": none, or estimated where that explains clearly more; or seconds, one number or one
        per input, None for an input whose dead time is to be estimated.
    hold : what the inputs do between samples: "zero", constant (commands); "first", straight (measured
        signals).
    offset : estimate a constant.
    trend : "none"; "remove" takes a straight line out of every segment's signals first; "estimate" fits an
        offset and a drift of the output per segment along with the transfer function.
    stable : poles in the left half plane. False admits unstable plants: such a model is fitted to the
        frequency response alone, since its free run follows nothing for long.
    refine : minimise the simulation error, unless that leads away from the measured frequency response (as
        drift or a position controller can); False leaves the fit to the response as it is.
    band : lowest and highest frequency (rad/s) of the response to fit; None for where its coherence counts.
        With a band the simulation error, which knows none, is left alone.
    method : how the response is measured, see `measure_response`.
    n_init : measured samples that start a simulation; None chooses.
    nk_hint : delays in samples that the search for dead times tries besides its own, one per input.
    reference : names of inputs of the dataset that drive a feedback loop from outside, as in `IV`: the
        response of the others is measured through them (`measure_response`), and the simulation error, which
        the loop bends, is left alone. They have no transfer function of their own.

    Source: Tischler & Remple (2012), Aircraft and Rotorcraft System Identification.

    Examples
    --------
    >>> model = flysid.TF(poles=1, zeros=0, dead_time_s=0.0).fit(train)  # train: see `flysid.Dataset`
    >>> round(model.transfer().gain.value, 1)
    2.0
    """

    poles: int | Auto = "auto"
    zeros: int | Sequence[int] | Auto = "auto"
    dead_time_s: float | Sequence[float | None] | Auto = "auto"
    hold: Hold = "zero"
    offset: bool = True
    trend: Trend = "none"
    stable: bool = True
    refine: bool = True
    band: tuple[float, float] | None = None
    method: Method = "local"
    n_init: int | None = None
    nk_hint: Sequence[int] = ()
    reference: Sequence[str] = ()

    def check_values(self) -> None:
        """Raise UsageError for a start from nothing, a band without frequencies, inputs that are not held."""
        if self.hold == "none":
            raise UsageError(f"hold is {self.hold!r}", hint="'zero' or 'first'")
        self.at_least(1, "n_init")
        check_band(self.band)

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedTF:
        """Measure, start, choose, refine.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : too few samples, a signal that never changes, or no trustworthy frequency where
            refine=False or stable=False need one.
        FitError : nothing could be fitted.
        """
        plant, references = split_references(train, self.reference)
        self._check(len(plant.inputs))
        self._check_dead_time(train)
        train = detrend(train, self.trend)
        validation = None if validation is None else detrend(validation, self.trend)
        chosen = [self._output(_single(train, i), _single(validation, i)) for i in range(len(train.outputs))]
        parts = Parts.of(*self._plant(train, validation), centred=self.offset)
        model, transfers = assemble(parts, [c for c, _ in chosen], self.n_init)
        notes = tuple(f"{o.name}: {words}." for o, (_, words) in zip(train.outputs, chosen, strict=True))
        if not model.is_stable:
            notes += (unstable_note(transfers),)
        model = model.among(train.inputs, references)
        lost = "" if self.reference else shortfall(model, {}, train)  # in a loop a run follows the noise
        if lost:
            notes += (f"Not for simulation: its {lost}.",)
        model = replace(model, notes=notes)
        return _as_tf(model, transfers, tuple(c.count for c, _ in chosen))

    def check(self) -> None:
        """Raise UsageError where the settings cannot be, whatever the data; `fit` looks at them, too."""
        self._check(1)

    def _plant(self, train: Dataset, validation: Dataset | None) -> tuple[Dataset, Dataset | None]:
        """Both parts without the references."""
        checked = None if validation is None else split_references(validation, self.reference)[0]
        return split_references(train, self.reference)[0], checked

    def _check(self, n_u: int) -> None:
        check_inputs(n_u)
        check_hint(self.nk_hint, n_u)
        forms(n_u, self.poles, self.zeros, self.dead_time_s, self.stable)

    def _check_dead_time(self, train: Dataset) -> None:
        """Raise DataError where an output's response to any input begins behind the end of every segment."""
        given = self.dead_time_s if isinstance(self.dead_time_s, Sequence) else [self.dead_time_s]
        stated = max((t for t in given if isinstance(t, int | float)), default=0.0)
        longest = max((len(segment) for segment in train.segments), default=0) * train.dt_s
        if stated and stated >= longest:
            raise DataError(
                f"no segment is longer than the dead time of {stated:g} s; the longest has {longest:.4g} s",
                hint="a shorter dead time, or auto",
            )

    def _output(self, train: Dataset, validation: Dataset | None) -> tuple[OneTransfer, str]:
        """The transfer functions of one output, chosen on the fitting part and refined on all."""
        parts = Parts.of(*self._plant(train, validation), centred=self.offset)
        joint = Parts.of(train, validation, centred=self.offset).whole if self.reference else parts.whole
        starts = Starts.of(self, parts, joint)
        free_run = self.refine and self.stable and self.band is None and not self.reference
        tried = list(starts.refined()) if free_run else []
        if not tried:
            kept, words = starts.unrefined()
            return kept.refit(parts, refine=False), words
        near = [t for t in tried if not starts.strays(t[0])]
        best, words = _simplest(parts, [c for c, _ in near or tried], _lowest(train))
        chosen, origin = (near or tried)[best]
        final = chosen.refit(parts, refine=True)
        strays = starts.strays(final)
        if strays:
            kept, said = starts.unrefined()
            return kept.refit(parts, refine=False), said + strays
        return final, f"{origin}{words}"


def _single(data: Dataset | None, output: int) -> Any:
    """The dataset with one of its outputs."""
    if data is None or len(data.outputs) == 1:
        return data
    segments = [replace(s, y=s.y[:, [output]]) for s in data.segments]
    return Dataset(data.dt_s, data.inputs, (data.outputs[output],), tuple(segments), data.name)


def _lowest(data: Dataset) -> float:
    """The lowest frequency that the longest segment shows twice, rad/s."""
    return 4.0 * np.pi / (max(len(s) for s in data.segments) * data.dt_s)


def _simplest(parts: Parts, tried: Sequence[OneTransfer], lowest: float) -> tuple[int, str]:
    """Index of the simplest within one standard error of the best validation free run, and words.

    A candidate with poles that the data do not determine gives way to one without, unless that is far worse.
    """
    if len(tried) == 1:
        return 0, ""
    window = judging_window(parts, max(t.depth for t in tried))
    errors = [
        block_errors(runner(parts, [t], window), parts.check, window, parts.scaling.y_scale) for t in tried
    ]
    means = [float(e.mean()) if len(e) else np.inf for e in errors]
    best = simplest(errors, ORDER_LOSS)
    table = ", ".join(f"{t.poles}: {np.sqrt(m):.3g}" for t, m in zip(tried, means, strict=True))
    words = (
        "; the number of poles is that of the simplest within one standard error of the best validation free "
        f"run (RMSE in standard deviations by poles, {table})"
    )
    if best == 0 or tried[best].is_determined(lowest):
        return best, words
    known = [i for i, t in enumerate(tried) if i == 0 or t.is_determined(lowest)]
    other = known[simplest([errors[i] for i in known], ORDER_LOSS)]
    if not means[other] <= WORSE_FIT * means[best]:
        return best, f"{words}; not all of its poles are determined by these data"
    return other, (
        "; among those whose poles the data determine, the simplest within one standard error of the best "
        f"validation free run (RMSE in standard deviations by poles, {table})"
    )


def unstable_note(transfers: Sequence[ContinuousTransfer]) -> str:
    """What an unstable estimate is, and what to do about it."""
    worst = max((p for t in transfers for p in t.poles), key=lambda p: p.real)
    size = f"+{worst.real:.3g}" + (f" +- {abs(worst.imag):.3g}i" if worst.imag else "")
    return (
        f"Unstable: a pole at {size} rad/s. Simulate short spans only; if the plant is known to be stable, "
        "fit with stable=True, a lower order or trend='remove'; if it flies under a controller, excite the "
        "command and check for feedback."
    )
