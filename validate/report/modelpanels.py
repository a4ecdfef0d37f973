"""Panels of one channel in which every model of the run can be shown: residuals and dynamics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from flysid.dataset import Dataset
from flysid.filters import power_density
from flysid.model.base import Rule
from flysid.model.frequency.response import GOOD_COHERENCE
from flysid.validate.bands import curves
from flysid.validate.comparison import Comparison
from flysid.validate.report import figures, modelfigures
from flysid.validate.report.channel_data import Source
from flysid.validate.report.context import Sweep
from flysid.validate.report.overlay import Role, drawn, roles
from flysid.validate.residuals import Correlation
from flysid.validate.responses import LASTING, measured_rests, poles_and_zeros, steady_outputs, step_from
from flysid.validate.words import number, one_line

STEP_POINTS = (50, 4000)
"""Fewest and most samples of a step."""


@dataclass(frozen=True)
class Told:
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
    told: tuple[Told, ...] = ()


def with_unit(name: str, unit: str) -> str:
    """ "v_x, m/s"."""
    return one_line(f"{name}, {unit}" if unit else name)


def gain_unit(c: Comparison, j: int, signal: int) -> str:
    """ "m/s per deg"."""
    return one_line(f"{c.test.outputs[j].unit or '1'} per {c.test.inputs[signal].unit or '1'}")


def residual_panels(source: Source, j: int) -> tuple[Panel, ...]:
    """Correlation, histogram and spectrum of one-step residuals; free-run errors against inputs."""
    c = source.comparison
    d = source.diagnosis.outputs[j]
    cast = roles(c)
    white = {role: d.whiteness[role.model] for role in cast}
    panels = [
        Panel(
            "Autocorrelation of the one-step residual",
            "Grey: 99 % band of white noise.",
            modelfigures.correlogram(white, c.dt_s, "Autocorrelation of the one-step residual"),
            _told({role: f"{t.outside} of {t.tested} lags outside" for role, t in white.items()}),
        )
    ]
    for i, signal in enumerate(c.test.inputs):
        tests = {role: d.dependence[role.model][i] for role in cast if role.model in d.dependence}
        if tests:
            panels.append(
                Panel(
                    f"Cross-correlation of the free-run error with {one_line(signal.name)}",
                    "Grey: Bartlett's 99 % band.",
                    modelfigures.correlogram(tests, c.dt_s, f"Free-run error against {signal.name}"),
                    _told({role: _dependence(t, c.dt_s) for role, t in tests.items()}),
                )
            )
    return (*panels, *_residual_distribution(source, j, cast))


def _dependence(correlation: Correlation, dt_s: float) -> str:
    lag, rho = correlation.peak
    verdict = "some dynamics missing" if correlation.fails else "nothing left that the input explains"
    if correlation.blind and not correlation.fails:
        verdict = "too little data to tell" if correlation.rho.any() else "the input does not move"
    peak = f"{rho:+.2f}".replace("-", "−")
    outside = f"{correlation.outside} of {correlation.tested} causal lags outside"
    return f"peak {peak} at {lag * dt_s:.2f} s; {outside}: {verdict}"


def _residual_distribution(source: Source, j: int, cast: Sequence[Role]) -> list[Panel]:
    c = source.comparison
    trials = source.diagnosis.steps["1"]
    pieces = {role: [t.y[:, j] - t.yh[role.model][:, j] for t in trials] for role in cast}
    pooled = {role: np.concatenate(parts) for role, parts in pieces.items()}
    unit = c.test.outputs[j].unit
    words = (with_unit("one-step residual", unit), "Histogram of the one-step residual")
    spread = {
        role: f"standard deviation {number(float(np.std(r)))} {unit}".strip() for role, r in pooled.items()
    }
    panels = [
        Panel(
            "Histogram of the one-step residual",
            "Residuals beyond the axis are counted in the outermost bins.",
            modelfigures.histogram(pooled, words),
            _told(spread),
        )
    ]
    densities = {role: power_density(parts, c.dt_s) for role, parts in pieces.items()}
    hz = next(iter(densities.values()))[0]
    if len(hz) > 1:
        panels.append(
            Panel(
                "Spectrum of the one-step residual",
                "A flat spectrum is white noise. A peak is a mode that the model lacks.",
                modelfigures.residual_spectrum(
                    hz,
                    {role: density for role, (_, density) in densities.items()},
                    f"power density, dB (({unit or '1'})²/Hz)",
                    "Power spectral density of the one-step residual",
                ),
            )
        )
    return panels


def _told(words: Mapping[Role, str]) -> tuple[Told, ...]:
    return tuple(
        Told(one_line(role.model), f"{one_line(role.model).upper()}: {one_line(text)}", role.shown)
        for role, text in words.items()
    )


def dynamics_panels(source: Source, j: int, signal: int) -> tuple[Panel, ...]:
    """Frequency response, step, poles and zeros, static map, number of rules."""
    panels = [_bode(source, j, signal), _step(source, j, signal)]
    poles = _poles(source, j, signal)
    if poles is not None:
        panels.append(poles)
    panels.append(_static(source, j, signal))
    sweep = source.sweep or _noted_sweep(source.comparison)
    if sweep is not None:
        unit = one_line(source.comparison.test.outputs[j].unit)
        bars = " Bars: one standard error of the distance to the best." if any(sweep.spread) else ""
        panels.append(Panel("Rule count", one_line(sweep.words + bars), figures.sweep_figure(sweep, unit)))
    return tuple(panels)


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
    known = {
        role: curves(c.fitted[role.model], hz, (j, signal), source.sure(role.model)) for role in roles(c)
    }
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
            empirical, known, hz, gain_unit(c, j, signal), "Frequency response, measured and modelled"
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
        modelfigures.step_figure(
            c.dt_s * np.arange(0, samples, every, dtype=np.float64),
            values,
            with_unit(c.test.outputs[j].name, c.test.outputs[j].unit),
            f"Step response of {c.test.outputs[j].name}",
        ),
    )


def _poles(source: Source, j: int, signal: int) -> Panel | None:
    c = source.comparison
    found = {role: poles_and_zeros(c.fitted[role.model], j, signal) for role in roles(c)}
    found = {role: rules for role, rules in found.items() if rules}
    if not any(role.shown for role in found):
        return None
    return Panel(
        "Poles and zeros",
        "Crosses: poles; circles: zeros; dashed: the unit circle. A pole outside it is unstable. Zeros far "
        "away and poles of pure delay are left out.",
        modelfigures.pole_map(found, "Poles and zeros in the z plane"),
    )


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
        modelfigures.static_map(rests, levels, steady, words),
    )
