"""`flysid predict LOG...`: what a rate loop would be under other settings, beside what it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.options import picture_options
from flysid.cli.output import explain, print_json, say, say_drawn
from flysid.cli.source import flight_options, flights_of_one_vehicle, reading_options
from flysid.cli.trust import Setting
from flysid.escaping import one_line
from flysid.showing import fold

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.loops.forecast import Forecast
    from flysid.loops.margins import Figure

AXES = ("roll", "pitch", "yaw")


@click.command("predict")
@click.argument("source", type=SOURCE)
@click.option(
    "--set",
    "words",
    cls=Setting,
    default="",
    metavar="NAME=VALUE,...",
    help="Settings by the firmware's names.",
)
@click.option(
    "--file",
    "file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Settings of a file: NAME VALUE lines, a ground station's, or 'set NAME = VALUE' lines.",
)
@click.option("--axis", "axes", multiple=True, type=click.Choice(AXES), help="[default: those that change]")
@flight_options
@picture_options("the responses")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@reading_options
def command(
    source: Path,
    words: str,
    file: Path | None,
    axes: tuple[str, ...],
    selection: Selection,
    plot: Path | None,
    as_json: bool,
    reading: Reading,
) -> int:
    """Predict a rate loop under other gains or filters: response, margins, step, noise, time at the limit.

    The plant is measured from the response to the sticks, and both controllers are the firmware's law, which
    is checked against the terms that the log recorded. Everything is printed beside what it is under the
    present settings, those of the last flight. With three flights or more the intervals hold for the next
    flight; with fewer, for these. Exit code 3: nothing is known of any axis, or a log was
    read with losses.
    """
    from flysid.errors import DataError, UsageError
    from flysid.loops.forecast import forecast
    from flysid.loops.new_settings import read_settings, settings_in

    changes = (read_settings(file) if file is not None else {}) | settings_in(words)
    if not changes:
        raise UsageError("no other settings are given", hint="--set 'p_roll=58,d_roll=38' or --file NEW")
    found: list[Forecast] = []
    refused: dict[str, DataError] = {}
    with Display().shown(), flights_of_one_vehicle(source, reading, selection) as chosen:
        for axis in axes or _named(changes):
            try:
                found.append(forecast(chosen.logs, axis, changes))
            except DataError as error:
                refused[axis] = error
    if as_json:
        left_out = {axis: why.message for axis, why in refused.items()}
        body = {"settings": changes, "axes": [one.to_dict() for one in found], "refused": left_out}
        print_json(body)
    else:
        click.echo(
            "\n\n".join("\n".join(fold(one_line(line)) for line in describe_forecast(one)) for one in found)
        )
        if found:
            explain(CAUTION)
    if plot is not None and found:
        from flysid.loops.forecast_plot import draw_forecasts
        from flysid.pictures import save_picture

        say_drawn("responses", plot, lambda: save_picture(draw_forecasts(found), plot))
    for axis, why in refused.items():
        say(f"{axis}: refused: {why.message}; try: {why.hint}")
    return 0 if found else 3


CAUTION = (
    "Calculated from past flights; nothing was tested on the vehicle. It holds for small motions below the "
    "motors' limits. Fly new settings first in a simulator, then high, in calm air, with a way back."
)


def _named(changes: dict[str, str]) -> tuple[str, ...]:
    """Axes that settings name; roll and pitch where they name none."""
    letters = {"RLL": "roll", "PIT": "pitch", "YAW": "yaw"}
    named = [axis for axis in AXES if any(axis in name.lower() for name in changes)]
    named += [axis for code, axis in letters.items() if any(f"_{code}_" in name for name in changes)]
    return tuple(dict.fromkeys(named)) or AXES[:2]


def describe_forecast(one: Forecast) -> list[str]:
    """For people."""
    before, after = one.before, one.after
    whose = f"{len(one.flights)} flights" if len(one.flights) > 1 else one.flights[0]
    scope = "the next flight" if one.next_flight else "these flights; how flights differ takes three"
    rise = " -> ".join(_scaled(side.step.rise_s, 1000.0, " ms") for side in (before, after))
    over = " -> ".join(_scaled(side.step.overshoot, 100.0, " %") for side in (before, after))
    unknown = next((side.step.rise_s.why for side in (before, after) if side.step.rise_s.why), "")
    limited = " -> ".join(f"{100.0 * side.limited:.1f}" for side in (before, after))
    low, high = one.band_hz
    rows = [
        f"{one.axis}: {_gains(before.gains, after.gains)} ({whose})",
        *(f"  {_pair(one, *row)}" for row in ROWS),
        f"  step of the setpoint: rise {rise}, overshoot {over}" + (f" ({unknown})" if unknown else ""),
        f"  error over the flight {one.tracking.said('.2f', ' times')}, smaller with "
        f"{100.0 * one.better:.0f} %",
        f"  noise to the motors {one.noise.said('.2f', ' times')}; "
        f"at the output's limit {limited} % of the flight",
        f"  known from {low:.0f} to {high:.0f} Hz; the intervals hold for {scope}",
        f"  the law of {one.law} gives the flown response to {100.0 * one.off:.0f} %",
    ]
    if one.moved_db < one.known_to_db:
        rows.append(
            f"  not determined: the response changes by {one.moved_db:.1f} dB, and is known to "
            f"{one.known_to_db:.1f} dB; the next flight may be nearer to this one"
        )
    if after.unstable > 0.0:
        rows.append(
            f"  caution: {100.0 * after.unstable:.0f} % of the plants that fit make this loop unstable"
        )
    return rows


def _gains(before: Mapping[str, float], after: Mapping[str, float]) -> str:
    """ "rollPID P 45 -> 60, I 80": of both sides."""
    names = dict.fromkeys([*before, *after])
    parts = []
    for name in names:
        old, new = (side.get(name) for side in (before, after))
        parts.append(f"{name} {_setting_text(old)}" + (f" -> {_setting_text(new)}" if old != new else ""))
    return ", ".join(parts)


ROWS = (
    ("crossover", "crossover_hz", ".1f", " Hz"),
    ("phase margin", "phase_deg", ".0f", " deg"),
    ("gain margin", "gain_db", ".1f", " dB"),
    ("delay margin", "delay_ms", ".1f", " ms"),
    ("peak sensitivity Ms", "ms", ".2f", ""),
    ("bandwidth (-3 dB)", "bandwidth_hz", ".1f", " Hz"),
)


def _pair(one: Forecast, words: str, name: str, form: str, unit: str) -> str:
    """A figure under the present settings and under the others."""
    old, new = (side.figures[name].said(form, unit) for side in (one.before, one.after))
    return f"{words} {old} -> {new}"


def _scaled(figure: Figure, factor: float, unit: str) -> str:
    """ "35 ms [33, 38]" in another unit."""
    if figure.value is None:
        return "not determined"
    value, low, high = (factor * part for part in (figure.value, figure.low, figure.high))
    return f"{value:.0f}{unit} [{low:.0f}, {high:.0f}]"


def _setting_text(value: float | None) -> str:
    return "none" if value is None else f"{value:g}"
