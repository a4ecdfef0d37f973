"""Rebuilt terms of a controller beside the recorded ones, one by one, and which part of the law is off.

Above an eighth of the log's rate a recorded derivative folds back; it is compared below. The integral is
compared by what it gains in a tenth of a second: its level remembers every error since take-off. What the
rounding of setpoint, rate and term makes of the difference is found by rounding once more, and taken off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.loops.betaflight import BetaflightLaw
from flysid.loops.law_parts import LARGEST_MISS, Means, TermCheck
from flysid.loops.rebuilt import Rebuilt, Rows, rebuild
from flysid.spectra.stages import Kind, Stage, run_both_ways

GAINED_IN_S = 0.1
BLOCK_S = 1.0
BELOW_SHARE = 0.125
"""Of the log's rate, up to which the derivative is compared."""


def check_terms(
    law: BetaflightLaw, rows: Rows, recorded: Mapping[str, FloatArray], step_s: float, rate_hz: float
) -> tuple[tuple[TermCheck, ...], Means]:
    """P, I and D, as far as the log recorded them and they moved; what moved in the law, on average.

    Nothing is compared where the header does not state how long a loop takes.

    `recorded`: (N,) by the term's letter.
    `step_s`: of the loop, as it ran.
    `rate_hz`: of the log.
    """
    if not law.step_s:
        return (), Means()
    rebuilt = rebuild(law, rows, step_s)
    of_rounding = _subtract(rebuild(law, _round_again(rows), step_s), rebuilt)
    of_record = np.random.default_rng(1).uniform(-0.5, 0.5, len(rows.loop))
    flown = recorded["I"] != 0.0  # on the ground the integral is held at 0
    found = []
    for term in (t for t in "PID" if t in recorded):
        noise = _term(of_rounding, term) + of_record
        own = recorded[term] + (0.5 * np.sign(recorded[term]) if law.cut_terms else 0.0)
        check = compare(term, own, _term(rebuilt, term), flown, rate_hz, noise)
        if check is not None and not check.fits and not check.cause:
            cause = _cause(law, rows, own, step_s, rate_hz, check, flown, noise)
            check = replace(check, cause=cause or _name_unknown(law, term))
        found += [check] if check is not None else []
    return tuple(found), rebuilt.means


def compare(
    term: str,
    recorded: FloatArray,
    rebuilt: FloatArray,
    flown: npt.NDArray[np.bool_],
    rate_hz: float,
    noise: FloatArray,
    *,
    least: float = 1.0,
) -> TermCheck | None:
    """One term; None where the recorded one hardly moves.

    Parameters
    ----------
    flown : (N,) rows that count.
    noise : (N,) what rounding changes in the rebuilt term; taken off the difference by its square.
    least : standard deviation, in the units of the term, below which rounding is all there is.
    """
    if term == "I":
        later = max(1, round(GAINED_IN_S * rate_hz))
        at = flown[later:] & flown[:-later]
        one, other, noise = (x[later:] - x[:-later] for x in (recorded, rebuilt, noise))
    elif term == "P":
        at = flown
        one, other = recorded, rebuilt
    else:
        low = Stage(Kind.BIQUAD, BELOW_SHARE * rate_hz).sections(rate_hz)
        at = flown
        one, other, noise = (run_both_ways(low, x) for x in (recorded, rebuilt, noise))
    one, other, noise = one[at], other[at], noise[at]
    weight = _even_out(one, round(BLOCK_S * rate_hz) or 1)
    size = float(np.sqrt((weight * one**2).sum() / max(weight.sum(), 1e-9)))
    if size < least:
        return None
    under = float((weight * other) @ other)
    slope = float((weight * one) @ other) / under if under > 0.0 else np.nan
    miss, scaled = (_miss(one, factor * other, noise, weight) for factor in (1.0, slope))
    check = TermCheck(term, miss, slope, scaled=scaled)
    if term == "I" or check.fits:
        return check
    return replace(check, cause=show_change(np.flatnonzero(at) / rate_hz, one, other, scaled))


def show_change(
    time_s: FloatArray, one: FloatArray, other: FloatArray, scaled: float, *, least_s: float = 3.0
) -> str:
    """From when on another gain flew, where two gains give the recorded term and one does not; else "".

    Where a gain that drifts gives it better than two, nothing was switched: a battery that empties, for one,
    looks like that, and the drift is all that is shown.

    `time_s`: (N,) from the record's begin.
    `scaled`: the miss under one gain for all of it.
    `least_s`: that either gain flew.
    """
    sums = [np.cumsum(product) for product in (one * other, other**2)]
    middle = slice(
        np.searchsorted(time_s, time_s[0] + least_s), np.searchsorted(time_s, time_s[-1] - least_s)
    )
    (over, over_all), (under, under_all) = ((total[middle], total[-1]) for total in sums)
    if not len(over):
        return ""
    before, after = over / np.maximum(under, 1e-9), (over_all - over) / np.maximum(under_all - under, 1e-9)
    k = int(np.argmax(before * over + after * (over_all - over)))
    at = middle.start + k
    away = one - other * np.where(np.arange(len(one)) <= at, before[k], after[k])
    miss = float(np.sqrt(away @ away / (one @ one)))
    drift = np.polynomial.chebyshev.chebvander(2.0 * (time_s - time_s[0]) / np.ptp(time_s) - 1.0, 3)
    weights = np.linalg.lstsq(drift * other[:, None], one, rcond=None)[0]
    away = one - other * (drift @ weights)
    drifting = float(np.sqrt(away @ away / (one @ one)))
    if min(miss, drifting) > min(LARGEST_MISS, 0.5 * scaled):
        return ""
    if drifting <= miss:
        first, last = (drift @ weights)[[0, -1]]
        return f"recorded over rebuilt drifts from {first:.2f} to {last:.2f} over the flight"
    return (
        f"recorded over rebuilt is {before[k]:.2f} until {time_s[at]:.0f} s and {after[k]:.2f} from there: "
        "gains were changed in flight, or another profile was chosen"
    )


