"""The frequency response that a recording shows, before any model: gain, phase, coherence, intervals.

As flight-test engineers look at it (Tischler & Remple, 2012, Aircraft and Rotorcraft System Identification,
ch. 7 to 10): for every frequency and input the response with the other inputs' part taken out, the (partial)
coherence g^2, and how far chance may have moved the point,

    eps = sqrt(1 - g^2) / (g sqrt(2 n_d)),

n_d the number of independent averages: the standard error of ln |G| and of the phase in rad (Bendat &
Piersol, 2010, Random Data, 9.1). How it is measured: `local_polynomial` (the default; hardly any leakage, so
that one chirp or a few segments are enough) or `spectra` (windows of several lengths combined, or
multitaper).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.model.arguments import no_samples
from flysid.model.detrend import Trend, detrend
from flysid.model.frequency.local_polynomial import local_response
from flysid.model.frequency.spectra import multitaper_response, welch_response
from flysid.model.polynomials import ComplexArray

GOOD_COHERENCE = 0.6
"""What rotorcraft identification asks of a response (Tischler and Remple, 2012, 7.5)."""

Method = Literal["local", "welch", "multitaper"]
METHODS: tuple[Method, ...] = ("local", "welch", "multitaper")


@dataclass(frozen=True, eq=False)
class MeasuredResponse:
    """Response from every input to one output, as measured.

    `omega`: (F,) rad/s, rising.
    `response`: (F, n_u) complex gain, output unit per input unit, the other inputs' part taken out.
    `coherence`: (F, n_u) 0 to 1; partial (the others conditioned out) where there are several inputs; through
        references the least of theirs with the inputs, with the output, and of that.
    `error`: (F, n_u) eps: standard error of ln |G| and of the phase in rad; inf where nothing coheres.
    `averages`: (F, n_u) n_d, independent averages.
    `freedom`: (F,) degrees of freedom of the noise estimate (real numbers: two per complex one).
    `correlation`: (n_u, F, F) correlation of the points' errors: neighbours share data.
    `shared`: largest coherence between two inputs, averaged over the frequencies; 0 for one input.
    `reference`: signals that drive a loop from outside, through which the response was measured.
    `late_s`: standard error of a delay that all points share, which the stamps of the record leave open.
    """

    omega: FloatArray
    response: ComplexArray
    coherence: FloatArray
    error: FloatArray
    averages: FloatArray
    freedom: FloatArray
    correlation: FloatArray
    shared: float
    dt_s: float
    inputs: tuple[Signal, ...]
    output: Signal
    reference: tuple[str, ...] = ()
    late_s: float = 0.0

    @property
    def gain_db(self) -> FloatArray:
        """(F, n_u) 20 log10 |G|."""
        tiny = np.finfo(float).tiny
        return np.asarray(20.0 * np.log10(np.maximum(np.abs(self.response), tiny)))

    @property
    def phase_deg(self) -> FloatArray:
        """(F, n_u) phase without jumps; it starts between -180 and 180 degrees."""
        return np.asarray(np.degrees(np.unwrap(np.angle(self.response), axis=0)))

    def half_width(self, level: float = 0.95) -> FloatArray:
        """(F, n_u) half width of the interval on ln |G| (Student's t), and on the phase in rad but for what
        stamps leave open."""
        from scipy.special import stdtrit

        return np.asarray(stdtrit(self.freedom, 0.5 + level / 2.0)[:, None] * self.error)

    def phase_half_width(self, level: float = 0.95) -> FloatArray:
        """(F, n_u) half width of the interval on the phase, rad; it holds what the stamps leave open."""
        from scipy.special import ndtri

        late = float(ndtri(0.5 + level / 2.0)) * self.omega * self.late_s
        return np.hypot(self.half_width(level), late[:, None])

    def trusted(self, source: int = 0, among: npt.NDArray[np.bool_] | None = None) -> FloatArray:
        """(F,) 1 inside the widest band (in octaves) where the coherence counts, else 0; see `band`.

        `among`: (F,) these points alone.
        """
        averages = self.averages[:, source]
        chance = 1.0 - 0.05 ** (1.0 / np.maximum(averages - 1.0, 0.1))
        level = np.maximum(GOOD_COHERENCE, chance)
        own = self.coherence[:, source]
        allowed = np.ones(len(own), dtype=bool) if among is None else among
        good = allowed & (_smooth(own) > level)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
        inside = np.zeros(len(self.omega))
        counts = allowed & (own > level)
        runs = [  # none on its neighbours' word alone
            (start, stop)
            for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
            if counts[start:stop].any()
        ]
        if runs:
            start, stop = max(runs, key=lambda r: float(np.log(self.omega[r[1] - 1] / self.omega[r[0]])))
            kept = start + np.flatnonzero(counts[start:stop])  # no edge on a neighbour's word
            inside[kept[0] : kept[-1] + 1] = 1.0
        return inside

    def band(self, source: int = 0, among: npt.NDArray[np.bool_] | None = None) -> tuple[float, float] | None:
        """Lowest and highest trustworthy frequency, rad/s: coherence above 0.6 and above chance; or None."""
        inside = np.flatnonzero(self.trusted(source, among))
        return (float(self.omega[inside[0]]), float(self.omega[inside[-1]])) if len(inside) else None


def _smooth(values: FloatArray) -> FloatArray:
    """Mean over three neighbours: one line alone may be chance."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    return np.asarray((padded[:-2] + padded[1:-1] + padded[2:]) / 3.0)


def measure_response(
    data: Dataset,
    output: int = 0,
    *,
    reference: Sequence[str] = (),
    points: int = 80,
    method: Method = "local",
    trend: Trend = "none",
    band: tuple[float, float] | None = None,
) -> MeasuredResponse:
    """The frequency response from all inputs to one output of a dataset.

    Parameters
    ----------
    reference : names of inputs of the dataset that drive a feedback loop from outside (a chirp, a setpoint).
        They have no response of their own; that of the other inputs is measured through them, at least as
        many as those, and only with method "local".
    points : frequencies, equally spaced in log omega.
    method : "local", local polynomials (Pintelon & Schoukens, 2012, ch. 7): one chirp, a multisine or any
        excitation over any number of segments; "welch", windows of up to five lengths combined by their
        random errors (Tischler & Remple, 2012, ch. 10); "multitaper", whole segments under seven orthogonal
        windows (Thomson, 1982).
    trend : "remove" takes a straight line out of every segment's signals first.
    band : lowest and highest frequency, rad/s; default: what the data can tell.

    Raises
    ------
    DataError : too short, an input or the output never changes, inputs that cannot be told apart.
    UsageError : no such method or reference, too few references, or an empty band.

    Examples
    --------
    >>> measured = flysid.measure_response(train, points=20)  # train: see `flysid.Dataset`
    >>> low, high = measured.band()  # rad/s, where the coherence can be trusted
    >>> low < 1.0 < high
    True
    >>> flysid.measure_response(data, reference=["chirp"]).band()  # doctest: +SKIP
    (4.1, 73.6)
    """
    if method not in METHODS:
        raise UsageError(f"no method {method!r}", hint=f"one of {', '.join(map(repr, METHODS))}")
    if points < 2:
        raise UsageError(f"a frequency response needs at least 2 points, not {points}")
    plant, references = split_references(data, reference)
    if references and method != "local":
        raise UsageError(f"method {method!r} cannot use a reference", hint="use method='local'")
    order = [*references, *(j for j in range(len(data.inputs)) if j not in references)]
    records = _records(detrend(data, trend), order, output)
    _check_motion(records, data, order, output)
    scale = np.sqrt(sum((r**2).sum(axis=0) for r in records) / sum(map(len, records)))
    scaled = [r / scale for r in records]
    n_r = len(references)
    shared = _check_apart([r[:, n_r:-1] for r in scaled], [s.name for s in plant.inputs])
    _check_apart([r[:, :n_r] for r in scaled], list(reference))
    if method == "local":
        found = local_response(scaled, data.dt_s, points, band, n_r)
    else:
        how = {"welch": welch_response, "multitaper": multitaper_response}[method]
        found = how(scaled, data.dt_s, points, band)
    return MeasuredResponse(
        omega=found.omega,
        response=np.asarray(found.response * scale[-1] / scale[n_r:-1]),
        coherence=np.clip(found.coherence, 0.0, 1.0),
        error=np.asarray(np.where(np.isfinite(found.error), found.error, np.inf)),
        averages=np.broadcast_to(found.averages[:, :1], found.response.shape),
        freedom=found.freedom,
        correlation=found.correlation,
        shared=shared,
        dt_s=data.dt_s,
        inputs=plant.inputs,
        output=data.outputs[output],
        reference=tuple(s.name for s in data.inputs if s.name in reference),
    )


def split_references(data: Dataset, reference: Sequence[str]) -> tuple[Dataset, tuple[int, ...]]:
    """The dataset without the inputs that are references, and which of its inputs those were.

    Raises UsageError: no such input; no input is left; fewer references than inputs.
    """
    names = [s.name for s in data.inputs]
    for name in reference:
        if name not in names:
            raise UsageError(f"no input is called {name!r}", hint=f"one of {', '.join(names)}")
    if not reference:
        return data, ()
    found = tuple(j for j, name in enumerate(names) if name in reference)
    kept = [j for j in range(len(names)) if j not in found]
    if not kept:
        raise UsageError(
            "every input is a reference: none is left for the model",
            hint="name as references what drives the loop, not what enters the plant",
        )
    if len(found) < len(kept):
        left = ", ".join(names[j] for j in kept)
        count = f"{len(found)} reference{'s' if len(found) > 1 else ''}"
        raise UsageError(
            f"{count} cannot tell {len(kept)} inputs apart ({left})",
            hint="name a reference for every input, or leave inputs out",
        )
    segments = [replace(s, u=s.u[:, kept]) for s in data.segments]
    return replace(data, inputs=tuple(data.inputs[j] for j in kept), segments=tuple(segments)), found


def _records(data: Dataset, order: Sequence[int], output: int) -> list[FloatArray]:
    """(N, n_u + 1) per segment: inputs in this order and the output about their means over all segments."""
    found = [np.column_stack([s.u[:, list(order)], s.y[:, output]]) for s in data.segments if len(s)]
    if not found:
        raise no_samples()
    mean = np.concatenate(found).mean(axis=0)
    return [r - mean for r in found]


def _check_motion(records: Sequence[FloatArray], data: Dataset, order: Sequence[int], output: int) -> None:
    names = [*(data.inputs[j].name for j in order), data.outputs[output].name]
    offset = np.append(data.segments[0].u[:1, list(order)], data.segments[0].y[:1, output])
    for i, name in enumerate(names):
        size = max(float(np.ptp(r[:, i])) for r in records)
        if not size > 1e-12 * max(abs(float(offset[i])), 1e-300):
            kind = "output" if i == len(names) - 1 else "input"
            raise DataError(
                f"{kind} {name!r} never changes: it has no frequency response",
                hint="choose segments in which it moves, or leave it out of the recipe",
            )


def _check_apart(records: Sequence[FloatArray], names: Sequence[str]) -> float:
    """The largest squared correlation between two inputs. Raises DataError: two inputs are one signal."""
    gram = np.asarray(sum(r.T @ r for r in records))
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    squared = (gram / np.outer(size, size)) ** 2
    np.fill_diagonal(squared, 0.0)
    if squared.max(initial=0.0) > 1.0 - 1e-6:
        i, j = np.unravel_index(int(np.argmax(squared)), squared.shape)
        raise DataError(
            f"inputs {names[int(i)]!r} and {names[int(j)]!r} move together: "
            "their effects cannot be told apart",
            hint="leave one out of the recipe, or excite them separately",
        )
    return float(squared.max(initial=0.0))
