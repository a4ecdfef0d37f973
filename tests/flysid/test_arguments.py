"""A wrong argument is refused before a log or a table is read: every way into a reader fails these tests."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest

from flysid.fleet import reading
from flysid.fleet.models import gather
from flysid.ingest.formats import registry
from flysid.ingest.lake import batch, lake
from tests.command import Done, call, call_quick

LOGS = Path(__file__).parents[2] / "sample_logs"
ATT = "-r ardupilot-attitude"
OWN = "-r ardrone-synthetic"
OTHER = "01-multisine-seed1.tlog"
NOT_A_FOLDER = "cannot be written: Not a directory"
FIT = f"fit LOG -o new {OWN}"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log, a folder of flights of it, and a run of one channel."""
    folder = tmp_path_factory.mktemp("arguments")
    shutil.copy(LOGS / "01-steps-seed2.tlog", folder / "LOG.tlog")
    shutil.copy(LOGS / OTHER, folder)
    done = call("ingest", "LOG.tlog", OTHER, "-o", "data", cwd=folder)
    assert done.returncode == 0, done.stderr
    done = call_quick("fit", "data", "-r", "ardrone-synthetic", "-c", "longitudinal", "-o", "run", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "file").write_text("not a folder")
    (folder / "bad.toml").write_text("name = 3")
    return folder


class ReadError(AssertionError):
    """Something was read."""


@pytest.fixture
def closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """No log and no table can be read."""

    def refuse(*_: object, **__: object) -> object:
        raise ReadError

    monkeypatch.setattr(batch, "read_bounded", refuse)
    monkeypatch.setattr(reading, "read_bounded", refuse)
    monkeypatch.setattr(gather, "run_bounded", refuse)
    monkeypatch.setattr(registry, "open_log", refuse)
    monkeypatch.setattr(lake, "read_entry", refuse)
    monkeypatch.setattr(lake, "read_flight", refuse)


def run(line: str, place: Path) -> Done:
    return call(*shlex.split(line.replace("LOG", "LOG.tlog")), cwd=place)


