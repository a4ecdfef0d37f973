"""Every channel of a recipe as transfer functions: fitted, beside the measured frequency response, in words.

This is identification, not judgement: all flights given are used, nothing is held out. `flysid fit` and
`flysid validate` tell how well such a model does on flights that it has not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.lake.lake import Lake
from flysid.model.detrend import Trend
from flysid.model.feedback import Feedback, feedback
from flysid.model.frequency.response import MeasuredResponse, measure_response
from flysid.model.polynomials import Z95, ComplexArray
from flysid.model.transfer_function import TF, FittedTF
from flysid.progress import tell
from flysid.validate.metrics import scores
from flysid.validate.trials import FREE_RUN, run_trials


@dataclass(frozen=True, eq=False)
class ChannelTransfers:
    """One channel.

    Attributes
    ----------
    measured : per output; None where the response cannot be measured, `unmeasured` says why.
    fit_pct : per output, of the free run over the flights that it was fitted to.
    loops : per output, whether the input answers it.
    """

    name: str
    data: Dataset
    model: FittedTF
    measured: tuple[MeasuredResponse | None, ...]
    unmeasured: str
    fit_pct: tuple[float | None, ...]
    loops: tuple[Feedback, ...]

    @property
    def title(self) -> str:
        """ "longitudinal: 6 flights, 9 segments, 360 s at 50 Hz"."""
        d = self.data
        flights = f"{len(d.flights)} flight{'s' if len(d.flights) != 1 else ''}"
        segments = f"{len(d.segments)} segment{'s' if len(d.segments) != 1 else ''}"
        return f"{self.name}: {flights}, {segments}, {len(d) * d.dt_s:.0f} s at {1 / d.dt_s:.4g} Hz"

    def lines(self) -> list[str]:
        """Transfer functions, bands and warnings for people."""
        said = [self.title]
        for i, output in enumerate(self.data.outputs):
            for j in range(len(self.data.inputs)):
                said += ["", str(self.model.transfer(i, j)), self._band(i, j)]
            fit = self.fit_pct[i]
            if fit is not None:
                said.append(f"free run of {output.name} over these flights: fit {fit:.0f} %")
        said += [f"caution: {loop.words}" for loop in self.loops if loop.closed]
        return [*said, *(f"- {note}" for note in self.model.notes)]

    def _band(self, output: int, source: int) -> str:
        measured = self.measured[output]
        if measured is None:
            return f"no measured frequency response: {self.unmeasured}"
        band = measured.band(source)
        if band is None:
            return f"the coherence is above 0.6 nowhere (at most {measured.coherence[:, source].max():.2f})"
        return (
            f"trust it from {band[0]:.3g} to {band[1]:.3g} rad/s "
            f"({band[0] / 2 / np.pi:.2g} to {band[1] / 2 / np.pi:.2g} Hz), where the coherence is above 0.6"
        )

    def response(
        self, output: int, source: int, omega: FloatArray
    ) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """The sampled model at omega: response, and half widths of the 95 % bands in dB and degrees."""
        found = self.model.frequency_response(omega)
        g = found.response[:, output, source]
        relative = found.magnitude_error[:, output, source] / np.maximum(np.abs(g), 1e-300)
        db = 20.0 / np.log(10.0) * Z95 * relative
        return g, db, np.degrees(Z95 * found.phase_error[:, output, source])

    def phases(self, output: int, source: int, measured: MeasuredResponse) -> tuple[FloatArray, FloatArray]:
        """(measured, modelled) phase in degrees on the measured frequencies: the model's without jumps, the
        measured one within half a turn of it."""
        g, _, _ = self.response(output, source, measured.omega)
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
        g, _, _ = self.response(output, source, measured.omega)
        shown, phase = self.phases(output, source, measured)
        width = measured.half_width()[:, source]
        for k, omega in enumerate(measured.omega):
            rows.append(
                (
                    f"{omega:.4g}",
                    f"{omega / 2 / np.pi:.3g}",
                    f"{measured.gain_db[k, source]:.2f}",
                    _width(20.0 / np.log(10.0) * width[k]),
                    f"{shown[k]:.1f}",
                    _width(np.degrees(width[k])),
                    f"{measured.coherence[k, source]:.2f}",
                    f"{20 * np.log10(max(abs(g[k]), 1e-300)):.2f}",
                    f"{phase[k]:.1f}",
                )
            )
        return rows

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "channel": self.name,
            "flights": list(self.data.flights),
            "seconds": len(self.data) * self.data.dt_s,
            "dt_s": self.data.dt_s,
            "fit_pct": list(self.fit_pct),
            "transfers": [t.to_dict() | _figures(t) for t in self.model.transfers],
            "measured": [
                None if m is None else _measured(m, j)
                for m in self.measured
                for j in range(len(self.data.inputs))
            ],
            "feedback": [
                {"output": f.output, "closed": f.closed, "p": f.p_value, "share": f.share} for f in self.loops
            ],
            "notes": list(self.model.notes),
        }


def _width(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) and value < 1000 else "-"


def _figures(transfer: Any) -> dict[str, Any]:
    """Gain and modes with 95 % intervals."""

    def both(estimate: Any) -> dict[str, float | None] | None:
        if estimate is None:
            return None
        values = (estimate.value, *estimate.interval)
        return {k: _number(v) for k, v in zip(("value", "low", "high"), values, strict=True)}

    return {
        "gain": both(transfer.gain),
        "dead_time": both(transfer.dead_time),
        "modes": [
            {
                "pole": [m.pole.real, m.pole.imag],
                "frequency_rad_s": both(m.frequency_rad_s),
                "damping": both(m.damping),
                "time_constant_s": both(m.time_constant_s),
            }
            for m in transfer.modes
        ],
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _measured(measured: MeasuredResponse, source: int) -> dict[str, Any]:
    width = measured.half_width()[:, source]
    return {
        "input": measured.inputs[source].name,
        "output": measured.output.name,
        "omega_rad_s": measured.omega.tolist(),
        "gain_db": measured.gain_db[:, source].tolist(),
        "gain_db_half_width": [_number(20.0 / np.log(10.0) * w) for w in width],
        "phase_deg": measured.phase_deg[:, source].tolist(),
        "phase_deg_half_width": [_number(np.degrees(w)) for w in width],
        "coherence": measured.coherence[:, source].tolist(),
        "band_rad_s": measured.band(source),
    }


def identify(
    lake: Lake,
    recipe_name: str,
    estimator: TF,
    *,
    channels: Sequence[str] = (),
) -> tuple[list[ChannelTransfers], Mapping[str, str]]:
    """Transfer functions of every channel of a recipe, and why the others have none.

    Raises
    ------
    UsageError : `channels` names what the recipe does not have, or settings that cannot be.
    DataError : no channel could be identified; the message gives each one's reason.
    """
    recipe = load_recipe(recipe_name)
    for name in channels:
        if name not in recipe.channels:
            raise UsageError(
                f"the recipe has no channel {name!r}", hint=f"one of {', '.join(recipe.channels)}"
            )
    held = lake.channels(recipe)
    found, skipped = [], {}
    wanted = channels or recipe.channels
    for i, name in enumerate(wanted):
        if name not in held:
            skipped[name] = "no flight holds its streams"
            continue
        tell("identifying", channel=name, share=i / len(wanted))
        try:
            found.append(identify_channel(name, lake.dataset(recipe, name), estimator))
        except (DataError, FitError) as error:
            skipped[name] = str(error)
    if not found:
        reasons = "; ".join(f"{name}: {why}" for name, why in skipped.items())
        raise DataError(f"no channel of recipe {recipe.name!r} could be identified: {reasons}")
    return found, skipped


def identify_channel(name: str, data: Dataset, estimator: TF) -> ChannelTransfers:
    """Fit one channel and measure its response.

    Raises
    ------
    DataError, FitError : as `TF.fit`.
    """
    model = estimator.fit(data)
    measured, why = _responses(data, estimator)
    trials = run_trials({"tf": model}, data, FREE_RUN)
    fits = []
    for j in range(len(data.outputs)):
        y = np.concatenate([t.y[:, j] for t in trials]) if trials else np.zeros(0)
        yh = np.concatenate([t.yh["tf"][:, j] for t in trials]) if trials else np.zeros(0)
        fits.append(scores(y, yh).fit_pct if len(y) else None)
    loops = feedback(model, data) if model.is_stable else ()
    return ChannelTransfers(name, data, model, measured, why, tuple(fits), loops)


def _responses(data: Dataset, estimator: TF) -> tuple[tuple[MeasuredResponse | None, ...], str]:
    trend: Trend = "none" if estimator.trend == "none" else "remove"
    try:
        return tuple(
            measure_response(data, i, method=estimator.method, trend=trend) for i in range(len(data.outputs))
        ), ""
    except DataError as error:
        return (None,) * len(data.outputs), str(error)
