"""Every channel of a recipe as transfer functions: fitted, beside the measured frequency response, in words.

This is identification, not judgement: all flights given are used, nothing is held out. `flysid fit` and
`flysid validate` tell how well such a model does on flights that it has not seen.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, RecipeError
from flysid.extras import Extra, extra
from flysid.feedback import Feedback, feedback
from flysid.ingest.align.quick import driven_by
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.lake.lake import Lake
from flysid.model.detrend import Trend
from flysid.model.frequency.continuous_transfer import ContinuousTransfer
from flysid.model.frequency.controller_inverse import LoopView, view_loop
from flysid.model.frequency.loop_figures import (
    COMMAND,
    FIGURE_POINTS,
    LoopFigure,
    broken_loop,
    command_figures,
    loop_figures,
    unknown,
)
from flysid.model.frequency.response import (
    GOOD_COHERENCE,
    MeasuredResponse,
    measure_response,
    split_references,
)
from flysid.model.polynomials import DB, Z95, ComplexArray
from flysid.model.transfer_function import TF, FittedTF
from flysid.progress import tell
from flysid.validate.compare.metrics import scores
from flysid.validate.compare.trials import FREE_RUN, run_trials
from flysid.validate.runs.fitone import nothing_done
from flysid.validate.transfers.agreement import (
    NEAR_DB,
    NEAR_DEG,
    agree,
    cautions_beside,
    in_a_loop,
    measured_document,
    misfit,
    response_rows,
    transfer_figures,
)
from flysid.validate.transfers.expected_figures import check_reference, command_groups
from flysid.validate.transfers.stamps import Stamps, read_stamps

NOT_MEASURED = "see what is missing"


@dataclass(frozen=True, eq=False)
class ChannelTransfers:
    """One channel.

    Attributes
    ----------
    measured : per output; None where the response cannot be measured, `unmeasured` says why.
    fit_pct : per output, of the free run over the flights that it was fitted to.
    loops : per output, whether the input answers it; none where a reference was named.
    stamps : per output, what they leave open of its delay.
    reference : signals through which the response was measured.
    views : per output, whose the measured response is; None where that is not known.
    figures : of the closed loop from its command ("command"), of the one cut open ("loop"); see
        `model.frequency.loop_figures`.
    cautions : what the intervals do not hold, and figures of other verbs that exclude these.
    """

    name: str
    data: Dataset
    model: FittedTF
    measured: tuple[MeasuredResponse | None, ...]
    unmeasured: str
    fit_pct: tuple[float | None, ...]
    loops: tuple[Feedback, ...]
    stamps: tuple[Stamps, ...]
    reference: tuple[str, ...] = ()
    views: tuple[LoopView | None, ...] = ()
    figures: Mapping[str, Sequence[LoopFigure]] = field(default_factory=dict)
    cautions: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """ "longitudinal: 6 flights, 9 segments, 360 s at 50 Hz"."""
        d = self.data
        flights = f"{len(d.flights)} flight{'s' if len(d.flights) != 1 else ''}"
        segments = f"{len(d.segments)} segment{'s' if len(d.segments) != 1 else ''}"
        through = f", through {' and '.join(self.reference)}" if self.reference else ""
        return f"{self.name}: {flights}, {segments}, {len(d) * d.dt_s:.0f} s at {1 / d.dt_s:.4g} Hz{through}"

    def lines(self) -> list[str]:
        """Transfer functions, bands and warnings for people."""
        said = [self.title]
        for i, output in enumerate(self.data.outputs):
            for j in range(len(self.data.inputs)):
                transfer = self.transfer(i, j)
                known = self.measured[i] is not None
                text = transfer.words_in(self.band(i, j)) if known else str(transfer)
                said += ["", text, self._band(i, j)]
            fit = self.fit_pct[i]
            if fit is not None and not self.reference:
                said.append(f"free run of {output.name} over these flights: fit {fit:.0f} %")
        for group, figures in self.figures.items():
            told = [str(f) for f in figures if f.value is not None or group == "loop"]
            said += [f"{group.replace('_', ' ')}: {'; '.join(told)}"] if told else []
        said += [f"caution: {loop.words}" for loop in self.loops if loop.closed]
        said += [f"caution: {words}" for words in self.cautions]
        return [*said, *(f"- {note}" for note in self.model.notes)]

    def _band(self, output: int, source: int) -> str:
        measured = self.measured[output]
        if measured is None:
            return f"no measured frequency response: {self.unmeasured}"
        band = self.band(output, source)
        if self.is_looped(output):
            return in_a_loop(band, self._follows(output))
        of = (
            f"the coherence of {' and '.join(self.reference)} with input and output" if self.reference else ""
        )
        if band is None:
            highest = measured.coherence[:, source].max()
            if measured.band(source) is not None:
                return "no band can be trusted: model and measurement part everywhere; try other orders"
            where = "at too few frequencies" if highest > GOOD_COHERENCE else "nowhere"
            return f"{of or 'the coherence'} is above {GOOD_COHERENCE:g} {where} (at most {highest:.2f})"
        is_narrowed = measured.band(source) != band
        follows = f" and the model within {NEAR_DB:g} dB and {NEAR_DEG:g} degrees" if is_narrowed else ""
        return (
            f"trust it from {band[0]:.3g} to {band[1]:.3g} rad/s "
            f"({band[0] / 2 / np.pi:.2g} to {band[1] / 2 / np.pi:.2g} Hz), where "
            f"{of or 'the coherence'} is above {GOOD_COHERENCE:g}{follows}"
        )

    def is_looped(self, output: int) -> bool:
        """The input answers this output, and no reference was named: the response need not be the plant's."""
        measured = self.measured[output]
        view = self._view(output)
        seen = view is not None and measured is not None and view.seen(measured)
        return seen or (bool(self.loops) and self.loops[output].closed)

    def _view(self, output: int) -> LoopView | None:
        """What the measured response belongs to, where that is known."""
        return self.views[output] if self.views else None

    def _follows(self, output: int) -> list[tuple[float, float]]:
        """Bands (rad/s) in which the measured response is -1 / controller; none in open loop."""
        measured = self.measured[output]
        view = self._view(output)
        if view is None or measured is None or not self.is_looped(output):
            return []
        return view.follows(measured)

    def band(self, output: int, source: int) -> tuple[float, float] | None:
        """Where to trust the response, rad/s; None where nowhere."""
        measured = self.measured[output]
        if measured is None:
            return None
        near = agree(measured, source, self._modelled(output, source, measured.omega)[0])
        return measured.band(source, near & self._plants(output, measured))

    def _plants(self, output: int, measured: MeasuredResponse) -> npt.NDArray[np.bool_]:
        """(F,) where the measured response is the plant's."""
        if not self.is_looped(output):
            return np.ones(len(measured.omega), dtype=bool)
        view = self._view(output)
        return np.zeros(len(measured.omega), dtype=bool) if view is None else view.plants

    def transfer(self, output: int, source: int) -> ContinuousTransfer:
        """The transfer function; an estimated dead time is as unsure as its stamps are."""
        found = self.model.transfer(output, source)
        if not found.dead_time.error > 0.0:
            return found
        covariance = found.covariance.copy()
        covariance[-1, -1] += self.stamps[output].late_s ** 2
        return replace(found, covariance=covariance)

    def response(
        self, output: int, source: int, omega: FloatArray
    ) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """The sampled model at omega: response, and half widths of the 95 % bands in dB and degrees.

        They hold what its parameters do not know: what parts it from the measured response, and what the
        stamps leave open of its delay.
        """
        g, gain, turn = self._modelled(output, source, omega)
        measured = self.measured[output]
        off = np.zeros(len(g))
        if measured is not None:
            here = self._modelled(output, source, measured.omega)[0]
            missed = misfit(measured, source, here, self._plants(output, measured))
            off = np.interp(np.log(omega), np.log(measured.omega), missed)
        late = omega * self.stamps[output].late_s
        db = DB * Z95 * np.hypot(gain, off)
        return g, db, np.degrees(Z95 * np.sqrt(turn**2 + off**2 + late**2))

    def _modelled(
        self, output: int, source: int, omega: FloatArray
    ) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """The sampled model at omega: response, standard errors of ln |G| and of the phase in rad."""
        found = self.model.frequency_response(omega)
        column = [s.name for s in self.model.inputs].index(self.data.inputs[source].name)
        g = found.response[:, output, column]
        relative = found.magnitude_error[:, output, column] / np.maximum(np.abs(g), 1e-300)
        return g, relative, found.phase_error[:, output, column]

    def phases(self, output: int, source: int, measured: MeasuredResponse) -> tuple[FloatArray, FloatArray]:
        """(measured, modelled) phase in degrees on the measured frequencies: the model's without jumps, the
        measured one within half a turn of it."""
        g = self._modelled(output, source, measured.omega)[0]
        model = np.degrees(np.unwrap(np.angle(g)))
        trusted = measured.trusted(source) > 0
        raw = np.degrees(np.angle(measured.response[:, source]))
        inside = trusted if trusted.any() else np.ones(len(raw), dtype=bool)
        model -= 360.0 * np.round((model[inside][0] - raw[inside][0]) / 360.0)
        return np.asarray(model + (raw - model + 180.0) % 360.0 - 180.0), model

    def table(self, output: int, source: int) -> list[tuple[str, ...]]:
        """The Bode table, headings first; intervals are half widths at 95 %."""
        rows: list[tuple[str, ...]] = [
            ("rad/s", "Hz", "dB", "+-", "deg", "+-", "coherence", "model dB", "model deg")
        ]
        measured = self.measured[output]
        if measured is None:
            return rows
        g = self._modelled(output, source, measured.omega)[0]
        shown, phase = self.phases(output, source, measured)
        return [*rows, *response_rows(measured, source, shown, (g, phase))]

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "channel": self.name,
            "flights": list(self.data.flights),
            "seconds": len(self.data) * self.data.dt_s,
            "dt_s": self.data.dt_s,
            "fit_pct": list(self.fit_pct),
            "transfers": [
                self.transfer(i, j).to_dict() | self._transfer_figures(i, j)
                for i in range(len(self.data.outputs))
                for j in range(len(self.data.inputs))
            ],
            "reference": list(self.reference),
            "follows_controller_rad_s": [list(map(list, self._follows(i))) for i in range(len(self.views))],
            "measured": [
                None if m is None else measured_document(m, j) | {"band_rad_s": self.band(i, j)}
                for i, m in enumerate(self.measured)
                for j in range(len(self.data.inputs))
            ],
            "feedback": [
                {"output": f.output, "closed": f.closed, "p": f.p_value, "share": f.share} for f in self.loops
            ],
            "figures": {g: {f.name: f.to_dict() for f in found} for g, found in self.figures.items()},
            "cautions": list(self.cautions),
            "notes": list(self.model.notes),
        }

    def _transfer_figures(self, output: int, source: int) -> dict[str, Any]:
        """Gain and modes with 95 % intervals, None for what the trusted band does not carry."""
        transfer = self.transfer(output, source)
        measured = self.measured[output] is not None
        band = self.band(output, source) if measured else (0.0, np.inf)
        return transfer_figures(transfer, band)


