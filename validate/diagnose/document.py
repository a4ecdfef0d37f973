"""Comparisons as a JSON document: plain numbers, null where a number does not exist, never NaN."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from flysid.extras import Extra, extra
from flysid.ingest.align.doubts import Doubt
from flysid.validate.compare.comparison import Comparison, Entry, ModelScore, Pair
from flysid.validate.compare.words import judged_words
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.checks import Checks
from flysid.validate.diagnose.diagnostics import Diagnosis
from flysid.validate.diagnose.residuals import Correlation

DOCUMENT_VERSION = 1


def to_json(
    comparisons: Mapping[str, Comparison],
    diagnoses: Mapping[str, Diagnosis] | None = None,
    doubts: Mapping[str, Sequence[Doubt]] | None = None,
) -> dict[str, Any]:
    """{"channels": {NAME: {HORIZON: {"models", "change_pct", "ci95", "verdict", ...}, "about": {...}}}}.

    "scope" is what the verdict speaks of: "another flight", or only "these flights",
    "the held-out flight" or "this flight".
    A channel with several outputs is listed once per output, as "channel/output". "change_pct", "ci95"
    and "verdict" speak of the contender ("ts" where there is one) against the baseline, which "about" names;
    "one_rule": the contender has one rule, so it is a linear model. "pairs" holds every model against the
    baseline, "rivals" the contender against every other linear model, "short_of" those that it is not shown
    to be better than. Facts about a whole channel stand under "about";
    segments are counted from 0 (H1 on the page, 1 in CSV, is 0 here);
    with `diagnoses` there are also "cautions", worst first, and "diagnostics" by channel.
    """
    channels: dict[str, Any] = {}
    about: dict[str, Any] = {}
    for name, comparison in comparisons.items():
        channels |= channel_documents(name, comparison.entries, comparison.contender)
        about[name] = _about(comparison)
    document: dict[str, Any] = {
        "format": "flysid-validation",
        "version": DOCUMENT_VERSION,
        "channels": channels,
        "about": about,
    }
    if diagnoses is not None:
        document["cautions"] = [
            {"level": c.level, "text": c.text, "todo": c.todo}
            for c in cautions(comparisons, diagnoses, doubts)
        ]
        document["diagnostics"] = {
            name: extra(Extra.DIAGNOSIS_NUMBERS, partial(_diagnosis, d, comparisons[name]), None, name)
            for name, d in diagnoses.items()
        }
    found: dict[str, Any] = plain(document)
    return found


def channel_documents(name: str, entries: Sequence[Entry], contender: str | None) -> dict[str, Any]:
    """{CHANNEL: {HORIZON: {...}}} of one channel; one key per output where there are several."""
    outputs = list(dict.fromkeys(e.output.name for e in entries))
    found: dict[str, Any] = {}
    for entry in entries:
        key = name if len(outputs) == 1 else f"{name}/{entry.output.name}"
        found.setdefault(key, {})[entry.horizon] = _entry(entry, contender)
    return found


def _diagnosis(d: Diagnosis, comparison: Comparison) -> dict[str, Any]:
    inputs = comparison.test.inputs
    return {
        "largest_pole_radius": d.pole_radius,
        "outside_training": [
            {"signal": o.signal.name, "share": o.share, "low": o.low, "high": o.high} for o in d.outside
        ],
        "distance_to_training": None if d.near is None else asdict(d.near),
        "rule_use": {name: asdict(use) for name, use in d.rule_use.items()},
        "checks": {name: _checks(c) for name, c in d.checks.items()},
        "nonlinearity": [asdict(part) | {"found": part.found} for part in d.nonlinear],
        "feedback": [asdict(loop) | {"closed": loop.closed} for loop in d.loops],
        "outputs": {
            out.output.name: {
                "whiteness": {name: _correlation(c, comparison.dt_s) for name, c in out.whiteness.items()},
                "dependence": {
                    name: {s.name: _correlation(c, comparison.dt_s) for s, c in zip(inputs, cs, strict=True)}
                    for name, cs in out.dependence.items()
                },
                "coherence": {
                    s.name: None
                    if r is None
                    else {"largest": r.largest, "explained_to_hz": r.explained_to_hz}
                    for s, r in zip(inputs, out.responses, strict=True)
                },
            }
            for out in d.outputs
        },
    }


def _checks(c: Checks) -> dict[str, Any]:
    sure = c.intervals
    return {
        "long_run": None if c.robustness is None else asdict(c.robustness),
        "condition_per_rule": list(c.conditions),
        "simpler": [asdict(s) for s in c.simpler],
        "certificate": {"proved": c.proved, "words": c.certificate},
        "gain_95": None if sure is None else sure.gain.tolist(),
        "reached_95_s": None if sure is None or sure.reached_s is None else sure.reached_s.tolist(),
        "coefficients": [] if sure is None else [asdict(x) for x in sure.coefficients],
    }


def _correlation(c: Correlation, dt_s: float) -> dict[str, Any]:
    lag, rho = c.peak
    return {
        "lags_tested": c.tested,
        "lags_outside_99": c.outside,
        "band_99": c.band,
        "peak": rho,
        "peak_s": lag * dt_s,
        "fails": c.fails,
    }


def _entry(entry: Entry, contender: str | None) -> dict[str, Any]:
    head = entry.pairs.get(contender or "")
    return {
        "models": {name: _model(score) for name, score in entry.models.items()},
        "change_pct": head.change_pct if head else None,
        "ci95": list(head.ci95) if head and head.ci95 else [None, None],
        "verdict": str(head.verdict) if head else None,
        "reason": judged_words(head) if head else "only one model was given",
        "scope": str(head.scope) if head else None,
        "one_rule": bool(head and head.one_rule),
        "short_of": list(head.short_of) if head else [],
        "rivals": {name: _pair(pair) for name, pair in entry.rivals.items()},
        "pairs": {name: _pair(pair) for name, pair in entry.pairs.items()},
        "output": entry.output.name,
        "unit": entry.output.unit,
        "resolution": entry.resolution,
    }


def _model(score: ModelScore) -> dict[str, Any]:
    return {
        **asdict(score.scores),
        "diverged_segments": len(score.diverged),
        "segments": [
            {"segment": s.segment, "flight": s.flight, "diverged_s": s.diverged_s, **asdict(s.scores)}
            for s in score.segments
        ],
    }


def _pair(pair: Pair) -> dict[str, Any]:
    return {
        "baseline": pair.baseline,
        "change_pct": pair.change_pct,
        "ci95": list(pair.ci95) if pair.ci95 else [None, None],
        "verdict": str(pair.verdict),
        "reason": judged_words(pair),
        "one_rule": pair.one_rule,
        "p": pair.p,
        "p_holm": pair.p_holm,
        "scope": str(pair.scope),
        "pooled_pct": pair.pooled_pct,
        "by_flight": [{"flight": f, "change_pct": c} for f, c in pair.basis.by_flight.items()],
        "units": pair.units,
        "unit": pair.unit,
    }


def _about(comparison: Comparison) -> dict[str, Any]:
    return {
        "baseline": comparison.baseline,
        "contender": comparison.contender,
        "dt_s": comparison.dt_s,
        "lags": comparison.lags,
        "start_s": comparison.start_s,
        "scored_segments": comparison.scored_segments,
        "unused_segments": comparison.unused_segments,
        "test_sha256": comparison.test_hash,
        "models": {name: asdict(info) for name, info in comparison.models.items()},
    }


def plain(value: Any) -> Any:
    """`value` in JSON types; a number that is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
