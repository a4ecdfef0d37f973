"""Panels of one channel in which every model of the run can be shown: residuals and dynamics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from markupsafe import Markup

from flysid.dataset import Dataset, FloatArray
from flysid.escaping import one_line
from flysid.extras import Extra, extra
from flysid.filters import power_density
from flysid.model.base import Rule
from flysid.model.frequency.response import GOOD_COHERENCE
from flysid.offers import rows
from flysid.showing import number
from flysid.validate.compare.comparison import Comparison
from flysid.validate.diagnose.bands import curves
from flysid.validate.diagnose.context import Sweep
from flysid.validate.diagnose.residuals import Correlation
from flysid.validate.diagnose.responses import (
    LASTING,
    measured_rests,
    poles_and_zeros,
    steady_outputs,
    step_from,
)
from flysid.validate.show.page import figures
from flysid.validate.show.page.channel_data import Source
from flysid.validate.show.page.overlay import Role, drawn, roles

STEP_POINTS = (50, 4000)
"""Fewest and most samples of a step."""


@dataclass(frozen=True)
class ModelNote:
    """What a panel says of one model, shown and hidden with it."""

    model: str
    words: str
    shown: bool


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture with its heading, a line that says how to read it, and what it says of each model."""

    title: str
    note: str
    picture: Markup
    by_model: tuple[ModelNote, ...] = ()


Draw = Callable[[Source, int, int], list[Panel]]
"""(channel, number of the output, number of its main input) -> panels; none where nothing is to show."""
ENTRY_POINTS = "flysid.figures"
PLACES = ("residuals", "dynamics", "data")


@dataclass(frozen=True)
class Figure:
    """A figure of the page that another package adds; of every channel and output.

    `name`: what a sentence calls it where it breaks: "gain over speed".
    `place`: heading that it stands under, last: "residuals", "dynamics" or "data".
    `draw`: see `Draw`; `flysid.validate.show.page.svg` draws pictures.

    >>> from flysid.validate.show.page.modelpanels import Figure
    >>> Figure("gain over speed", "dynamics", lambda source, output, signal: []).place
    'dynamics'
    """

    name: str
    place: str
    draw: Draw


def panels_of(
    place: str, own: Mapping[str, Callable[[], list[Panel]]], source: Source, j: int, signal: int
) -> tuple[Panel, ...]:
    """The panels under a heading: flysid's own by name, then those of installed packages."""
    offered = extra(Extra.PANEL, _offered, (), "of an installed package")
    more = {row.name: partial(row.draw, source, j, signal) for row in offered if row.place == place}
    return drawn_panels(source, {**own, **more})


@cache
def _offered() -> tuple[Figure, ...]:
    """The figures of installed packages.

    Raises UsageError: one of them is no figure, or has no place on the page.
    """
    found = []
    for offer, row in rows(ENTRY_POINTS, Figure):
        if row.place not in PLACES:
            raise offer.refusal(f"its place {row.place!r} is not one of {', '.join(PLACES)}")
        found.append(row)
    return tuple(found)


def with_unit(name: str, unit: str) -> str:
    """ "v_x, m/s"."""
    return one_line(f"{name}, {unit}" if unit else name)


def gain_unit(c: Comparison, j: int, signal: int) -> str:
    """ "m/s per deg"."""
    return one_line(f"{c.test.outputs[j].unit or '1'} per {c.test.inputs[signal].unit or '1'}")


def residual_panels(source: Source, j: int, signal: int) -> tuple[Panel, ...]:
    """Correlation, histogram and spectrum of one-step residuals; free-run errors against inputs."""
    inputs = enumerate(source.comparison.test.inputs)
    return panels_of(
        "residuals",
        {
            "autocorrelation": partial(_autocorrelation, source, j),
            **{f"cross-correlation with {s.name}": partial(_cross, source, j, i) for i, s in inputs},
            "histogram of the residual": partial(_histogram, source, j),
            "spectrum of the residual": partial(_spectrum, source, j),
        },
        source,
        j,
        signal,
    )


def drawn_panels(source: Source, panels: Mapping[str, Callable[[], list[Panel]]]) -> tuple[Panel, ...]:
    """Every panel by its name, as far as there is one; one that breaks takes no other with it."""
    where = f" of {source.channel}" if source.channel else ""
    drawn = [extra(Extra.PANEL, draw, (), f"the {name}{where}") for name, draw in panels.items()]
    return tuple(panel for some in drawn for panel in some)


def _autocorrelation(source: Source, j: int) -> list[Panel]:
    c = source.comparison
    known = source.diagnosis.outputs[j].whiteness
    white = {role: known[role.model] for role in roles(c) if role.model in known}
    if not white:
        return []
    return [
        Panel(
            "Autocorrelation of the one-step residual",
            "Grey: 99 % band of white noise.",
            figures.correlogram(white, c.dt_s, "Autocorrelation of the one-step residual"),
            _model_notes({role: f"{t.outside} of {t.tested} lags outside" for role, t in white.items()}),
        )
    ]