def _miss(one: FloatArray, other: FloatArray, noise: FloatArray, weight: FloatArray) -> float:
    """Root mean square of the difference without what rounding makes of it, over that of the first."""
    off = float(weight @ (one - other) ** 2) - float(weight @ noise**2)
    return float(np.sqrt(max(off, 0.0) / float(weight @ one**2)))


def _round_again(rows: Rows) -> Rows:
    """The same flight with other errors of rounding."""
    rng = np.random.default_rng(0)
    setpoint, rate = (
        values + rows.resolution * rng.uniform(-0.5, 0.5, len(values))
        for values in (rows.setpoint, rows.rate)
    )
    return replace(rows, setpoint=setpoint, rate=rate)


def _subtract(one: Rebuilt, other: Rebuilt) -> Rebuilt:
    """The terms of one without those of another, in the memory of the first: a flight's terms are large."""
    for term in "PID":
        own = _term(one, term)
        own -= _term(other, term)
    return one


def _even_out(values: FloatArray, block: int) -> FloatArray:
    """(N,) weights by which a second counts for no more than one of those that move less than a quarter do.

    A crash at the end of a flight would else be all that is compared.
    """
    edges = np.arange(0, len(values), block)
    if not len(edges):
        return np.ones(len(values))
    energy = np.add.reduceat(values**2, edges)
    most = float(np.quantile(energy, 0.75))
    sizes = np.diff([*edges, len(values)])
    return np.repeat(np.minimum(1.0, most / np.maximum(energy, 1e-9)), sizes)


def _term(rebuilt: Rebuilt, term: str) -> FloatArray:
    return {"P": rebuilt.p, "I": rebuilt.i, "D": rebuilt.d}[term]


def _cause(
    law: BetaflightLaw,
    rows: Rows,
    recorded: FloatArray,
    step_s: float,
    rate_hz: float,
    check: TermCheck,
    flown: npt.NDArray[np.bool_],
    noise: FloatArray,
) -> str:
    """The change of one part of the law by which a term fits best, if it then fits, and not another gain."""
    term = check.term
    best, words = min(LARGEST_MISS, check.scaled), ""
    for name, changed in _changes(law, term):
        own = _term(rebuild(changed, rows, step_s), term)
        other = compare(term, recorded, own, flown, rate_hz, noise)
        if other is not None and other.miss < best:
            best, words = other.miss, f"{name} it is {100.0 * other.miss:.0f} % off"
    return words


def _name_unknown(law: BetaflightLaw, term: str) -> str:
    """Settings that the law does not describe, or that the header lacks; "" where there are none."""
    if named := ", ".join(law.not_described):
        return f"the log has {named}, which the law leaves out"
    lacking = ", ".join(law.not_stated.get(term, ()))
    return f"the log's header does not state {lacking}" if lacking else ""


def _changes(law: BetaflightLaw, term: str) -> list[tuple[str, BetaflightLaw]]:
    """Laws that differ in one part that a term depends on."""
    if term == "D":
        return _tpa_changed(law, term) + _changes_of_d(law)
    if term == "P":
        bare = [("without yaw_lowpass", replace(law, p_filters=()))] if law.p_filters else []
        return _tpa_changed(law, term) + bare
    within = "without" if law.rotates else "with"
    found = [(f"{within} iterm_rotation", replace(law, rotates=not law.rotates))]
    if law.relax is not None:
        found.append(("without iterm_relax", replace(law, relax=None)))
    if law.faster is not None:
        found.append(("without anti-gravity", replace(law, faster=None)))
    return found


def _tpa_changed(law: BetaflightLaw, term: str) -> list[tuple[str, BetaflightLaw]]:
    """The law whose TPA takes a term in, or leaves it out."""
    if not (law.tpa[0] or law.low_tpa[0]):
        return []
    taken = tuple(t for t in "PD" if (t in law.tpa_terms) != (t == term))
    within = "without TPA" if term in law.tpa_terms else "with TPA"
    return [(f"{within} on {term}", replace(law, tpa_terms=taken))]


def _changes_of_d(law: BetaflightLaw) -> list[tuple[str, BetaflightLaw]]:
    """Laws that differ in one part of the derivative."""
    found = []
    if law.boost is not None:
        found.append(("with D at its least", replace(law, boost=None)))
        found.append(("with D at its most", replace(law, boost=None, d=law.d * law.boost.most)))
    if law.moving is not None:
        found.append(("with the first D low-pass at rest", replace(law, moving=None)))
    if law.notch[0] > 0.0:
        found.append(("without the D notch", replace(law, notch=(0.0, 0.0))))
    for k, hz in enumerate(dict.fromkeys(cut for _, cut in law.filters)):
        rest = tuple(own for own in law.filters if own[1] != hz)
        found.append((f"without D low-pass {k + 1}", replace(law, filters=rest, moving=None)))
    return found