def identify(
    lake: Lake,
    recipe_name: str,
    estimator: TF,
    *,
    channels: Sequence[str] = (),
    reference: Sequence[str] = (),
    reference_at: str = "",
) -> tuple[list[ChannelTransfers], Mapping[str, str]]:
    """Transfer functions of every channel of a recipe, and why the others have none.

    Parameters
    ----------
    reference : signals of the recipe or fields of the logs that drive the loops from outside, instead of
        those that the recipe names.
    reference_at : where the reference enters, "input" or "setpoint" (`broken_loop`), instead of the recipe's.

    Raises
    ------
    RecipeError : `channels` names what the recipe does not have; a reference is in no log.
    UsageError : settings that cannot be.
    DataError : no channel could be identified; the message gives each one's reason.
    """
    recipe = load_recipe(recipe_name)
    wanted = recipe.chosen(channels)
    recipe = driven_by(recipe, reference, lake.logs)
    through = recipe.with_references()
    held = lake.channels(recipe)
    driven = lake.channels(through)
    found = []
    skipped = {}
    for i, name in enumerate(wanted):
        if name not in held:
            skipped[name] = "no flight holds its streams"
            continue
        tell("identifying", channel=name, share=i / len(wanted))
        try:
            names = recipe.channels[name].reference if name in driven else ()
            data = lake.dataset(through if names else recipe, name)
            at = reference_at or recipe.channels[name].reference_at
            found.append(identify_channel(name, data, replace(estimator, reference=names), at))
        except (DataError, FitError, RecipeError) as error:
            skipped[name] = str(error)
    if not found:
        raise nothing_done(recipe.name, "identified", skipped)
    return found, skipped


