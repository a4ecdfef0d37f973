"""The table of checks of one channel, and the coefficients with their intervals, as text for the template."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from flysid.dataset import FloatArray
from flysid.escaping import one_line
from flysid.model.capabilities import Coefficient
from flysid.showing import counted, number
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.diagnose.caution_models import COLLINEAR
from flysid.validate.diagnose.checks import Checks
from flysid.validate.diagnose.diagnostics import Diagnosis
from flysid.validate.diagnose.nearness import UNUSUAL
from flysid.validate.show.page.overlay import drawn

S = TypeVar("S")


@dataclass(frozen=True)
class CheckFinding:
    """One model's answer to one check; `good` is None where there is no right and wrong."""

    words: str
    good: bool | None = None


UNKNOWN = CheckFinding("not known")


@dataclass(frozen=True)
class CheckRow:
    """One check: the question, how to read it, an answer for every model or one for the data."""

    label: str
    hint: str
    findings: tuple[CheckFinding, ...]


def check_rows(c: Comparison, d: Diagnosis, j: int) -> tuple[CheckRow, ...]:
    """All checks of one channel and output; models in the order of `drawn`."""
    names = [name for name, _ in drawn(c)]
    rows = [
        CheckRow("Poles", "largest modulus over the rules; below 1: stable", _each(names, _poles, d)),
        CheckRow(
            "Any blend of the rules",
            "a common quadratic Lyapunov function proves stability for any blend of rules",
            _each(names, _blend, d),
        ),
        CheckRow("Free run, held out", "reached the output limits", _each(names, _find_divergence, c)),
        CheckRow(
            "Long free run",
            "random steps within the training range of the inputs",
            tuple(_long_run(d.checks[n]) for n in names if n in d.checks),
        ),
        CheckRow(
            "Initial condition decays",
            "two free runs from opposite ends of the training range stay within 1 % of it",
            tuple(_forgets(d.checks[n]) for n in names if n in d.checks),
        ),
        CheckRow(
            "Condition of the regressors",
            "1: independent; large: coefficients trade off against each other",
            tuple(_condition(d.checks[n]) for n in names if n in d.checks),
        ),
        *_rule_rows(names, d),
        *_data_rows(c, d, j),
    ]
    return tuple(row for row in rows if row.findings)


def _each(
    names: Sequence[str], find: Callable[[str, S], CheckFinding], source: S
) -> tuple[CheckFinding, ...]:
    return tuple(find(name, source) for name in names)


def _poles(name: str, d: Diagnosis) -> CheckFinding:
    radius = d.pole_radius.get(name)
    if radius is None:
        return CheckFinding("–")
    return CheckFinding(f"{radius:.4f}", radius <= 1.0 + 1e-6)


def _blend(name: str, d: Diagnosis) -> CheckFinding:
    checks = d.checks.get(name)
    if checks is None or not checks.certificate:
        return CheckFinding("one rule: see its poles")
    return CheckFinding(one_line(checks.certificate), True if checks.proved else None)


def _find_divergence(name: str, c: Comparison) -> CheckFinding:
    if FREE_RUN not in c.horizons:
        return CheckFinding("–")
    score = c.entry(horizon=FREE_RUN).models[name]
    if not score.diverged:
        return CheckFinding(f"in none of {counted(len(score.segments), 'segment')}", True)
    said = ", ".join(f"{one_line(c.segments[s.segment])} at {s.diverged_s:.1f} s" for s in score.diverged[:5])
    return CheckFinding(f"in {len(score.diverged)} of {len(score.segments)}: {said}", False)


def _long_run(checks: Checks) -> CheckFinding:
    r = checks.robustness
    if r is None:
        return UNKNOWN
    if r.limits_s is not None:
        return CheckFinding(f"reaches its output limits at t = {r.limits_s:.1f} s", False)
    beyond = f", {100 * r.outside:.1f} % outside the training range" if r.outside >= 5e-4 else ""
    return CheckFinding(f"bounded for {r.long_s:.0f} s{beyond}", True)


def _forgets(checks: Checks) -> CheckFinding:
    r = checks.robustness
    if r is None:
        return UNKNOWN
    if r.forget_s is None:
        return CheckFinding(f"not within {r.forget_most_s:.3g} s", None)
    return CheckFinding(f"after {number(r.forget_s)} s" if r.forget_s else "at once", True)


