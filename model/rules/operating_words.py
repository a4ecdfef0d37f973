"""What a model of rules does, in sentences: places from slow to fast, those that answer alike told once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import combinations, pairwise

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.extras import Extra, extra
from flysid.model.base import OperatingPoint
from flysid.showing import significant

Signals = tuple[Sequence[Signal], Sequence[Signal]]
"""Outputs and inputs."""
_ALIKE = np.log(1.1)  # figures so near each other are the same in words
_UNLIKE = np.log(1.25)  # figures so far apart are two in words, however wide their intervals
_HARDLY = np.log(4.0)  # from end to end of an interval: a factor of two either way
WORTH = 0.05
"""Of a change, or of a signal's spread: less is not worth a word."""


def sentences(points: Sequence[OperatingPoint], signals: Signals) -> list[str]:
    """What a small lasting step of every input does, from the slow to the fast end of what was flown.

    Of one rule, which does the same everywhere, without a place.
    """
    return extra(Extra.BEHAVIOUR, partial(_sentences, points, signals), [])


def _sentences(points: Sequence[OperatingPoint], signals: Signals) -> list[str]:
    outputs, inputs = signals
    said = []
    for output, signal in enumerate(outputs):
        own = sorted((p for p in points if p.output == output), key=lambda p: p.outputs[output])
        if own and len(own[0].shares) == 1:
            text = _effects(own, signal, inputs)
            said.append(f"{text[0].upper()}{text[1:]}.")
            continue
        groups = _groups(own)
        said += [f"{_place(group, own, signal)}, {_effects(group, signal, inputs)}." for group in groups]
        if not all(answers_alike(p, q) for p, q in combinations(own, 2)):
            said.append(_variation(own))
    return said


def answers_alike(p: OperatingPoint, q: OperatingPoint) -> bool:
    """Whether two places answer every input the same, within 10 % or their 95 % intervals."""
    pairs = (
        (p.gain, p.gain_interval, q.gain, q.gain_interval),
        (p.reached_s, p.reached_interval_s, q.reached_s, q.reached_interval_s),
    )
    return all(_same(*pair) for pair in pairs)


def _farthest(p: OperatingPoint, q: OperatingPoint) -> float:
    """Largest distance of two places' figures, in logarithms."""
    with np.errstate(all="ignore"):
        return float(np.abs(np.log([p.gain / q.gain, p.reached_s / q.reached_s])).max())


def _same(a: FloatArray, sure_of_a: FloatArray, b: FloatArray, sure_of_b: FloatArray) -> bool:
    with np.errstate(all="ignore"):
        apart = np.abs(np.log(a / b))
        allowed = np.hypot(
            *(np.nan_to_num(np.abs(np.log(s[1] / s[0])) / 2.0) for s in (sure_of_a, sure_of_b))
        )
    return bool((apart <= np.maximum(_ALIKE, allowed)).all())


def answers_like(p: OperatingPoint, q: OperatingPoint) -> bool:
    """Whether two places answer alike, and are known well enough to say so."""
    return answers_alike(p, q) and _are_known(p, q) and not _farthest(p, q) > _UNLIKE


def _told_together(p: OperatingPoint, q: OperatingPoint) -> bool:
    """Whether one sentence does for two places: nothing tells them apart, or nothing is known of one."""
    return answers_like(p, q) or (answers_alike(p, q) and not _are_known(p, q))


def _are_known(*points: OperatingPoint) -> bool:
    return all(_known(sure) for point in points for sure in _intervals(point))


def _intervals(point: OperatingPoint) -> tuple[FloatArray, FloatArray]:
    return point.gain_interval, point.reached_interval_s


def _known(sure: FloatArray) -> bool:
    """Whether no interval (2, ...) spans more than a factor of two either way; NaN: none was asked for."""
    with np.errstate(all="ignore"):
        return not (np.abs(np.log(sure[1] / sure[0])) > _HARDLY).any()


def _groups(own: Sequence[OperatingPoint]) -> list[list[OperatingPoint]]:
    """Neighbours that answer alike, then the groups that mirror each other about zero; slow ones first."""
    runs: list[list[OperatingPoint]] = []
    for point in own:
        if runs and all(_told_together(point, known) for known in runs[-1]):
            runs[-1].append(point)
        else:
            runs.append([point])
    found = []
    while runs:
        first = runs.pop(0)
        last = runs[-1] if runs else []
        opposite = all(_level(p) * _level(q) < 0.0 and _told_together(p, q) for p in first for q in last)
        found.append([*first, *runs.pop()] if last and opposite else first)
    signs = {np.sign(_level(p)) for p in own}
    return sorted(found, key=lambda g: min(abs(_level(p)) for p in g)) if len(signs) > 1 else found


def _level(point: OperatingPoint) -> float:
    return float(point.outputs[point.output])


def _place(group: Sequence[OperatingPoint], own: Sequence[OperatingPoint], signal: Signal) -> str:
    unit = f" {signal.unit}" if signal.unit else ""
    levels = np.array([_level(p) for p in group])
    low = float(levels.min())
    high = float(levels.max())
    skipped = any(low < _level(p) < high for p in own if p not in group)
    if len(group) == 1:
        return f"Near {signal.name} = {_round_off(low, own)}{unit}"
    if not skipped and not _is_covered(levels):
        each = [_round_off(float(v), own) for v in levels]
        return f"Near {signal.name} = {', '.join(each[:-1])} and {each[-1]}{unit}"
    if not skipped:
        return f"From {signal.name} = {_round_off(low, own)} to {_round_off(high, own)}{unit}"
    size = np.abs(levels)
    if len(group) == 2:
        return f"Near {signal.name} = {significant(float(size.mean()))}{unit} in either direction"
    least, most = significant(float(size.min())), significant(float(size.max()))
    return f"From {least} to {most}{unit} of {signal.name} either way"


