"""Step responses of every channel of a recipe, of one folder or of two over each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flysid.dataset import Dataset
from flysid.errors import DataError, RecipeError
from flysid.escaping import picture_text
from flysid.facts.modes import all_names
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.lake.lake import Lake
from flysid.model.frequency.response import measure_response
from flysid.model.step_response import StepResponse, step_response
from flysid.pictures import check_picture, save_picture
from flysid.progress import tell
from flysid.showing import fold
from flysid.validate.transfers.agreement import response_caution


@dataclass(frozen=True, eq=False)
class ChannelStep:
    """A step response of one channel of one folder.

    Attributes
    ----------
    name : the channel.
    of : which folder, and which class of stick; "" where there is only one.
    caution : what contradicts it; "" where nothing does.
    """

    name: str
    of: str
    response: StepResponse
    caution: str = ""

    def line(self) -> str:
        """For people."""
        r = self.response
        head = ", ".join(filter(None, (self.name, self.of, r.words, f"{r.seconds:.0f} s")))
        rows = [f"{head}: {r.input.name} to {r.output.name}", *(f"  {f}" for f in r.figures)]
        if self.caution:
            rows.append(fold(f"  caution: {self.caution}"))
        return "\n".join(rows)

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        low, high = self.response.interval
        return {
            "channel": self.name,
            "of": self.of,
            "class": self.response.words,
            "caution": self.caution,
            "seconds": self.response.seconds,
            "figures": {f.name: f.to_dict() for f in self.response.figures},
            "time_s": self.response.time_s.tolist(),
            "step": self.response.step.tolist(),
            "low": low.tolist(),
            "high": high.tolist(),
        }


def channel_steps(
    lake: Lake,
    recipe_name: str,
    *,
    channels: Sequence[str] = (),
    horizon_s: float | None = None,
    fast: float | None = None,
    of: str = "",
    anyway: bool = False,
) -> tuple[list[ChannelStep], Mapping[str, str]]:
    """Step responses of every channel, and why the others have none.

    Parameters
    ----------
    horizon_s : length of the responses; None lengthens each until it has settled.
    anyway : also where a loop is closed, with a caution beside the figures.
    fast : tells a slow stick from a fast one, in the input's unit: two responses then.

    Raises
    ------
    RecipeError : `channels` names what the recipe does not have.
    """
    recipe = load_recipe(recipe_name)
    wanted = recipe.chosen(channels)
    held = lake.channels(recipe)
    found: list[ChannelStep] = []
    skipped: dict[str, str] = {}
    for i, name in enumerate(wanted):
        if name not in held:
            skipped[name] = "no flight holds its streams"
            continue
        tell("estimating the step response", channel=name, share=i / len(wanted))
        try:
            data, left_out = commanded_by_sticks(lake.dataset(recipe, name), recipe.channel(name).stick_modes)
            without = f"without {' and '.join(left_out)}" if left_out else ""
            for above, below in ((None, None),) if fast is None else ((None, fast), (fast, None)):
                response = step_response(data, horizon_s=horizon_s, above=above, below=below, anyway=anyway)
                words = ", ".join(filter(None, (response.words, without)))
                caution = "" if fast else _caution(data, response)
                found.append(ChannelStep(name, of, replace(response, words=words), caution))
        except (DataError, RecipeError) as error:
            skipped[name] = error.advice
    return found, skipped


def _caution(data: Dataset, response: StepResponse) -> str:
    """What the measured frequency response of the same record says otherwise."""
    try:
        return response_caution(measure_response(data), 0, response)
    except DataError:  # a record that shows no frequency response contradicts nothing
        return ""


def commanded_by_sticks(data: Dataset, modes: Sequence[str]) -> tuple[Dataset, tuple[str, ...]]:
    """What was flown in modes in which sticks command the input, and the modes that were left out.

    In the others an outer loop makes the input from the vehicle's own motion. That loop may be too slow for
    `feedback` to tell it from a pilot, but not for a step response, which then ends where the loop lets it.
    Stretches whose mode is not known stay.

    Raises
    ------
    DataError : nothing was flown in such a mode.
    """
    outer = all_names().difference(modes) if modes else frozenset()
    kept = [s for s in data.segments if s.marks.get("mode") not in outer]
    flown = dict.fromkeys(str(s.marks["mode"]) for s in data.segments if s.marks.get("mode") in outer)
    if not kept:
        names = " and ".join(s.name for s in data.inputs)
        raise DataError(
            f"loop: not a step response. In {' and '.join(flown)} no stick commands {names}: a loop around "
            "velocity or position does, which reacts to the vehicle",
            hint="fly in a mode in which the stick is an angle or a rate, e.g. " + " or ".join(modes[:2]),
        )
    return data.with_segments(kept), tuple(flown)


def draw_steps(steps: Sequence[ChannelStep], path: str | Path) -> None:
    """One panel a channel, every response with its 95 % band.

    Raises
    ------
    UsageError : matplotlib is missing, or the file's ending is not known. WriteError : cannot be written.
    """
    check_picture(path)
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(s.name for s in steps))
    figure = Figure(figsize=(8, 0.8 + 2.6 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 1, squeeze=False)[:, 0]
    for axis, name in zip(axes, names, strict=True):
        for step in (s for s in steps if s.name == name):
            r = step.response
            low, high = r.interval
            (line,) = axis.plot(
                r.time_s, r.step, label=picture_text(", ".join(filter(None, (step.of, r.words))) or name)
            )
            axis.fill_between(r.time_s, low, high, color=line.get_color(), alpha=0.25, linewidth=0)
            axis.set_ylabel(picture_text(f"{r.output.name}, {r.output.unit}"), fontsize=8)
        axis.set_title(picture_text(f"{name}: a step of {r.input.name}"), loc="left", fontsize=9)
        axis.grid(True, linewidth=0.3, alpha=0.6)
        axis.legend(fontsize=7)
    axes[-1].set_xlabel("s")
    save_picture(figure, path)
