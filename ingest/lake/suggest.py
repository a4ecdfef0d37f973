"""Which input and output pairs a log supports, how well, and what to log or to fly next time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Literal

from flysid.blas import one_thread
from flysid.dataset import Dataset
from flysid.errors import DataError, RecipeError
from flysid.extras import Extra, extra
from flysid.feedback import Feedback, feedback
from flysid.ingest.align.align import align
from flysid.ingest.align.recipe import ChannelSpec, Recipe, load_recipe, shipped_recipes
from flysid.ingest.align.signals import Log, serves
from flysid.ingest.excitation.dead_time import LONGEST_S
from flysid.ingest.excitation.delay import Delay, estimate_delay
from flysid.ingest.excitation.enough import MIN_DURATION_S, too_short_alone
from flysid.ingest.excitation.excitation import GOOD_COHERENCE, Excitation, excitation, is_narrow, spectrum
from flysid.ingest.excitation.share import Share, share_explained
from flysid.progress import part, tell
from flysid.sharing import sharing

Verdict = Literal["good", "closed loop", "weak", "too slow", "too quiet", "too short", "excluded"]
ALONE = "fly steps or doublets on this axis alone, in calm air"


@dataclass(frozen=True)
class Suggestion:
    """One output of a channel of one flight, with the input that explains most of it.

    `rate_hz`, `duration_s`: of the dataset it gives; 0 where it gives none.
    `input_rms`: of the input about its mean, in `input_unit`.
    `coherence`: in the band that holds 95 % of the input's power, the share of the output's power that a
        linear model of this input can explain.
    `band_hz`: where the coherence counts: outside, a model must not be trusted.
    `delay_s`, `delay_low_s`, `delay_high_s`: dead time, and what looks like it; None where unknown.
    `sign`: +1 where the output follows the input, -1 where it goes against it, 0 where unknown (see `Delay`).
    `feedback`: inputs of the channel answer the output (a pilot or controller): open-loop methods are biased.
    `verdict`, `advice`: in words; "closed loop" would be good, were it not the loop's: of a recipe that knows
        what drives it, or where the output leads the input it is in a loop with.
    """

    flight: str
    recipe: str
    channel: str
    input: str
    output: str
    verdict: Verdict
    advice: str = ""
    rate_hz: float = 0.0
    duration_s: float = 0.0
    input_rms: float = 0.0
    input_unit: str = ""
    coherence: float = 0.0
    band_hz: tuple[float, float] | None = None
    delay_s: float | None = None
    delay_low_s: float | None = None
    delay_high_s: float | None = None
    sign: int = 0
    feedback: bool = False
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def suggest(logs: Iterable[Log], recipes: Sequence[str | Recipe] | None = None) -> list[Suggestion]:
    """Every channel of the recipes (all shipped ones by default) that each log has the streams for."""
    chosen = [r if isinstance(r, Recipe) else load_recipe(r) for r in recipes or shipped_recipes()]
    known = list(logs)
    found: list[Suggestion] = []
    for i, log in enumerate(known):
        with part(i / len(known), (i + 1) / len(known), log=log.name), sharing(), one_thread():
            found += _suggest_log(log, chosen)
    return found


def unbounded(found: Suggestion) -> bool:
    """The dead time may be as long as was looked for."""
    step = 1.0 / found.rate_hz if found.rate_hz else 0.0
    return found.delay_high_s is not None and found.delay_high_s >= LONGEST_S - 0.5 * step


def _suggest_log(log: Log, recipes: Sequence[Recipe]) -> Iterator[Suggestion]:
    served = [(r, channel) for r in recipes for channel in r.channels if serves(log, r, channel)]
    for j, (recipe, channel) in enumerate(served):
        tell(f"checking {recipe.name}, {channel}", share=j / len(served))
        make = partial(_suggest_channel, log, recipe, channel)
        yield from extra(Extra.SUGGESTION, make, (), f"{channel} of {log.name}")


def _suggest_channel(log: Log, recipe: Recipe, channel: str) -> list[Suggestion]:
    try:
        aligned = align([log], recipe, channel, doubted=False)
    except (DataError, RecipeError) as error:
        return [_refuse(log, recipe, channel, error)]
    notes = tuple(note for flight in aligned.report.flights for note in flight.notes)
    data = aligned.dataset
    found: list[Suggestion] = []
    moves = [excitation(data, i) for i in range(len(data.inputs))]
    for j, loop in enumerate(feedback(data)):
        shares = [share_explained(data, own, i, j) for i, own in enumerate(moves)]
        # dead times and spectra cost most, and one input is shown
        best = max(range(len(shares)), key=lambda i: shares[i].value)
        suggestion = _assess(log, recipe, data, (best, j), (moves[best], shares[best], loop))
        found.append(replace(suggestion, notes=notes))
    return found


def _refuse(log: Log, recipe: Recipe, channel: str, error: DataError | RecipeError) -> Suggestion:
    """A channel that gives no dataset, and why."""
    spec = recipe.channel(channel)
    text = error.message
    words = text.removeprefix(f"channel {channel!r}").removeprefix(":").strip()
    verdict: Verdict = "too short"
    if "no excitation" in text:
        verdict = "too quiet"
        words = "nothing moves: " + words.partition("no excitation: ")[2]
    elif "never holds" in text:
        verdict = "excluded"
    hint = f"; {error.hint}" if error.hint and verdict != "excluded" else ""
    names = ", ".join(spec.inputs), ", ".join(spec.outputs)
    return Suggestion(log.name, recipe.name, channel, *names, verdict=verdict, advice=words + hint)


def _assess(
    log: Log,
    recipe: Recipe,
    data: Dataset,
    pair: tuple[int, int],
    known: tuple[Excitation, Share, Feedback],
) -> Suggestion:
    """One pair of input and output; `known`: how the input moves, what it explains, its loop."""
    column, output = pair
    moves, share, loop = known
    spec = recipe.channel(data.name)
    band = spectrum(data, column, output).band_hz()
    verdict, advice = _verdict(data, spec, column, (moves, band, share))
    delay = None if band is None and verdict != "good" else _delay(data, column, output)
    through = [name for name in spec.reference if name != data.inputs[column].name]
    if verdict == "good" and (loop.closed or through):
        advice = "; ".join(filter(None, (_through(through), advice)))
        # the input follows the output more than the output follows the input
        if through or (delay is not None and delay.feedback):
            verdict = "closed loop"
    return Suggestion(
        flight=log.name,
        recipe=recipe.name,
        channel=data.name,
        input=data.inputs[column].name,
        output=data.outputs[output].name,
        verdict=verdict,
        advice=advice,
        rate_hz=1.0 / data.dt_s,
        duration_s=len(data) * data.dt_s,
        input_rms=moves.rms,
        input_unit=data.inputs[column].unit,
        coherence=share.value,
        band_hz=band,
        delay_s=None if delay is None else delay.delay_s,
        delay_low_s=None if delay is None else delay.low_s,
        delay_high_s=None if delay is None else delay.high_s,
        sign=0 if delay is None else delay.sign,
        feedback=loop.closed,
    )


def _through(reference: Sequence[str]) -> str:
    """What to do with a pair inside a loop; `reference` drives it, if known."""
    names = "".join(f" --reference {name}" for name in reference)
    does = (
        f"measures through what drives it:{names}" if names else "shows where the response is the vehicle's"
    )
    return f"recorded in closed loop, which may bias a fit; 'flysid tf' {does}"


def _delay(data: Dataset, column: int, output: int) -> Delay | None:
    try:
        return estimate_delay(data, column, output)
    except DataError:
        return None


def _verdict(
    data: Dataset,
    spec: ChannelSpec,
    column: int,
    found: tuple[Excitation, tuple[float, float] | None, Share],
) -> tuple[Verdict, str]:
    """In this order: nothing moved, too short, too slow, not explained or in a narrow band, good."""
    moves, band, share = found
    name = data.inputs[column].name
    unit = data.inputs[column].unit
    rate = 1.0 / data.dt_s
    duration = len(data) * data.dt_s
    if moves.quiet:
        return "too quiet", f"{name} moves by {moves.rms:.2g} {unit} rms; fly steps, doublets or a sweep"
    if duration < MIN_DURATION_S:
        return (
            "too short",
            f"{duration:.0f} s in segments; fly at least {MIN_DURATION_S:.0f} s without pauses",
        )
    if rate < spec.min_rate_hz:
        remedy = f"; {spec.remedy}" if spec.remedy else ""
        slow = f"logged at {rate:.3g} Hz, seen up to {rate / 2:.2g} Hz; this needs {spec.min_rate_hz:.3g} Hz"
        return "too slow", slow + remedy
    if share.high < GOOD_COHERENCE:
        return "weak", f"{share.words} of the output's power follows {name}; {ALONE}"
    if share.value < GOOD_COHERENCE and share.low > 0.0:
        part = f"perhaps only {100.0 * share.value:.0f} %"
        return "weak", f"{part} of the output's power follows {name}; {ALONE}"
    if band is None and share.low == 0.0:
        return "weak", f"the output is not shown to follow {name} at any frequency; {ALONE}"
    if band is not None and is_narrow(band):
        return "weak", f"the output follows {name} in a narrow band only; {ALONE}"
    return "good", too_short_alone(duration)