def identify_channel(name: str, data: Dataset, estimator: TF, reference_at: str = "") -> ChannelTransfers:
    """Fit one channel and measure its response.

    Raises
    ------
    UsageError : margins are asked for (`reference_at`) without one reference.
    DataError, FitError : as `TF.fit`.
    """
    model = estimator.fit(data)
    nothing = (None,) * len(data.outputs)
    measured, why = extra(Extra.MEASURED, partial(_responses, data, estimator), (nothing, NOT_MEASURED), name)
    plant, references = split_references(data, estimator.reference)
    fits = extra(Extra.FIT_SHARE, partial(_fit_pct, model, data), nothing, name)
    loops = () if references else extra(Extra.LOOP, partial(feedback, data), (), name)
    names = tuple(data.inputs[j].name for j in references)
    views = tuple(
        None
        if references or seen is None
        else extra(Extra.WHOSE, partial(view_loop, data, i, seen), None, name)
        for i, seen in enumerate(measured)
    )
    whole = ChannelTransfers(
        name, plant, model, measured, why, fits, loops, (Stamps(0.0),) * len(measured), names, views
    )
    stamps = tuple(_stamps(whole, i) for i in range(len(measured)))
    late = tuple(m and replace(m, late_s=s.late_s) for m, s in zip(measured, stamps, strict=True))
    whole = replace(whole, stamps=stamps, measured=late)
    cautions = tuple(dict.fromkeys(_cautions(whole)))
    return replace(whole, figures=_all_figures(whole, data, estimator, reference_at), cautions=cautions)