def _cross(source: Source, j: int, i: int) -> list[Panel]:
    c = source.comparison
    known = source.diagnosis.outputs[j].dependence
    name = c.test.inputs[i].name
    tests = {role: known[role.model][i] for role in roles(c) if role.model in known}
    if not tests:
        return []
    return [
        Panel(
            f"Cross-correlation of the free-run error with {one_line(name)}",
            "Grey: Bartlett's 99 % band.",
            figures.correlogram(tests, c.dt_s, f"Free-run error against {name}"),
            _model_notes({role: _dependence(t, c.dt_s) for role, t in tests.items()}),
        )
    ]


def _dependence(correlation: Correlation, dt_s: float) -> str:
    lag, rho = correlation.peak
    verdict = "some dynamics missing" if correlation.fails else "nothing left that the input explains"
    if correlation.blind and not correlation.fails:
        verdict = "too little data to tell" if correlation.rho.any() else "the input does not move"
    peak = f"{rho:+.2f}".replace("-", "−")
    outside = f"{correlation.outside} of {correlation.tested} causal lags outside"
    return f"peak {peak} at {lag * dt_s:.2f} s; {outside}: {verdict}"


def _residuals(source: Source, j: int) -> dict[Role, list[FloatArray]]:
    """One-step residuals of every model, piece by piece; nothing where none were made."""
    trials = source.diagnosis.steps["1"]
    cast = roles(source.comparison) if trials else []
    return {role: [t.y[:, j] - t.yh[role.model][:, j] for t in trials] for role in cast}


def _histogram(source: Source, j: int) -> list[Panel]:
    pooled = {role: np.concatenate(parts) for role, parts in _residuals(source, j).items()}
    if not pooled:
        return []
    unit = source.comparison.test.outputs[j].unit
    words = (with_unit("one-step residual", unit), "Histogram of the one-step residual")
    spread = {
        role: f"standard deviation {number(float(np.std(r)))} {unit}".strip() for role, r in pooled.items()
    }
    return [
        Panel(
            "Histogram of the one-step residual",
            "Residuals beyond the axis are counted in the outermost bins.",
            figures.histogram(pooled, words),
            _model_notes(spread),
        )
    ]


def _spectrum(source: Source, j: int) -> list[Panel]:
    c = source.comparison
    densities = {role: power_density(parts, c.dt_s) for role, parts in _residuals(source, j).items()}
    hz = next((hz for hz, _ in densities.values()), np.zeros(0))
    if len(hz) < 2:
        return []
    return [
        Panel(
            "Spectrum of the one-step residual",
            "A flat spectrum is white noise. A peak is a mode that the model lacks.",
            figures.residual_spectrum(
                hz,
                {role: density for role, (_, density) in densities.items()},
                f"power density, dB (({c.test.outputs[j].unit or '1'})²/Hz)",
                "Power spectral density of the one-step residual",
            ),
        )
    ]


def _model_notes(words: Mapping[Role, str]) -> tuple[ModelNote, ...]:
    return tuple(
        ModelNote(one_line(role.model), f"{one_line(role.model).upper()}: {one_line(text)}", role.shown)
        for role, text in words.items()
    )


def dynamics_panels(source: Source, j: int, signal: int) -> tuple[Panel, ...]:
    """Frequency response, step, poles and zeros, static map, number of rules."""
    return panels_of(
        "dynamics",
        {
            "frequency response": lambda: [_bode(source, j, signal)],
            "step response": lambda: [_step(source, j, signal)],
            "poles and zeros": lambda: _poles(source, j, signal),
            "static map": lambda: [_static(source, j, signal)],
            "rule count": lambda: _sweep(source, j),
        },
        source,
        j,
        signal,
    )


def _sweep(source: Source, j: int) -> list[Panel]:
    sweep = source.sweep or _noted_sweep(source.comparison)
    if sweep is None:
        return []
    unit = one_line(source.comparison.test.outputs[j].unit)
    bars = " Bars: one standard error of the distance to the best." if any(sweep.spread) else ""
    return [Panel("Rule count", one_line(sweep.words + bars), figures.sweep_figure(sweep, unit))]


def _noted_sweep(c: Comparison) -> Sweep | None:
    if c.contender is None:
        return None
    info = c.models[c.contender]
    return Sweep.from_notes(info.notes, info.n_rules)


def rules_of(c: Comparison) -> tuple[Rule, ...]:
    """The contender's rules where it has several."""
    rules = c.fitted[c.contender].rules() if c.contender else ()
    return tuple(rules) if len(rules) > 1 else ()


