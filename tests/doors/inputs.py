"""What the lines of a page are typed at: logs, runs, files of other programs, a store."""

from __future__ import annotations

import random
import shutil
import struct
import sys
from collections.abc import Callable
from pathlib import Path

from bench.closed_loop import Loop
from flysid.ingest.synth.writers.dataflash import MODE
from tests.command import ROOT
from tests.doors.reader import Reader
from tests.s3server import running_seaweedfs
from tests.samplelogs import ardrone, dataflash, dataflash_systemid

SAMPLES = ROOT / "sample_logs"
LOGS = ROOT.parent / "shared" / "logs"
ARDUPILOT = "--plant ardrone --plan routine --sensor telemetry-slow --no-truth -q"
FAST = ARDUPILOT.replace("telemetry-slow", "telemetry")
QUICK = "python -m tests.quick_flysid"
"""Runs that a page's lines begin from: three models that take no time to fit."""
Prepare = Callable[[Reader], None]


class MissingError(Exception):
    """This machine lacks something that a line needs."""


def each(*preparations: Prepare) -> Prepare:
    """One after another."""

    def prepare(reader: Reader) -> None:
        for preparation in preparations:
            preparation(reader)

    return prepare


def lines(*words: str) -> Prepare:
    """Lines that are not the page's."""
    return lambda reader: reader.prepare(*words)


def real(log: str, *names: str) -> Prepare:
    """A log that nobody here wrote, under the page's names."""

    def prepare(reader: Reader) -> None:
        for name in names:
            (reader.folder / name).parent.mkdir(exist_ok=True)
            shutil.copyfile(_there(LOGS / log), reader.folder / name)

    return prepare


def program(name: str) -> Prepare:
    """A program that flysid does not bring."""

    def prepare(_reader: Reader) -> None:
        if shutil.which(name) is None:
            raise MissingError(f"{name} is not installed")

    return prepare


def package(name: str) -> Prepare:
    """A Python package that no extra of flysid brings."""

    def prepare(reader: Reader) -> None:
        if reader.run(f"python -c 'import {name}'").returncode:
            raise MissingError(f"{name} is not installed")

    return prepare


def controller(reader: Reader) -> None:
    """The sample logs, and the page's controller as a file."""
    shutil.copytree(SAMPLES, reader.folder / "sample_logs")
    page = (ROOT / "docs" / "mpc.md").read_text("utf-8")
    script = page.partition("```python\n")[2].partition("```")[0]
    (reader.folder / "mpc.py").write_text(script, "utf-8")


def _there(path: Path) -> Path:
    if not path.exists():
        raise MissingError(f"no {path}")
    return path


def repository(reader: Reader) -> None:
    """A clone with its environment, for `make`."""
    for name in ("Makefile", "pyproject.toml"):
        shutil.copy2(ROOT / name, reader.folder)
    environment = reader.folder / ".venv"
    (environment / "bin").mkdir(parents=True)
    for found in Path(sys.executable).parent.iterdir():
        (environment / "bin" / found.name).symlink_to(found)
    (environment / ".installed").touch()


def chirp_log(reader: Reader) -> None:
    """A flight of ArduPilot's SYSTEMID mode, simulated; the same signals as a table."""
    (reader.folder / "flight.bin").write_bytes(dataflash_systemid.build())
    flown = Loop(0.1, seconds=dataflash_systemid.SECONDS).flown(1)
    segment = flown.segments[0]
    with (reader.folder / "log.csv").open("w", encoding="utf-8") as table:
        table.write("time_s,u,chirp,rate\n")
        for i, ((total, chirp), rate) in enumerate(zip(segment.u, segment.y[:, 0], strict=True)):
            table.write(f"{i * flown.dt_s},{total},{chirp},{rate}\n")


def few_logs(reader: Reader) -> None:
    """Logs of an ArduPilot copter, and one of each other kind that README names."""
    reader.prepare(
        f"flysid synth -o logs {ARDUPILOT} --duration 30 --format dataflash",
        f"cp {SAMPLES}/01-steps-seed2.tlog flight.tlog",
        "printf 'position 1\\nvelocity 10\\nintegral 2\\nderivative 0\\ncut_hz 5\\n' > vehicle.params",
    )
    for log in (reader.folder / "logs").iterdir():
        log.write_bytes(by_stick(log.read_bytes()))
    flown = (reader.folder / "logs" / "02-pilot-seed1.bin").read_bytes()
    (reader.folder / "flight.bin").write_bytes(flown + rates_and_outputs())


def by_stick(log: bytes) -> bytes:
    """A simulated flight in STABILIZE instead of GUIDED, in which no stick commands the attitude."""
    head = struct.pack("<HB", 0x95A3, MODE.number)
    at = log.index(head) + len(head) + 8
    return log[:at] + bytes(2) + log[at + 2 :]


def rates_and_outputs(seconds: int = 10, begin_us: int = 50_000_000) -> bytes:
    """RATE and RCOU at 10 Hz, to go behind a log that has neither."""
    types = {
        128: dataflash.TYPES[128],
        60: ("RATE", "Qfff", "TimeUS,RDes,R,ROut"),
        61: ("RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4"),
    }
    out = [dataflash.fmt(number, types) for number in (60, 61)]
    for i in range(10 * seconds):
        out.append(dataflash.pack(60, begin_us + i * 100_000, 1.0, 0.1 * i, 0.2, types=types))
        out.append(dataflash.pack(61, begin_us + i * 100_000, *(1500 + i % 7,) * 4, types=types))
    return b"".join(out)


