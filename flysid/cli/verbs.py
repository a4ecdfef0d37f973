"""The verbs of the command line: one row each, read by --help without importing the verb.

A verb is its module `flysid/cli/NAME.py` with a click command called `command`, and its row here. Another
package adds one with an entry point of the group "flysid.verbs" that names a `Verb`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

ENTRY_POINTS = "flysid.verbs"
OTHERS = "More"
"""The heading of verbs of other packages."""


class Verb(NamedTuple):
    """A verb.

    `name`: what a user types.
    `summary`: what it does, in one line.
    `examples`: command lines, for the end of its help.
    `step`: heading that the help lists it under.
    `command`: "module:name" of its click command; "" for flysid's own, in `flysid.cli.NAME`.

    >>> from flysid.cli.verbs import Verb
    >>> Verb("weigh", "Weigh a vehicle.", command="mypackage.weigh:command").step
    'More'
    """

    name: str
    summary: str
    examples: Sequence[str] = ()
    step: str = OTHERS
    command: str = ""

    @property
    def epilog(self) -> str:
        """The examples as click prints them, one a line."""
        lines = ["\b", "Examples:", *(f"  {line}" for line in self.examples)]
        return "\n".join(lines) if self.examples else ""


def _rows(**steps: Sequence[Sequence[str]]) -> Mapping[str, Verb]:
    """The verbs of every step by name, each from its name, its summary and its examples."""
    return {
        name: Verb(name, summary, tuple(examples), step)
        for step, verbs in steps.items()
        for name, summary, *examples in verbs
    }


VERBS = _rows(
    Look=(
        (
            "review",
            "Review a log: does the vehicle fly well, and what should be changed?",
            "flysid review flight.bin",
            "flysid review flight.ulg -o review.html",
        ),
        (
            "doctor",
            "Check logs: contents, losses, and what to log next time.",
            "flysid doctor logs/ --json",
            "flysid doctor flight.ulg --kinematics",
        ),
        (
            "show",
            "Show a flight or one of its streams: fields, units, rates, losses.",
            "flysid show flight.bin ATT",
            "flysid show data 0042 --params",
        ),
        (
            "plot",
            "Plot fields of a log over time, with modes and messages.",
            "flysid plot data --flight 0042 --pair attitude --between 2:00..3:30 --mode LOITER",
            "flysid plot flight.bin ATT.DesRoll,ATT.Roll 'RCOU.C*' -o roll.png",
        ),
        (
            "spectrum",
            "Show at which frequencies a vehicle shakes: peaks and their causes.",
            "flysid spectrum flight.bfl",
            "flysid spectrum flight.ulg sensor_combined.accelerometer_m_s2[2] --plot spectrum.png",
        ),
        (
            "ls",
            "List flights, and what they can identify.",
            "flysid ls data",
            "flysid ls flight.bin --suggest",
        ),
        (
            "recipes",
            "List the recipes, or explain one; which ones fit a log.",
            "flysid recipes --for flight.bin",
            "flysid recipes px4-rates --toml",
        ),
        (
            "studio",
            "Browse logs, fit, judge and compare in the browser.",
            "flysid studio data",
            "flysid studio --live udp:0.0.0.0:14550 --watch run",
        ),
    ),
    Prepare=(
        (
            "ingest",
            "Read flight logs into a folder of typed Parquet tables.",
            "flysid ingest logs/ -o data",
            "flysid ingest flight.bin 'more/*.ulg' -o data",
        ),
        (
            "record",
            "Record MAVLink links to a tlog, with losses counted.",
            "flysid record udp:0.0.0.0:14550 -o flight.tlog",
            "flysid record serial:/dev/ttyUSB0:57600 -o flight.tlog --rotate boot",
        ),
        (
            "synth",
            "Simulate flights and write the logs that the vehicle would have written.",
            "flysid synth -o logs",
            "flysid synth -o logs --plan steps --duration 30 --format tlog",
        ),
        (
            "scrub",
            "Write a copy of a log without positions, serial numbers and names.",
            "flysid scrub flight.tlog -o shared.tlog",
            "flysid scrub flight.bin -o shared.bin --force",
        ),
        (
            "plan",
            "Plan the next flight, and predict the accuracy of its results.",
            "flysid plan --axis roll=0.1 --axis pitch=0.1 --band 0.3 12 -o plan",
            "flysid plan run --more 3 --aim 4",
        ),
    ),
    Fit=(
        (
            "fit",
            "Fit linear and Takagi-Sugeno models to flights.",
            "flysid fit data --recipe ardupilot-attitude -o run",
            "flysid fit flight.bin -r ardupilot-attitude --between 2:00..6:30 --mode LOITER -o run",
        ),
        (
            "tf",
            "Identify transfer functions with intervals, and measure the frequency response.",
            "flysid tf data -r ardupilot-attitude --plot bode.png",
            "flysid tf flight.csv --from pitch_cmd --to v_x --poles 2",
        ),
        (
            "step",
            "Estimate step responses from ordinary flight; compare two logs.",
            "flysid step flight.bfl -r betaflight-rate -c roll_rate --plot step.png",
            "flysid step before.bfl -r betaflight-rate -c roll_rate --against after.bfl",
        ),
        (
            "vehicle",
            "Fit one model of the whole vehicle: thrust, torques, lag, drag.",
            "flysid vehicle flight.ulg -o vehicle",
            "flysid vehicle first.csv second.csv --calm -o vehicle",
        ),
    ),
    Judge=(
        (
            "validate",
            "Compare fitted models on held-out segments; write the report.",
            "flysid validate run -o paper --markdown --figures pdf",
            "flysid validate run --with sim=sys.mat --with mine=sim:simulate",
        ),
        (
            "compare",
            "Compare the models of two runs on flights that neither has trained on.",
            "flysid compare run-4.5 run-4.6 -o both",
            "flysid compare old new --fail-if 'free_run.change_pct > 5'",
        ),
        (
            "runs",
            "List run folders and rank them by free-run error.",
            "flysid runs",
            "flysid runs experiments/ --json",
        ),
        (
            "gains",
            "Crossover, margins, bandwidth and noise of the gains in a log.",
            "flysid gains flight.bfl",
            "flysid gains data --axis roll --plot loop.png",
        ),
        (
            "filters",
            "Show what a gyro's filters cost and remove, beside others.",
            "flysid filters flight.bfl",
            "flysid filters flight.bfl --try 'notch 86 40' --without gyro_lpf2",
        ),
        (
            "predict",
            "Predict a rate loop under other gains or filters, beside what it is.",
            "flysid predict flight.bfl --set 'p_roll=58,d_roll=38'",
            "flysid predict data --file new.params --axis roll --json",
        ),
        (
            "design",
            "Robust controller gains beside the present ones: of rate loops from logs, of position loops.",
            "flysid design flight.bfl -o design",
            "flysid design run --for px4 --old vehicle.params --gain 0.85..1.15 --delay 0..0.04 -o design",
        ),
        (
            "fly",
            "Test a design's gains on many vehicles, simulated or a run's models, beside the present ones.",
            "flysid fly design --on run -o trials.html",
            "flysid fly design --vehicles 100 --wind 4 -o trials.html",
        ),
        (
            "watch",
            "Raise an alarm when a vehicle no longer behaves as a run's models predict.",
            "flysid watch run crash.bin",
            "flysid watch run udp:0.0.0.0:14550 --fail",
        ),
        (
            "reproduce",
            "Reproduce a paper's results and compare them.",
            "flysid reproduce ardrone-ts",
            "flysid reproduce ardrone-ts --figures figures",
        ),
    ),
    Share=(
        (
            "export",
            "Export a flight or a model (C99, FMU, MATLAB, CasADi, JAX, ONNX) to other programs.",
            "flysid export flight.bin ATT RATE --to mat",
            "flysid export run --channel longitudinal --c longitudinal-c --float32",
        ),
        (
            "import",
            "Import a linear model from MATLAB or python-control.",
            "flysid import sys.mat --run run -c longitudinal -o sim.json",
            "flysid import plant.npz --run run -o plant.json",
        ),
    ),
    Many=(
        (
            "fleet",
            "Work with many logs of many vehicles: catalogue, upkeep, models.",
            "flysid fleet ls s3://lake --vehicle v017",
            "flysid fleet changed s3://lake -r px4-effort",
        ),
    ),
    Try=(
        (
            "demo",
            "Simulate flights, ingest, fit and validate them; open the report.",
            "flysid demo",
            "flysid demo --plant ardrone-linear -o linear",
        ),
    ),
)
"""flysid's own, by name; the help lists steps and verbs in this order: what a user does first comes first."""

FLEET_VERBS = _rows(
    Commands=(
        ("changed", "List vehicles that have changed, or differ from the rest of the fleet."),
        ("check", "Compare a lake's manifests with its tables and its catalogue."),
        ("compact", "Put many small tables into few large ones, a message and a month each."),
        ("files", "Print the addresses of the parquet files that hold a message."),
        ("fit", "Linear models of any group of flights; runs of every vehicle."),
        ("forget", "Remove everything of a vehicle from a lake."),
        ("ls", "List a fleet's flights from its catalogue."),
    ),
)
"""Verbs of `flysid fleet`, in `flysid/cli/fleet_NAME.py`."""