def _condition(checks: Checks) -> CheckFinding:
    found = checks.conditions
    if not found:
        return UNKNOWN
    if len(found) == 1:
        words = _plain(found[0])
    else:
        words = ", ".join(f"R{i + 1} {_plain(v)}" for i, v in enumerate(found))
    return CheckFinding(words, max(found) < COLLINEAR)


def _plain(value: float) -> str:
    return f"{value:.0f}" if value < 1e4 else number(value) if np.isfinite(value) else "singular"


def _rule_rows(names: Sequence[str], d: Diagnosis) -> Iterator[CheckRow]:
    if not any(n in d.rule_use for n in names):
        return
    alone = CheckFinding("one rule")
    yield CheckRow(
        "Rule overlap",
        "0: one rule at a time; 1 − 1/R: all alike",
        tuple(CheckFinding(f"{d.rule_use[n].overlap:.2f}") if n in d.rule_use else alone for n in names),
    )
    yield CheckRow(
        "Strongest rule, held out",
        "share of samples",
        tuple(
            CheckFinding(
                ", ".join(f"R{i + 1} {100 * v:.0f} %" for i, v in enumerate(d.rule_use[n].strongest))
            )
            if n in d.rule_use
            else alone
            for n in names
        ),
    )


def _data_rows(c: Comparison, d: Diagnosis, j: int) -> Iterator[CheckRow]:
    """What the held-out data can show, whatever the model."""
    spectra = zip(c.test.inputs, d.outputs[j].responses, strict=True)
    said = []
    for signal, s in spectra:
        if s is None:
            said.append(f"{one_line(signal.name)}: not measured: it hardly moves, or the record is too short")
        elif s.explained_to_hz is None:
            said.append(f"{one_line(signal.name)}: below one half everywhere")
        else:
            said.append(
                f"{one_line(signal.name)}: more than one half up to {number(s.explained_to_hz)} Hz, "
                f"largest {s.largest:.2f}"
            )
    yield CheckRow(
        "Coherence", "share of the output that an input explains", (CheckFinding("; ".join(said)),)
    )
    if d.outside:
        shares = ", ".join(f"{one_line(o.signal.name)} {100 * o.share:.1f} %" for o in d.outside)
        good = max(o.share for o in d.outside) <= 0.01
        yield CheckRow(
            "Outside the training range", "share of held-out samples", (CheckFinding(shares, good),)
        )
    if d.near is not None:
        near = f"{100 * d.near.far:.1f} % in holes inside the range; median distance {d.near.typical:.2g}"
        usual = f"in standard deviations; for 99 % of the training samples at most {d.near.usual:.2g}"
        good = d.near.far <= UNUSUAL
        yield CheckRow("Distance to the nearest training sample", usual, (CheckFinding(near, good),))
    if d.changes:
        moves = ", ".join(
            f"{one_line(s.name)} {100 * v:.0f} %" for s, v in zip(c.test.inputs, d.changes, strict=True)
        )
        changing = "share of held-out samples that differ from the one before"
        yield CheckRow("Input changes", changing, (CheckFinding(moves),))


def coefficient_rows(c: Comparison, d: Diagnosis, j: int) -> tuple[tuple[str, str, str, str], ...]:
    """(model or rule, regressor, value, half width) of every estimated coefficient of one output."""
    known = [
        (name, checks.intervals) for name, checks in reversed(list(d.checks.items())) if checks.intervals
    ]
    return tuple(
        (_whose(name, x), one_line(x.regressor), _format_signed(x.value), f"± {x.half_width:.2g}")
        for name, sure in known
        for x in sure.coefficients
        if x.output == c.test.outputs[j].name
    )


def _whose(name: str, x: Coefficient) -> str:
    return f"{one_line(name).upper()} {x.rule}".strip()


def _format_signed(value: float) -> str:
    return f"{value:.5g}".replace("-", "−")


def interval_text(bounds: FloatArray | None, unit: str = "") -> str:
    """ "[0.28, 0.39]" for (2,) bounds; "" where there are none."""
    if bounds is None or np.isnan(bounds).any():
        return ""
    low, high = (number(float(v)).replace("-", "−") if np.isfinite(v) else "∞" for v in bounds)
    return f"[{low}, {high}]{unit}"