REFUSED = [
    # recipes and channels
    (f"{FIT} -c long", "no channel 'long'", "one of longitudinal, lateral, vertical"),
    ("fit LOG -o new -r ardrone-synthetc", "no recipe 'ardrone-synthetc'", "ardrone-synthetic"),
    ("fit LOG -o new -r absent.toml", "cannot be read: No such file", "check its name and folder"),
    ("fit LOG -o new -r bad.toml", "bad.toml", ""),
    (f"step LOG {ATT} -c rol", "no channel 'rol'", "did you mean 'roll'?"),
    ("step LOG -c rol", "no shipped recipe has a channel 'rol'", "did you mean 'roll'?"),
    ("step LOG --against absent.tlog", "no such file or folder", ""),
    (f"tf LOG {ATT} -c rol", "no channel 'rol'", "did you mean 'roll'?"),
    ("tf LOG -c rol", "no shipped recipe has a channel 'rol'", "did you mean 'roll'?"),
    ("plot LOG -r ardupilot-atitude", "no recipe", "ardupilot-attitude"),
    (f"plan LOG {ATT} -c rol --band 0.1 3", "no channel 'rol'", "did you mean 'roll'?"),
    ("doctor LOG --kinematics --correct absent", "no recipe 'absent'", "one of ardrone-inner"),
    (f"doctor LOG {OTHER} --kinematics --correct ardrone-synthetic", "takes one log, not 2", ""),
    ("watch run LOG --channel long", "the run has no channel 'long'", "did you mean 'longitudinal'?"),
    ("design absent --limit 12", "no such file or folder", ""),
    ("export absent --to px4-sih", "no vehicle here", "flysid vehicle LOG"),
    ("design run -c long", "the run has no channel 'long'", "did you mean 'longitudinal'?"),
    ("plan run -c long", "the run has no channel 'long'", "did you mean 'longitudinal'?"),
    ("export run --c new --channel long", "the run has no channel 'long'", "--channel longitudinal"),
    (f"fleet fit data {ATT} -c rol", "no channel 'rol'", "did you mean 'roll'?"),
    (f"fleet changed data {ATT} -c rol", "no channel 'rol'", "did you mean 'roll'?"),
    ("fleet fit data -r betaflight-rate", "no flight has the streams", "these fit: ardrone-synthetic"),
    ("fleet changed data -r betaflight-rate", "no flight has the streams", "these fit: ardrone-synthetic"),
    ("step data -r betaflight-rate", "no flight has the streams", "these fit: ardrone-synthetic"),
    # flights and vehicles
    (f"{FIT} --flight nosuch", "no flight 'nosuch'", "one of LOG"),
    (f"{FIT} --exclude LO2", "no flight 'LO2'", "did you mean 'LOG'?"),
    (f"{FIT} --exclude LO2@1..2", "no flight 'LO2'", "did you mean 'LOG'?"),
    (f"{FIT} --holdout nosuch@1..2", "no flight 'nosuch'", "one of LOG"),
    (f"{FIT} --holdout LOG@9..2", "'9..2' are not two times", "12:30..14:00"),
    (f"step LOG {ATT} --flight nosuch", "no flight 'nosuch'", ""),
    (f"tf LOG {ATT} --flight nosuch", "no flight 'nosuch'", ""),
    ("gains LOG --flight nosuch", "no flight 'nosuch'", ""),
    ("plot LOG --flight nosuch", "no flight 'nosuch'", ""),
    ("ls LOG --flight nosuch", "no flight 'nosuch'", ""),
    ("export LOG --flight nosuch", "no flight 'nosuch'", ""),
    (f"plan LOG {ATT} --band 0.1 3 --flight nosuch", "no flight 'nosuch'", ""),
    (f"fit data -o new {OWN} --flight nosuch", "no flight 'nosuch'", "LOG-"),
    (f"fit data -o new {OWN} --holdout nosuch", "no flight 'nosuch'", "LOG-"),
    (f"step data {ATT} --vehicle nosuch", "no vehicle 'nosuch'", ""),
    ("validate run --flight nosuch", "no flight 'nosuch'", "LOG-"),
    ("validate run --exclude nosuch", "no flight 'nosuch'", "LOG-"),
    ("validate run --vehicle nosuch", "no vehicle 'nosuch'", ""),
    ("compare run run --flight nosuch", "no flight 'nosuch'", "LOG-"),
    ("compare run run --vehicle nosuch", "no vehicle 'nosuch'", ""),
    ("compare run run --data-a nosuch", "no such folder", "flysid ingest"),
    ("validate run --data run", "not an ingested folder", "this is a run, and its flights are in "),
    ("ingest LOG -o new --vehicle-in v[0-9", "not a valid regular expression", ""),
    # conditions
    (f"tf LOG {ATT} --fail-if 'loop.phase_margin_deg.low <'", "condition not understood", ""),
    ("tf LOG -r ardupilot-sysid --fail-if 'loop.phase_margn_deg.low < 3'", "not a field", "phase_margin_deg"),
    (f"tf LOG {ATT} --fail-if 'rol.command.peak_db.low < 3'", "is not a field", "'roll.command.peak"),
    (f"tf LOG {ATT} --fail-if 'loop.phase_margin_deg.low < 45'", "nothing says what drives the loop",
     "--reference FIELD --reference-at"),
    (f"tf LOG {ATT} --reference-at input", "margins belong to the loop cut open", "--reference FIELD"),
    ("validate run --fail-if 'free_run.chang_pct > 5'", "is not a field", "free_run.change_pct"),
    ("compare run run --fail-if 'free_run.chang_pct > 5'", "is not a field", "free_run.change_pct"),
    # models and their settings
    (f"{FIT} -m tss", "no model 'tss'", "did you mean 'ts'?"),
    (f"{FIT} -m structured:absent.toml", "cannot be read: No such file", ""),
    (f"{FIT} -a nosuch", "the antecedent 'nosuch' is not understood", "the signals are"),
    (f"tf LOG {ATT} --poles 1 --zeros 3", "no more zeros than poles", ""),
    (f"tf LOG {ATT} --band 10 1", "no band", ""),
    ("watch run LOG --model nosuch", "the run has no model 'nosuch'", "one of "),
    ("compare run run --model nosuch", "a model 'nosuch'", "one of "),
    ("export run --c new --model nosuch", "has no model 'nosuch'", ""),
    (f"fleet fit data {ATT} --ts -o new --models tss", "no model 'tss'", "did you mean 'ts'?"),
    (f"fleet fit data {ATT} --models ts -o new", "--models are those of a vehicle's run", "--ts"),
    (f"fleet fit data {ATT} --vehicle --ts -o new", "--vehicle fits whole vehicles", "leave out --by, --ts"),
    (f"fleet fit data {ATT} --vehicle --by month", "--vehicle fits whole vehicles", "leave out --by, --ts"),
    (f"fleet fit data {ATT} --by nosuch", "cannot be grouped by 'nosuch'", "one of vehicle"),
    # fields
    ("fit LOG -o new --from u", "no output is named", "add --to FIELD"),
    ("fit LOG -o new --to u", "no input is named", "add --from FIELD"),
    ("fit LOG -o new --dt 0.1", "neither a recipe nor fields", "--from FIELD --to FIELD"),
    (f"fit LOG -o new {OWN} --dt 0.1", "mutually exclusive", ""),
    # targets
    (f"fit LOG {OWN} -o file/new", NOT_A_FOLDER, "choose another folder"),
    (f"fit data {OWN} -o file/new", NOT_A_FOLDER, ""),
    (f"fit LOG {OWN} -o run", "the target exists", "--force"),
    (f"step LOG {ATT} --plot x.xyz", "no picture format '.xyz'", ".png"),
    (f"step LOG {ATT} --plot absent/x.png", "cannot be written: No such file", "make the folder"),
    (f"tf LOG {ATT} --plot absent/x.png", "cannot be written: No such file", "make the folder"),
    ("gains LOG --plot x.xyz", "no picture format '.xyz'", ".png"),
    ("gains LOG --plot absent/x.png", "cannot be written: No such file", "make the folder"),
    ("plot LOG -o x.xyz", "no picture format '.xyz'", ".png"),
    ("plot LOG -o file/x.html", NOT_A_FOLDER, ""),
    ("export LOG -o file/x", NOT_A_FOLDER, ""),
    ("export LOG -o file", "the target exists", "--force"),
    ("validate run -o file/x", NOT_A_FOLDER, ""),
    ("compare run run -o file/x", NOT_A_FOLDER, ""),
    (f"plan LOG {ATT} --band 0.1 3 -o file/x", NOT_A_FOLDER, ""),
    ("design run -o file/x", NOT_A_FOLDER, ""),
    (f"fleet fit data {ATT} -o file/x", NOT_A_FOLDER, ""),
    ("doctor LOG --kinematics --correct ardrone-synthetic -o file/x", NOT_A_FOLDER, ""),
    ("ingest LOG -o file", "a file, not a folder", ""),
    ("ingest LOG -o run", "not an ingested folder, and not empty", ""),
    # numbers
    (f"step LOG {ATT} --horizon 0", "--horizon", "range"),
    (f"step LOG {ATT} --horizon nan", "--horizon", "not a finite number"),
    (f"step LOG {ATT} --fast -3", "--fast", "range"),
    (f"tf LOG {ATT} --poles -2", "--poles", "a whole number of at least 0, or auto"),
    (f"tf LOG {ATT} --dead-time nan", "--dead-time", "a number of at least 0, or auto"),
    (f"{FIT} -j -3", "--jobs", "range"),
    ("fit LOG -o new --from u --to y --dt 0", "--dt", "range"),
    ("ingest LOG -o new -j -3", "--jobs", "range"),
    ("export LOG --rate 0", "--rate", "range"),
    ("show LOG -n -3", "--rows", "range"),
    ("show LOG a b c", "3 names are too many", ""),
    ("watch run LOG --false-alarms 0", "--false-alarms", "range"),
    (f"plan LOG {ATT} --band 3 0.1", "no band: 3 to 0.1 Hz", ""),
    (f"plan LOG {ATT} --band 0.1 300", "the band goes to 300 Hz", "--rate 1500"),
    (f"plan LOG {ATT}", "no band to excite", "--band LOW HIGH"),
    (f"plan LOG {ATT} --band 0.1 3 --seconds -3", "--seconds", "range"),
    (f"plan LOG {ATT} --band 0.1 3 --more -1", "--more", "range"),
    (f"plan LOG {ATT} --band 0.1 3 --limit x=3deg", "a limit for x", "its axes: roll_in, pitch_in"),
    ("plan run --limit x=3deg", "a limit for x", "its axes: theta_in"),
    (f"plan LOG {ATT} --band 0.1 3 --px4-plane", "PX4 cannot fly multisine", "--kind chirp"),
    ("design run --ms 0.9", "--ms", "range"),
    ("design run --noise -1", "--noise", "range"),
    ("studio data --port 99999 --no-open", "--port", "range"),
    # links, commands and formats
    ("watch run absent.tlog", "no such log", "links are udp:"),
    ("watch run udp:nowhere", "no link 'udp:nowhere'", "udp:HOST:PORT"),
    ("watch run LOG -o x.tlog", "are for a LINK", ""),
    ("watch run LOG --exec nosuchcommand", "names no command", ""),
    ("gains LOG --format ulgo", "no format 'ulgo'", "ulog"),
    ("ingest run -o new", "no flight log in there", "this is a run, and its flights are in "),
    ("ls run", "no flight log in there", "this is a run, and its flights are in "),
]  # fmt: skip