def _is_covered(levels: FloatArray, *, widest: float = 0.5) -> bool:
    """Whether places stand for the range from the first to the last of them: what a model does between two of
    them alone, above all around zero, where a vehicle hovers, nobody has computed.

    `widest`: gap between neighbours, of the range.
    """
    placed = np.sort(levels)
    gaps = np.diff(placed)
    around = (placed[:-1] < 0.0) & (placed[1:] > 0.0)
    ends = np.minimum(np.abs(placed[:-1]), np.abs(placed[1:]))
    hollow = around & (ends > 0.25 * gaps)
    return len(levels) > 2 and not (gaps > widest * np.ptp(placed) + 1e-12).any() and not hollow.any()


def _round_off(level: float, own: Sequence[OperatingPoint]) -> str:
    span = max(abs(_level(p)) for p in own)
    return significant(0.0 if abs(level) < 1e-9 * span else level)


def _effects(group: Sequence[OperatingPoint], output: Signal, inputs: Sequence[Signal]) -> str:
    """ "one more deg of theta_in adds 0.11 m/s (0.096 to 0.12) to v_x; 63 % of that is reached after 0.73 s".

    Of several inputs each; the time once where it is the same for all.
    """
    changes = [_change(group, j, output, given) for j, given in enumerate(inputs)]
    times = [_time(group, j) for j in range(len(inputs))]
    if len(inputs) > 1 and len(set(times)) == 1:
        return f"{', '.join(changes[:-1])} and {changes[-1]}" + times[0].replace("of that", "of each")
    return "; ".join(change + time for change, time in zip(changes, times, strict=True))


def _change(group: Sequence[OperatingPoint], j: int, output: Signal, given: Signal) -> str:
    gain = [float(p.gain[j]) for p in group]
    down = gain[0] < 0.0
    sure = np.array([p.gain_interval[:, j] for p in group]) * (-1.0 if down else 1.0)
    size = _figure([abs(g) for g in gain], np.sort(sure, axis=1), output.unit)
    more = f"one more {given.unit} of {given.name}" if given.unit else f"one unit more of {given.name}"
    return f"{more} takes {size} from {output.name}" if down else f"{more} adds {size} to {output.name}"


def _time(group: Sequence[OperatingPoint], j: int) -> str:
    """ "; 63 % of that is reached after 0.73 s (...)", and how it gets there where that is worth a word."""
    text = ""
    reached = [float(p.reached_s[j]) for p in group]
    if max(reached) == 0.0:
        text = " at once"
    elif np.isfinite(reached).all():
        sure = np.array([p.reached_interval_s[:, j] for p in group])
        text = f"; 63 % of that is reached {after(reached, group, _figure(reached, sure, 's'))}"
    dead = min(float(p.dead_s[j]) for p in group)
    if dead > 0.0:
        text += f", including a dead time of {significant(dead)} s"
    over, wrong = (max(float(getattr(p, name)[j]) for p in group) for name in ("overshoot", "wrong_way"))
    if over > WORTH:
        text += f"; it overshoots by {100 * over:.0f} %"
    if wrong > WORTH:
        text += f"; it first moves {100 * wrong:.0f} % the wrong way"
    return text


def after(reached: Sequence[float], points: Sequence[OperatingPoint], figure: str) -> str:
    """ "after 0.73 s", the figure of times in s; of times that no sample resolves a bound."""
    sample_s = max(p.sample_s for p in points)
    return f"within one sample, {significant(sample_s)} s" if max(reached) < sample_s else f"after {figure}"


def _figure(values: Sequence[float], sure: FloatArray, unit: str) -> str:
    """ "0.11 m/s (0.096 to 0.12)"; of several places their middle, and from the lowest to the highest end."""
    low, high = min(values), max(values)
    if not _known(sure.T):
        apart = low > 0.0 and np.log(high / low) > _ALIKE
        figures = (
            f"{significant(low)} to {significant(high)}"
            if apart
            else significant(float(np.exp(np.mean(np.log(values)))))
        )
        return f"{figures} {unit}".rstrip() + " (poorly determined)"
    middle = f"{significant(float(np.exp(np.mean(np.log(values)))))} {unit}".rstrip()
    if not np.isfinite(sure).all():
        return middle
    return f"{middle} ({significant(float(sure.min()))} to {significant(float(sure.max()))})"


def _variation(own: Sequence[OperatingPoint]) -> str:
    """What differs most over the places, for the input that shows it."""
    with np.errstate(all="ignore"):
        spans = {
            "gain": np.ptp([np.log(np.abs(p.gain)) for p in own], axis=0).max(),
            "response time": np.ptp([np.log(p.reached_s) for p in own], axis=0).max(),
        }
    if any((p.gain * q.gain < 0.0).any() for p, q in pairwise(own)):
        return "The gain changes its sign over this range, so a single linear model cannot describe it."
    name = max(spans, key=lambda key: np.nan_to_num(spans[key], posinf=0.0))
    times = significant(float(np.exp(spans[name])))
    return f"Over this range the {name} varies {times}-fold, so a single linear model cannot describe it."


def near(point: OperatingPoint, signal: Signal) -> str:
    """ "near v_x = 1.9 m/s"."""
    return f"near {_place([point], [point], signal).removeprefix('Near ')}"