def table_log(reader: Reader) -> None:
    """A table with a command and a velocity, of a first-order vehicle."""
    chance = random.Random(1)
    command = 0.0
    speed = 0.0
    rows = ["time_s,pitch_cmd,v_x"]
    for n in range(1500):
        if n % 25 == 0:
            command = chance.choice((-5.0, 0.0, 5.0))
        rows.append(f"{n / 25},{command},{speed + chance.gauss(0.0, 0.02):.4f}")
        speed += 0.05 * (0.4 * command - speed)
    (reader.folder / "flight.csv").write_text("\n".join(rows) + "\n")


other_run = lines(
    f"flysid synth -o other {ARDUPILOT} --duration 30 --format dataflash --seed 9",
    "flysid ingest other -o other-data -q",
    f"{QUICK} fit -j 1 other-data -r ardupilot-attitude -o other-run -q",
)
"""A run on the flights of another vehicle."""

watched = lines(
    "rm -rf run",
    f"flysid synth -o long {FAST} --duration 120 --format tlog",
    f"flysid synth -o late {FAST} --plan multisine --duration 40 --format tlog --seed 9 --change 1:1:lag:3",
    "mv late/01-multisine-seed9.tlog crash.bin",
    "flysid ingest long -o long-data -q",
    f"{QUICK} fit -j 1 long-data -r ardupilot-attitude --holdout 0.5 -o run -q",
)
"""A run of longer flights, as `watch` needs it, and a flight of a vehicle whose attitude is late."""

_LOGGED = "flysid synth --plant ardrone --plan pilot --duration 30 --format blackbox"
vehicle_and_flight = lines(
    f"{_LOGGED} --seed 1 -o motors",
    "flysid vehicle motors/01-pilot-seed1.bbl --zero 0 --full-scale 2047 -o vehicle -q",
    f"{_LOGGED} --seed 2 -o motors --force",
    "mv motors/01-pilot-seed2.bbl later.bbl",
)
"""A whole vehicle, and a later flight of it."""

three_loops = lines(
    f"flysid ingest {SAMPLES} -o data -q",
    "flysid fit data -r ardrone-synthetic -c longitudinal -m arx,oe,tf,ts --effort quick -o run -q",
)
"""The sample logs, and a run with a model of each kind that the pages export."""

roll_and_pitch = lines(
    f"flysid synth -o logs {ARDUPILOT} --duration 30 --format dataflash",
    "flysid ingest logs -o data -q",
    "flysid fit data -r ardupilot-attitude -m line,arx,ts --effort quick -o run -q",
)

demo = lines("flysid demo -o flysid-demo -q", "mv flysid-demo/run run")
"""The run of the demo: the vehicle that designs are flown on."""

two_runs = lines(
    "mv run old",
    f"flysid synth -o other {ARDUPILOT} --duration 30 --format dataflash --seed 9",
    "flysid ingest other -o other-data -q",
    f"{QUICK} fit -j 1 other-data -r ardupilot-attitude -o new -q",
)


def px4_fleet(folder: str) -> str:
    """Eight PX4 vehicles with four flights each; one has become heavier."""
    return (
        f"flysid synth -o {folder} --plant ardrone --plan routine --duration 24 --fleet 8 --sensor autopilot"
        " --change 2:3:mass:1.3 --format ulog --no-truth -q"
    )


def buckets(inbox: str, lake: str) -> Prepare:
    """A store with logs of a fleet at one address, and an empty bucket for a lake."""

    def prepare(reader: Reader) -> None:
        server = running_seaweedfs(reader.beside("store"))
        if server is None:
            raise MissingError("SeaweedFS is not installed")
        reader.ending.callback(server.kill)
        reader.more |= server.environment
        reader.prepare(px4_fleet("fleet"))
        reader.prepare(f"python -m tests.doors.upload fleet {inbox} {lake}")

    return prepare


def motion_capture(reader: Reader) -> None:
    """The real AR.Drone flight as a bag."""
    _there(LOGS / "ardrone")
    (reader.folder / "flight.mcap").write_bytes(ardrone.bag(*ardrone.read_flight(LOGS)))


def models_of_others(reader: Reader) -> None:
    """A MATLAB file and a Python function of the longitudinal loop, an FMU of the lateral one."""
    page = (ROOT / "docs" / "own-models.md").read_text("utf-8")
    function = page.partition("## A Python function")[2].partition("```python\n")[2].partition("```")[0]
    (reader.folder / "sim.py").write_text(function, "utf-8")
    reader.prepare(
        f"flysid ingest {SAMPLES} -o data -q",
        f"{QUICK} fit -j 1 data -r ardrone-synthetic -c longitudinal -c lateral -o run -q",
        "python -m tests.doors.matlab_file sys.mat",
        "flysid export run --channel lateral --model arx --fmu plant.fmu",
    )


def hover(reader: Reader) -> None:
    """The flights of `bench.structured` as a dataset file, and the page's file of the model."""
    shutil.copyfile(ROOT / "docs" / "hover.toml", reader.folder / "hover.toml")
    reader.prepare(
        "python -m tests.doors.hover_file hover.parquet",
        f"flysid ingest {SAMPLES} -o data -q",
    )
