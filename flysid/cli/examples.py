"""Two examples for every verb: the end of its --help, and parsed by a test."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "compare": (
        "flysid compare run-4.5 run-4.6 -o both",
        "flysid compare old new --fail-if 'free_run.change_pct > 5'",
    ),
    "demo": ("flysid demo", "flysid demo --plant ardrone-linear -o linear"),
    "design": (
        "flysid design run -c longitudinal --limit 12 -o design",
        "flysid design run --for px4 --old vehicle.params --gain 0.85..1.15 --delay 0..0.04 -o design",
    ),
    "doctor": ("flysid doctor logs/ --json", "flysid doctor flight.ulg --kinematics"),
    "export": (
        "flysid export flight.bin ATT RATE --to mat",
        "flysid export run --channel longitudinal --c longitudinal-c --float32",
    ),
    "fit": (
        "flysid fit data --recipe ardupilot-attitude -o run",
        "flysid fit flight.bin -r ardupilot-attitude --between 2:00..6:30 --mode LOITER -o run",
    ),
    "fleet": ("flysid fleet ls s3://lake --vehicle v017", "flysid fleet changed s3://lake -r px4-effort"),
    "fly": (
        "flysid fly design --vehicles 100 --wind 4 -o trials.html",
        "flysid fly design --mass 1..1.4 --json",
    ),
    "gains": ("flysid gains flight.bfl", "flysid gains data --axis roll --plot loop.png"),
    "import": (
        "flysid import sys.mat --run run -c longitudinal -o sim.json",
        "flysid import plant.npz --run run -o plant.json",
    ),
    "ingest": ("flysid ingest logs/ -o data", "flysid ingest flight.bin 'more/*.ulg' -o data"),
    "ls": ("flysid ls data", "flysid ls flight.bin --suggest"),
    "plan": (
        "flysid plan --axis roll=0.1 --axis pitch=0.1 --band 0.3 12 -o plan",
        "flysid plan run --more 3 --aim 4",
    ),
    "plot": (
        "flysid plot data --flight 0042 --pair attitude --between 2:00..3:30 --mode LOITER",
        "flysid plot flight.bin ATT.DesRoll,ATT.Roll 'RCOU.C*' -o roll.png",
    ),
    "recipes": ("flysid recipes --for flight.bin", "flysid recipes px4-rates --toml"),
    "record": (
        "flysid record udp:0.0.0.0:14550 -o flight.tlog",
        "flysid record serial:/dev/ttyUSB0:57600 -o flight.tlog --rotate boot",
    ),
    "reproduce": ("flysid reproduce ardrone-ts", "flysid reproduce ardrone-ts --figures figures"),
    "runs": ("flysid runs", "flysid runs experiments/ --json"),
    "scrub": ("flysid scrub flight.tlog -o shared.tlog", "flysid scrub flight.bin -o shared.bin --force"),
    "show": ("flysid show flight.bin ATT", "flysid show data 0042 --params"),
    "step": (
        "flysid step flight.bfl -r betaflight-rate -c roll_rate --plot step.png",
        "flysid step before.bfl -r betaflight-rate -c roll_rate --against after.bfl",
    ),
    "studio": ("flysid studio data", "flysid studio --live udp:0.0.0.0:14550 --watch run"),
    "synth": ("flysid synth -o logs", "flysid synth -o logs --plan steps --duration 30 --format tlog"),
    "tf": (
        "flysid tf data -r ardupilot-attitude --plot bode.png",
        "flysid tf flight.csv --from pitch_cmd --to v_x --poles 2",
    ),
    "watch": ("flysid watch run crash.bin", "flysid watch run udp:0.0.0.0:14550 --fail"),
    "validate": (
        "flysid validate run -o paper --markdown --figures pdf",
        "flysid validate run --with sim=sys.mat --with mine=sim:simulate",
    ),
}


def epilog(verb: str) -> str:
    """The examples as click prints them, one a line."""
    lines = EXAMPLES.get(verb, ())
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in lines)]) if lines else ""