def _bode(source: Source, j: int, signal: int) -> Panel:
    c = source.comparison
    empirical = source.diagnosis.outputs[j].responses[signal]
    total = max(len(s) for s in c.test.segments) * c.dt_s
    hz = np.geomspace(max(2.0 / total, 1e-4), 0.5 / c.dt_s, 120)
    asked = {
        role: extra(
            Extra.CURVES,
            partial(curves, c.fitted[role.model], hz, (j, signal), source.sure(role.model)),
            None,
            f"{role.model} on {source.channel}",
        )
        for role in roles(c)
    }
    known = {role: found for role, found in asked.items() if found is not None}
    rules = ", ".join(one_line(r.label) for r in rules_of(c))
    solid = f" Solid: {rules}, in the colours of the table of rules." if rules else ""
    seen = (
        "No response could be measured: the input hardly moves, or the record is too short."
        if empirical is None
        else f"Dots: measured, with 95 % whiskers; faint where the coherence is below {GOOD_COHERENCE:g}."
    )
    return Panel(
        f"Frequency response from {one_line(c.test.inputs[signal].name)}",
        f"{seen} Dashed: {one_line(c.baseline).upper()}.{solid} Shaded: 95 % bands from the training data.",
        figures.bode(
            None if empirical is None else figures.Points.of(empirical),
            known,
            hz,
            gain_unit(c, j, signal),
            "Frequency response, measured and modelled",
        ),
    )


def _training(source: Source) -> Dataset:
    return source.train or source.comparison.test


def _slowest(source: Source) -> float:
    """Seconds: the slowest finite time constant of the models of the headline; one second where none is."""
    known = [
        rule.time_constant_s
        for name, _ in drawn(source.comparison)
        for rule in source.comparison.fitted[name].rules()
        if np.isfinite(rule.time_constant_s)
    ]
    return max(known, default=1.0)


def _step(source: Source, j: int, signal: int) -> Panel:
    c = source.comparison
    u = np.concatenate([s.u for s in _training(source).segments])
    rest = u.mean(axis=0)
    height = float(np.std(u[:, signal])) or 1.0
    longest = max(len(s) for s in c.test.segments)
    samples = int(np.clip(LASTING * _slowest(source) / c.dt_s, STEP_POINTS[0], STEP_POINTS[1]))
    samples = max(STEP_POINTS[0], min(samples, longest))
    every = max(1, samples // 200)
    values = {
        role: step_from(c.fitted[role.model], rest, height, (j, signal), samples)[::every]
        for role in roles(c)
    }
    s = c.test.inputs[signal]
    unit = f" {one_line(s.unit)}" if s.unit else ""
    return Panel(
        f"Step response to {one_line(s.name)}",
        f"Change of {one_line(c.test.outputs[j].name)} after a step of {number(height)}{unit} (one standard "
        f"deviation in training) from the mean of {number(float(rest[signal]))}{unit}.",
        figures.step_figure(
            c.dt_s * np.arange(0, samples, every, dtype=np.float64),
            values,
            with_unit(c.test.outputs[j].name, c.test.outputs[j].unit),
            f"Step response of {c.test.outputs[j].name}",
        ),
    )


def _poles(source: Source, j: int, signal: int) -> list[Panel]:
    c = source.comparison
    found = {role: poles_and_zeros(c.fitted[role.model], j, signal) for role in roles(c)}
    found = {role: rules for role, rules in found.items() if rules}
    if not any(role.shown for role in found):
        return []
    return [
        Panel(
            "Poles and zeros",
            "Crosses: poles; circles: zeros; dashed: the unit circle. A pole outside it is unstable. Zeros "
            "far away and poles of pure delay are left out.",
            figures.pole_map(found, "Poles and zeros in the z plane"),
        )
    ]


def _static(source: Source, j: int, signal: int, *, time_constants: float = 3.0) -> Panel:
    """What lasts for `time_constants` of them may be at rest: 95 % of a change have happened."""
    c = source.comparison
    data = _training(source)
    u = np.concatenate([s.u for s in data.segments])
    seconds = time_constants * _slowest(source)
    rests = measured_rests(data, seconds, j, signal)
    levels = np.linspace(float(u[:, signal].min()), float(u[:, signal].max()), 25)
    steady = {
        role: steady_outputs(c.fitted[role.model], levels, u.mean(axis=0), j, signal) for role in roles(c)
    }
    output = c.test.outputs[j]
    words = (
        with_unit(c.test.inputs[signal].name, c.test.inputs[signal].unit),
        with_unit(output.name, output.unit),
        f"Static map of {output.name}",
    )
    part = "training" if source.train else "held-out"
    said = (
        f"Dots: stretches of {number(seconds)} s of {part} data in which nothing drifts."
        if len(rests)
        else f"No equilibrium was measured: no {number(seconds)} s of {part} data are at rest."
    )
    return Panel(
        "Static map",
        f"Lines: where each model settles for a constant input. {said}",
        figures.static_map(rests, levels, steady, words),
    )
