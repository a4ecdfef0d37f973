"""`flysid demo`: the whole way from a flight to a verdict, on data that needs no download."""

from __future__ import annotations

import os
import shutil
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.output import check_target, cores, say
from flysid.cli.trust import Own
from flysid.errors import UsageError
from flysid.progress import part, tell

if TYPE_CHECKING:
    from flysid.validate.runs.judge import Judgement
    from flysid.validate.runs.run import Run

PLANS = {"ardrone": "demo", "ardrone-linear": "mixed"}
FLOWN = {
    "ardrone": "the nonlinear AR.Drone (rigid body, drag, limits)",
    "ardrone-linear": "the paper's loops (10), (11), (12)",
}
RECIPE = "ardrone-synthetic"
DURATION_S = 30.0
FLOWN_TIMES = 2  # the plan, so that
HOLDOUT = 0.5  # leaves more than four flights to the verdict, which then generalises
EFFORT = "quick"  # on seed 1 it finds what normal effort does; on others less (docs/measured/speed.md)
MARKER = ".flysid-demo"
LOOK_AT = (
    "In the report, look at",
    "  the cards: what was measured, and both models, over the ten seconds in which they differ most",
    "  the interval below each change: where it contains zero, these flights cannot tell the models apart",
    "  'Before you rely on this': what would make the models wrong on your next flight",
    "  the rules of longitudinal: what a degree of tilt is worth forwards and backwards, in words",
)


@dataclass(frozen=True)
class Stages:
    """Folders of the demo."""

    root: Path

    @property
    def logs(self) -> Path:
        return self.root / "logs"

    @property
    def data(self) -> Path:
        return self.root / "data"

    @property
    def run(self) -> Path:
        return self.root / "run"

    @property
    def report(self) -> Path:
        return self.run / "report"  # where 'flysid runs' looks for the verdict


@click.command("demo")
@click.option(
    "--output",
    "-o",
    default="flysid-demo",
    show_default=True,
    type=click.Path(path_type=Path),
    help="Folder.",
)
@click.option(
    "--plant", default="ardrone", show_default=True, type=click.Choice(list(PLANS)), help="Vehicle."
)
@click.option("--seed", default=1, show_default=True)
@click.option("--force", cls=Own, is_flag=True, help="Replace an earlier demo in that folder.")
@progress_options
def command(output: Path, plant: str, seed: int, force: bool, display: Display) -> None:
    """Simulate flights, ingest, fit (--effort quick) and validate them; print the path of the report.

    The vehicle is a nonlinear AR.Drone. With --plant ardrone-linear it is the paper's transfer functions
    (10), (11) and (12), where rules cannot help.
    """
    started = time.perf_counter()
    prepare(output, force)
    stages = Stages(output)
    with display.shown():
        with part(0.0, 0.02):
            say(f"  synthesise  {fly(stages, plant, seed)}", display.quiet)
        with part(0.02, 0.05):
            say(f"  ingest      {take_in(stages)}", display.quiet)
        before = time.perf_counter()
        with part(0.05, 0.8):
            run = fit(stages, seed)
        if run.interrupted:
            raise KeyboardInterrupt
        say(f"  fit         {describe_run(run, time.perf_counter() - before)}", display.quiet)
        with part(0.8, 1.0):
            judgement = judge(stages)
    say(f"  validate    {describe_judgement(judgement)}", display.quiet)
    from flysid.validate.show.terminal import summary

    for line in summary(judgement.comparisons).splitlines():
        say(f"  {line}", display.quiet)
    say(f"  {meaning(judgement)}", display.quiet)
    for line in judgement.context.missing.sentences:
        say(f"  {line}")
    say(f"  {time.perf_counter() - started:.0f} s in total", display.quiet)
    for line in LOOK_AT:
        say(f"  {line}", display.quiet)
    page = stages.report / "report.html"
    click.echo(str(page))
    if not display.quiet and has_display() and sys.stdout.isatty():
        click.launch(str(page))