def _stamps(channel: ChannelTransfers, output: int) -> Stamps:
    """What the stamps leave open; in a loop a free run follows the noise, and tells nothing of clocks."""
    data, model = channel.data, channel.model
    if channel.reference or channel.is_looped(output):
        return read_stamps(data, None, output)
    make = partial(read_stamps, data, model, output)
    return extra(Extra.STAMPS, make, Stamps(0.0), channel.name)


def _cautions(channel: ChannelTransfers) -> Iterator[str]:
    """About every output and input, where a band can be trusted."""
    for i, j in itertools.product(range(len(channel.data.outputs)), range(len(channel.data.inputs))):
        if band := channel.band(i, j):
            is_open = not channel.reference and not channel.is_looped(i)
            measured = channel.measured[i] if is_open else None
            transfer = channel.transfer(i, j)
            yield from cautions_beside(channel.data, transfer, measured, (i, j), band, channel.stamps[i])


def _fit_pct(model: FittedTF, data: Dataset) -> tuple[float | None, ...]:
    """What the free run over all flights explains of every output; None where none is long enough."""
    trials = run_trials({"tf": model}, data, FREE_RUN)
    fits = []
    for j in range(len(data.outputs)):
        y = np.concatenate([t.y[:, j] for t in trials]) if trials else np.zeros(0)
        yh = np.concatenate([t.yh["tf"][:, j] for t in trials]) if trials else np.zeros(0)
        fits.append(scores(y, yh).fit_pct if len(y) else None)
    return tuple(fits)


def _all_figures(
    channel: ChannelTransfers, data: Dataset, estimator: TF, reference_at: str
) -> dict[str, list[LoopFigure]]:
    """Of every command, and of the loop cut open where the entry of the reference is given."""
    found = {}
    names = iter(
        command_groups([s.name for s in channel.data.inputs], [s.name for s in channel.data.outputs])
    )
    for i, measured in enumerate(channel.measured):
        for j in range(len(channel.data.inputs)):
            if measured is None:
                figures = unknown(COMMAND, channel.unmeasured)
            elif channel.is_looped(i):
                figures = unknown(COMMAND, "a loop is closed around it, and nothing named drives that loop")
            else:
                make = partial(_command_figures, data, estimator, (i, j), channel.stamps[i])
                figures = list(extra(Extra.LOOP_FIGURES, make, (), channel.name))
            found[next(names)] = figures
    if not reference_at:
        return found
    check_reference(channel.reference)
    loop = broken_loop(data, reference=channel.reference[0], at=reference_at)
    return found | {"loop": loop_figures(loop)}


def _command_figures(
    data: Dataset, estimator: TF, place: tuple[int, int], stamps: Stamps
) -> list[LoopFigure]:
    """Of one output and input, on frequencies near enough for a peak of light damping."""
    output, source = place
    measured = _measured(data, output, estimator, FIGURE_POINTS)
    return command_figures(replace(measured, late_s=stamps.late_s), source)


def figures_document(channels: Sequence[ChannelTransfers]) -> dict[str, Any]:
    """What `--fail-if` looks at: {"channels": {"roll": {"loop": {"phase_margin_deg": {"low": ..."""
    body: dict[str, Any] = {}
    for c in channels:
        body[c.name] = {
            group: {f.name: {"value": f.value, "low": f.low, "high": f.high} for f in found}
            | {"reason": "; ".join(dict.fromkeys(f.why for f in found if f.why))}
            for group, found in c.figures.items()
        }
    return {"channels": body}


def _responses(data: Dataset, estimator: TF) -> tuple[tuple[MeasuredResponse | None, ...], str]:
    try:
        return tuple(_measured(data, i, estimator) for i in range(len(data.outputs))), ""
    except DataError as error:
        return (None,) * len(data.outputs), str(error)


def _measured(data: Dataset, output: int, estimator: TF, points: int = 80) -> MeasuredResponse:
    trend: Trend = "none" if estimator.trend == "none" else "remove"
    return measure_response(
        data, output, reference=estimator.reference, points=points, method=estimator.method, trend=trend
    )