@pytest.mark.usefixtures("closed")
@pytest.mark.parametrize(("line", "said", "hint"), REFUSED, ids=[line for line, *_ in REFUSED])
def test_a_wrong_argument_is_refused_before_anything_is_read(
    line: str, said: str, hint: str, place: Path
) -> None:
    before = sorted(place.rglob("*"))
    done = run(line, place)
    assert done.returncode in (1, 2), (done.returncode, done.stderr)
    assert said in done.stderr
    assert hint in done.stderr
    assert not done.stdout
    assert sorted(place.rglob("*")) == before


def test_the_logs_of_a_run_stay_where_arguments_are_refused(place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "run", tmp_path / "run")
    shutil.copytree(place / "data", tmp_path / "run.data")
    shutil.copy(place / "LOG.tlog", tmp_path)
    done = run("fit LOG -r ardrone-synthetic -c long -o run --force", tmp_path)
    assert done.returncode == 2
    assert (tmp_path / "run.data" / "flysid-data.json").is_file()
    assert (tmp_path / "run" / "run.json").is_file()


def test_without_a_recipe_the_beginning_of_a_log_tells_which_fit(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "ingest_logs", lambda *_, **__: pytest.fail("the whole log was read"))
    for line in ("fit LOG -o new", "plan LOG --band 0.1 3"):
        done = run(line, place)
        assert done.returncode == 2
        assert "error: neither a recipe nor fields are given" in done.stderr
        assert "--recipe ardrone-synthetic, or --recipe ardupilot-attitude" in done.stderr


def test_a_log_whose_beginning_fits_nothing_is_refused_with_where_to_look(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,u,y\n" + "".join(f"{k / 10},{k % 7},{k % 5}\n" for k in range(100)))
    done = call("fit", "a.csv", "-o", "new", cwd=tmp_path)
    assert done.returncode == 2
    assert "--from FIELD --to FIELD" in done.stderr
    assert "'flysid show a.csv --fields' the fields" in done.stderr
