"""What a page needs before its lines can be typed, and the lines that do not simply end with 0."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from tests.doors import inputs
from tests.doors.inputs import Prepare, each, lines, program, real
from tests.doors.links import flown, heard, notified, recorded, served, until
from tests.doors.reader import Done, Reader

Drive = Callable[[Reader, str], Done]


@dataclass(frozen=True)
class Scene:
    """Of one page; lines are named by their commands, without the remark behind.

    Attributes
    ----------
    before : what is done before a line; "" before the first.
    codes : exit codes other than 0.
    drives : lines that run until Ctrl-C, or ask, with what happens meanwhile.
    shown : which of the page's blocks without a language shows a part of what a line prints.
    """

    before: Mapping[str, Prepare] = field(default_factory=dict)
    codes: Mapping[str, int] = field(default_factory=dict)
    drives: Mapping[str, Drive] = field(default_factory=dict)
    shown: Mapping[str, int] = field(default_factory=dict)

    def names(self) -> set[str]:
        """All lines that it names."""
        return {*self.before, *self.codes, *self.drives, *self.shown} - {""}


WATCH = "flysid watch run udp:0.0.0.0:14550"
HIRO = real("blackbox/hiro_highP_highD.bfl", "flight.bfl")
COPTER = real("dataflash/copter_437s.bin", "flight.bin")
SHORT = f"{inputs.FAST.replace('routine', 'pilot')} --format ulog --duration 30"
SERIES = lines(*(f"flysid synth -o flights {SHORT} --seed {seed}" for seed in (1, 2)))
"""Flights of one vehicle, in their order."""
PX4 = f"flysid synth -o px4 {inputs.ARDUPILOT.replace('routine', 'pilot')} --format ulog"
LIVE = "flysid synth --plant ardrone --plan pilot --live udp:127.0.0.1:14550"
INTERRUPTED = 130
LAKE = "s3://company/lake"

SCENES: dict[str, Scene] = {
    "README.md": Scene(
        before={
            "make demo": inputs.repository,
            "flysid flight.bin": inputs.few_logs,
            "flysid fit flight.csv --from pitch_cmd --to v_x -o csv-run": inputs.table_log,
            "flysid compare run other-run": inputs.other_run,
            "flysid gains flight.bfl": HIRO,
            "flysid spectrum flight.bfl": HIRO,
            "flysid studio data --live udp:0.0.0.0:14550 --watch run": inputs.watched,
            "flysid ingest s3://inbox -o s3://lake --vehicle-in 'v[0-9]+'": inputs.buckets(
                "s3://inbox", "s3://lake"
            ),
        },
        codes={
            "flysid watch run crash.bin --fail": 6,
            "flysid studio data": INTERRUPTED,
        },
        drives={
            "flysid record udp:0.0.0.0:14550 -o today.tlog": recorded("today.tlog"),
            "flysid studio data": served,
            "flysid studio data --live udp:0.0.0.0:14550 --watch run": served,
            WATCH: flown,
        },
        shown={"make demo": 0},
    ),
    "docs/design.md": Scene(
        before={
            "": inputs.demo,
            "flysid design run --for px4 --old vehicle.params -o px4-gains": lines(
                "printf 'MPC_XY_P 0.95\\nMPC_XY_VEL_P_ACC 1.8\\nMPC_XY_VEL_I_ACC 0.4\\n"
                "MPC_XY_VEL_D_ACC 0.2\\nMPC_VELD_LP 5\\n' > vehicle.params"
            ),
        },
        codes={
            # the vertical channel is no tilt
            "flysid design run --for px4 --old vehicle.params -o px4-gains": 3,
            # a common Lyapunov function of the demo's rules does not exist; the page says that this happens
            "flysid design run --method pdc --limit 12 -o rule-gains": 1,
        },
    ),
    "docs/export.md": Scene(
        before={
            "": inputs.three_loops,
            "cd longitudinal-c && cmake -B build && cmake --build build && ctest --test-dir build": program(
                "cmake"
            ),
        },
    ),
    "docs/fleet-models.md": Scene({"": lines(inputs.px4_fleet("fleet"), "flysid ingest fleet -o data -q")}),
    "docs/fleet.md": Scene(
        before={"": inputs.buckets("s3://inbox/logs", "s3://company")},
        codes={f"flysid ingest s3://inbox/logs -o {LAKE} --watch 5m": INTERRUPTED},
        drives={
            f"flysid ingest s3://inbox/logs -o {LAKE} --watch 5m": until("next look in"),
            f"flysid fleet forget {LAKE} --vehicle v017": lambda reader, line: reader.run(line, said="y\n"),
        },
    ),
    "docs/gains.md": Scene(
        before={
            "": each(
                real("blackbox/greenreaper_flight26.bfl", "flight.bfl", "logs/one.bfl"),
                real("blackbox/greenreaper_flight14.bfl", "logs/two.bfl"),
                lines("flysid ingest logs -o data -q"),
            )
        },
        shown={"flysid gains flight.bfl": 0},
    ),
    "docs/index.md": Scene({"": COPTER}),
    "docs/vibration.md": Scene(
        before={
            "": each(
                real("blackbox/hiro_highP_highD.bfl", "flight.bfl"),
                real("ulog/quad_position_76s.ulg", "flight.ulg"),
                real("blackbox/btfl_002.bbl", "hidden.bbl"),
                lines(f"cp {inputs.SAMPLES}/01-steps-seed2.tlog flight.tlog"),
            )
        },
        codes={"flysid filters hidden.bbl": 3},
        shown={"flysid spectrum flight.ulg": 0, "flysid filters flight.bfl --without 'gyro_notch 400'": 1},
    ),
    "docs/kinematics.md": Scene({"": inputs.motion_capture}),
    "docs/models.md": Scene(
        {
            "": lines(
                "flysid synth -o logs --plant ardrone --plan steps --duration 20 --format blackbox"
                " --sensor autopilot --no-truth -q",
                "flysid ingest logs -o data -q",
            )
        }
    ),
    "docs/mpc.md": Scene({"": inputs.controller, "python mpc.py": inputs.package("casadi")}),
    "docs/own-models.md": Scene(
        before={
            "": inputs.models_of_others,
        },
    ),
    "docs/plan.md": Scene(
        before={
            "": inputs.roll_and_pitch,
            (
                "flysid ingest sample_logs -o data && "
                "flysid fit data -r ardrone-synthetic -c longitudinal --models arx -o run"
            ): lines(f"rm -r data run && cp -r {inputs.SAMPLES} sample_logs"),
        },
    ),
    "docs/recipes.md": Scene(
        {
            "": lines(
                f"{PX4} --duration 170 && mv px4/01-pilot-seed1.ulg px4/0042.ulg",
                f"{PX4} --duration 60 --seed 2 && mv px4/01-pilot-seed2.ulg px4/0043.ulg",
                "flysid ingest px4 -o data -q",
            )
        }
    ),
    "docs/predict.md": Scene(
        before={
            "": each(
                real("blackbox/greenreaper_flight26.bfl", "flight.bfl"),
                lines("printf 'set p_roll = 58\nset d_roll = 28\n' > new.params"),
            )
        },
    ),
    "docs/rate-design.md": Scene(before={"": real("blackbox/hiro_highP_lowD.bfl", "flight.bfl")}),
    "docs/recording.md": Scene(
        drives={"flysid record udp:0.0.0.0:14550 -o flight.tlog": recorded("flight.tlog")},
    ),
    "docs/report.md": Scene(
        before={
            "": inputs.roll_and_pitch,
            "flysid compare old new --fail-if 'free_run.ci95.low > 0'": inputs.two_runs,
        },
        codes={"flysid compare old new --fail-if 'free_run.ci95.low > 0'": 4},  # the new one is worse
    ),
    "docs/review.md": Scene({"": each(COPTER, SERIES)}),
    "docs/settings.md": Scene(
        before={
            'eval "$(_FLYSID_COMPLETE=zsh_source flysid)"': program("zsh"),
            "_FLYSID_COMPLETE=fish_source flysid | source": program("fish"),
        },
    ),
    "docs/structured.md": Scene({"": inputs.hover}),
    "docs/studio.md": Scene(
        before={"": inputs.watched},
        codes={
            "flysid studio data": INTERRUPTED,
        },
        drives={
            "flysid studio data": served,
            "flysid studio data --live udp:0.0.0.0:14550 --watch run": served,
        },
    ),
    "docs/transfer-functions.md": Scene(
        codes={
            "flysid tf log.csv --from u --to rate --reference chirp --reference-at input"
            " --fail-if 'loop.phase_margin_deg.low < 45'": 4
        },
        before={
            "flysid tf flight.bin -r ardupilot-sysid -c mix_roll": inputs.chirp_log,
            "flysid step flight.bfl -r betaflight-rate -c roll_rate --horizon 0.5 --plot step.png": each(
                real("blackbox/greenreaper_flight14.bfl", "flight.bfl", "before.bfl"),
                real("blackbox/greenreaper_flight26.bfl", "after.bfl"),
            ),
        },
    ),
    "docs/vehicle.md": Scene(
        codes={LIVE: INTERRUPTED},
        drives={LIVE: heard},
    ),
    "docs/watching.md": Scene(
        before={
            "": inputs.watched,
            "flysid watch vehicle later.bbl --fail --json": inputs.vehicle_and_flight,
        },
        codes={"flysid watch run crash.bin --fail --json": 6},
        drives={WATCH: flown, f"{WATCH} --exec ./notify.sh": notified},
    ),
    "docs/tutorials/blackbox.md": Scene({"": HIRO}),
    "docs/tutorials/dataflash.md": Scene({"": COPTER}),
    "docs/tutorials/systemid.md": Scene({"": inputs.chirp_log}),
}
REGISTRY = "it asks a package registry; CI's fresh clone installs flysid with its extras"
NOT_TYPED: dict[str, dict[str, str]] = {
    "README.md": {
        "make test": "it is what runs the doors",
        "make doors": "it is this",
        "pip install .": REGISTRY,
    },
    "docs/export.md": {
        'pip install "flysid[mpc]"': REGISTRY,
        "flysid export run --channel longitudinal --onnx longitudinal.onnx": (
            "it needs onnx; tests/flysid/export/test_onnx.py gives the command where that is"
        ),
    },
    "docs/fleet.md": {'pip install "flysid[fleet]"': REGISTRY},
    "docs/index.md": {"flysid demo": "README's `make demo` is this command"},
    "docs/mpc.md": {"pip install casadi": REGISTRY},
    "docs/own-models.md": {
        "flysid validate run --with lateral/sim=plant.fmu --start sim=v0": (
            "the FMU is a program of the reader's; flysid's own are run in tests/flysid/outside/test_fmus.py"
        )
    },
    "docs/recording.md": {
        (
            "flysid record serial:/dev/ttyUSB0:57600 udp:0.0.0.0:14550 -o today.tlog"
            " --rotate 256MB --rotate boot"
        ): "no test may make a device; tests/flysid/live/test_recording.py has a pseudo terminal",
        "flysid record tcp:192.168.1.10:5760 -o signed.tlog --key vehicle.key": (
            "the address is another machine's; loopback stands for it in tests/flysid/live"
        ),
    },
    "docs/studio.md": {'pip install "flysid[studio]"': REGISTRY},
}
"""Lines that no door types, with the reason."""
ALL = "ALL_DOORS"
"""The variable with which `make soak` asks for the pages of `LONG`, too."""
LONG: dict[str, int] = {
    "docs/design.md": 50,
    "docs/export.md": 17,
    "docs/fleet.md": 38,
    "docs/fleet-models.md": 7,
    "docs/gains.md": 18,
    "docs/index.md": 14,
    "docs/models.md": 17,
    "docs/mpc.md": 11,
    "docs/own-models.md": 13,
    "docs/plan.md": 18,
    "docs/predict.md": 15,
    "docs/rate-design.md": 15,
    "docs/recipes.md": 13,
    "docs/report.md": 20,
    "docs/review.md": 18,
    "docs/structured.md": 214,  # at least: the fit of hover.parquet was not waited for
    "docs/studio.md": 11,
    "docs/transfer-functions.md": 34,
    "docs/vehicle.md": 11,
    "docs/vibration.md": 17,
    "docs/watching.md": 19,
}
"""Pages that `make soak` alone types: together the doors may cost 120 s of CPU. Measured, in seconds."""
LONG_LINES: dict[str, frozenset[str]] = {
    "README.md": frozenset(
        {
            "flysid gains flight.bfl",
            "flysid spectrum flight.bfl",
            "flysid filters flight.bfl --try 'notch 224 60'",
            "flysid vehicle flight.bfl -o vehicle",
            "flysid design flysid-demo/run --limit 12 --old vehicle.params -o gains",
            "flysid fly gains --vehicles 30 --wind 4",
            "flysid ingest s3://inbox -o s3://lake --vehicle-in 'v[0-9]+'",
            "flysid fleet ls s3://lake --where \"vehicle = 'v017' and start > '2026-10-01'\"",
            "flysid fleet changed s3://lake -r px4-effort",
        }
    ),
    "docs/tutorials/dataflash.md": frozenset(
        {"flysid fit flight.bin --recipe ardupilot-attitude -o run", "flysid validate run"}
    ),
    "docs/tutorials/rig.md": frozenset(
        {"flysid fit rig.csv --from throttle_pct --to speed_rpm -o run", "flysid validate run"}
    ),
    "docs/tutorials/ulog.md": frozenset(
        {"flysid fit 01-steps-seed1.ulg --recipe px4-velocity -c v_x -o run", "flysid validate run"}
    ),
}
"""Lines of the other pages that `make soak` alone types, for the same reason."""