def has_display() -> bool:
    """Whether a page that is opened can be seen."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def prepare(output: Path, force: bool) -> None:
    """An empty demo folder. With `force` an earlier demo is removed, and nothing but a demo."""
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        check_target(output, force)
        if not (output / MARKER).is_file():
            raise UsageError("not an earlier demo, so it is not replaced", path=output, hint="another -o")
        shutil.rmtree(output)
    from flysid.files import writing_to

    with writing_to(output):
        output.mkdir(parents=True, exist_ok=True)
        (output / MARKER).touch()


def fly(stages: Stages, plant: str, seed: int) -> str:
    """Fly the plan, each time with other signals; half of the flights are logged as tlog, half as MCAP."""
    from flysid.cli.synth import make_folder
    from flysid.files import write_atomically
    from flysid.ingest.synth.plans import plan_named
    from flysid.ingest.synth.synth import WRITERS, Order, flights

    order = Order(plant=plant, plan=PLANS[plant], duration_s=DURATION_S, seed=seed)
    tell(f"flying {FLOWN_TIMES * len(plan_named(order.plan))} flights", share=0.0)
    make_folder(stages.logs)
    writers = [WRITERS["tlog"], WRITERS["mcap"]]
    recordings = [r for i in range(FLOWN_TIMES) for r in flights(replace(order, seed=seed + i))]
    for i, recording in enumerate(recordings):
        suffix, encode = writers[i % 2]
        write_atomically(stages.logs / f"{recording.name}{suffix}", encode(recording))
    return (
        f"{len(recordings)} flights of {DURATION_S:.0f} s, {FLOWN[plant]}, "
        f"{order.noise} m/s of noise  -> tlog and MCAP"
    )


def take_in(stages: Stages) -> str:
    """Ingest the logs."""
    from flysid.ingest.lake.batch import ingest_logs
    from flysid.ingest.lake.finding import find_logs

    results = list(ingest_logs(find_logs([stages.logs]), stages.data, bounds=None))
    taken = [r.flight for r in results if r.flight is not None]
    lost = sum(flight.lossy for flight in taken) + sum(r.skipped for r in results)
    return f"{len(taken)} logs, {sum(flight.rows for flight in taken):,} records, {lost} with losses"


def fit(stages: Stages, seed: int) -> Run:
    """Fit all models to all channels."""
    from flysid.ingest.lake.lake import open as open_lake
    from flysid.validate.runs.fitting import fit_run
    from flysid.validate.runs.run import FitSettings

    settings = FitSettings(seed=seed, holdout=HOLDOUT, effort=EFFORT, remark="simulated flights")
    return fit_run(open_lake(stages.data), RECIPE, stages.run, settings, jobs=cores())


def describe_run(run: Run, seconds: float) -> str:
    """Models of any channel, channels, effort and wall time; channels are fitted side by side."""
    models = dict.fromkeys(label for channel in run.channels for label in channel.models)
    effort = run.settings.effort
    return f"{', '.join(models)} on {len(run.channels)} channels, --effort {effort} ({seconds:.0f} s)"


def judge(stages: Stages) -> Judgement:
    """Compare on the held-out part and write the page."""
    from flysid.validate.runs.judge import judge_run
    from flysid.validate.runs.run import open_run
    from flysid.validate.show.finish import finish, write_finished

    with part(0.0, 0.5):
        judgement = judge_run(open_run(stages.run))
    with part(0.5, 1.0):
        write_finished(finish(judgement, page=True), stages.report)
    return judgement


def describe_judgement(judgement: Judgement) -> str:
    """How much was held out."""
    tests = [c.test for c in judgement.comparisons.values()]
    flights = len({s.flight for t in tests for s in t.segments})
    seconds = max(len(t) * t.dt_s for t in tests)
    return f"free run on {flights} held-out flights, {seconds:.0f} s"


def meaning(judgement: Judgement) -> str:
    """What the verdicts say, in one line."""
    pairs = {name: pair for c in judgement.comparisons.values() for name, pair in c.verdict.items()}
    better = [name for name, pair in pairs.items() if pair.earned]
    if not better and all(pair.verdict in ("same", "worse") or pair.one_rule for pair in pairs.values()):
        return "One linear model per channel is enough here."
    if not better:
        return "These flights do not show that rules help. Read the report's first lines for why."
    enough = [name for name, pair in pairs.items() if pair.verdict in ("same", "worse") or pair.one_rule]
    open_ = [name for name in pairs if name not in (*better, *enough)]
    rest = f"; on {', '.join(enough)} a linear model is enough" if enough else ""
    rest += f"; on {', '.join(open_)} these flights do not tell" if open_ else ""
    return f"Rules help on {', '.join(better)}{rest}. Read the cautions in the report before you rely on it."
