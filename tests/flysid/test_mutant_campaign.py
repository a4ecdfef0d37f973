"""The soak's changes of our own code, tried in a small repository: runs, maps and a campaign that goes on."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from soak import Budget, row_27_mutants
from soak.mutating import Mutant
from soak.private_tree import copy_tree, stamp
from soak.reach import Mentions, Place, Reach
from soak.row_27_mutants import Bench, Trial, measure
from soak.running import run_tests

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository of two functions, a test that judges one of them, and one that merely calls the other."""
    root = tmp_path / "small"
    for folder in ("model", "validate", "flysid", "tests/model", "tests/validate", "tests/flysid"):
        (root / folder).mkdir(parents=True)
    for package in ("flysid", "tests"):
        (root / package / "__init__.py").touch()
    (root / "flysid" / "model").symlink_to("../model")
    shutil.copytree(ROOT / "soak", root / "soak")
    (root / "tests" / "kernels.py").touch()
    (root / "model" / "known.py").write_text("def known(x):\n    return x > 3\n")
    (root / "model" / "unknown.py").write_text("def unknown(x):\n    return x > 3\n")
    (root / "tests" / "model" / "test_known.py").write_text(
        "from flysid.model.known import known\nfrom flysid.model.unknown import unknown\n"
        "def test_it(): assert [known(x) for x in (2, 3, 3.5, 4, 5)] == [False, False, True, True, True]\n"
        "def test_call(): unknown(1)\n"
    )
    monkeypatch.setattr(row_27_mutants, "ROOT", root)
    monkeypatch.setattr(row_27_mutants, "COUNT", 4)
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # half of the time
    return root


def _records(root: Path) -> list[dict[str, object]]:
    (file,) = (root / ".bench" / "mutants" / stamp(root)).glob("*.jsonl")
    return [json.loads(line) for line in file.read_text().splitlines()]


def test_a_campaign_goes_on_where_it_was_ended(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    attempt = Bench.attempt
    tried: list[str] = []

    def killed(self: Bench, mutant: Mutant, before: Trial | None) -> Trial:
        if len(tried) == 2:
            raise KeyboardInterrupt
        tried.append(mutant.key)
        return attempt(self, mutant, before)

    monkeypatch.setattr(Bench, "attempt", killed)
    with pytest.raises(KeyboardInterrupt):
        list(row_27_mutants.run(Budget()))
    assert len(_records(small)) == 2

    def goes_on(self: Bench, mutant: Mutant, before: Trial | None) -> Trial:
        tried.append(mutant.key)
        return attempt(self, mutant, before)

    monkeypatch.setattr(Bench, "attempt", goes_on)
    copied: list[str] = []

    def counted(root: Path, into: Path) -> Path:
        copied.append(into.name)
        return copy_tree(root, into)

    monkeypatch.setattr(row_27_mutants, "copy_tree", counted)
    measured = {file: file.stat().st_mtime_ns for file in small.rglob("tests-*.json")}
    model, validate = row_27_mutants.run(Budget())
    assert len(set(tried)) == len(set(tried[:4])) == 4
    unnoticed = {key for key in tried if tried.count(key) > 1}
    assert {key.split()[0] for key in unnoticed} == {"model/unknown.py"}
    later = tried[4:]
    assert [set(later[:2]), set(later[2:])] == [unnoticed, unnoticed]  # turn by turn
    assert copied == ["whole"]  # changes are patched in, and nothing is left for a second turn
    assert len(measured) == 2  # the folders of the first turns
    assert {file: file.stat().st_mtime_ns for file in measured} == measured
    assert (model.trials, validate.trials) == (4, 0)
    by_file: dict[str, set[bool]] = {}
    for trial in _records(small):
        file = str(trial["change"]).partition(":")[0]
        by_file.setdefault(file, set()).add(trial["noticed_by"] == "tests/model/test_known.py::test_it")
    assert by_file == {"model/known.py": {True}, "model/unknown.py": {False}}
    assert model.remark.startswith(
        "noticed 2 of 4 (50 %, 7 to 93); 0 by the doors alone; 0 change nothing; not"
    )
    assert len(model.failures) == 2
    assert all("model/unknown.py:2: " in failure for failure in model.failures)


SHARED = """
import time
import pytest
from flysid.model.known import known
@pytest.fixture(scope="module")
def shared():
    until = time.process_time() + 0.3
    while time.process_time() < until: pass
    return known(5)
def test_first(shared): assert shared
def test_second(shared): assert shared
def test_third(): pass
def test_fails(): assert not known(5)
"""


def measured(small: Path, stamp: str) -> Reach:
    folder = small / ".bench" / "mutants" / stamp
    folder.mkdir(parents=True)
    return measure(small, folder)


def test_what_a_fixture_reaches_counts_for_all_who_use_it(small: Path) -> None:
    (small / "tests" / "model" / "test_known.py").write_text(SHARED)
    reach = measured(small, "now")
    name = "tests/model/test_known.py::test_"
    assert set(reach.seconds) == {name + word for word in ("first", "second", "third")}
    assert reach.lines["model/known.py"][2] == [name + "first", name + "second"]
    file = "tests/model/test_known.py"
    assert reach.needs[name + "third"] == (file,)
    assert reach.needs[name + "first"] == (f"shared of {file}", file)
    assert reach.shared[f"shared of {file}"] > 0.2 > reach.seconds[name + "first"]


DOOR = """
import os, subprocess, sys
def test_door():
    program = "from flysid.model.known import known; known(5)"
    path = os.environ["PYTHONPATH"]
    subprocess.run([sys.executable, "-c", program], env=os.environ | {"PYTHONPATH": path}, check=True)
"""


def test_later_code_takes_the_map_over_and_doors_count_what_they_start(small: Path) -> None:
    """Lines that moved keep their tests; only files of tests that are new or changed are run again."""
    model = small / "tests" / "model"
    (model / "test_unknown.py").write_text("from flysid.model.unknown import *\ndef test_u(): unknown(1)\n")
    first = measured(small, "first")
    assert first.lines["model/known.py"][2] == ["tests/model/test_known.py::test_it"]
    known = small / "model" / "known.py"
    known.write_text("# a line more\n" + known.read_text())
    (model / "test_unknown.py").write_text("def test_u(): pass\n")
    (model / "test_known.py").touch()  # the content is what counts
    (small / "tests" / "doors").mkdir()
    (small / "tests" / "doors" / "test_pages.py").write_text(DOOR)
    second = measured(small, "second")
    door = "tests/doors/test_pages.py::test_door"
    assert second.lines["model/known.py"][3] == ["tests/model/test_known.py::test_it", door]
    assert second.lines["model/unknown.py"][2] == ["tests/model/test_known.py::test_call"]
    both = "tests/model/test_known.py::test_"
    assert {n: second.seconds[n] for n in second.seconds if n.startswith(both)} == {
        n: first.seconds[n] for n in first.seconds if n.startswith(both)
    }
    assert not (small / "sitecustomize.py").exists()
    reaching = second.tests_of(Place("model/known.py", 3, 3), Mentions.find(small))
    assert set(reaching) == {"tests/model/test_known.py::test_it", door}


CASES = """
import pytest
@pytest.mark.parametrize("x", [1, 2], ids=["one - of two", "two"])
def test_case(x): assert x == 2
def test_other(): assert False
"""


def test_the_tests_that_are_named_run_in_their_order(small: Path) -> None:
    """A case whose name is gone says nothing; a crash fails without a name."""
    file = small / "tests" / "model" / "test_cases.py"
    file.write_text(CASES)
    name = "tests/model/test_cases.py::test_"
    gone = run_tests(small, [name + "case[three]"], 1.0)
    assert (gone.passed, gone.failed) == (True, [])
    mixed = run_tests(small, [name + "case[two]", name + "case[one - of two]", name + "other"], 1.0)
    assert (mixed.passed, mixed.failed) == (False, [name + "case[one - of two]"])
    assert run_tests(small, ["tests/model"], 1.0).failed != []
    file.write_text("import os\ndef test_other(): os.abort()\n")
    crashed = run_tests(small, [name + "other"], 1.0)
    assert (crashed.passed, crashed.failed) == (False, [])
    file.write_text("import nothing_of_this_name")
    assert run_tests(small, [name + "other"], 1.0).failed == ["tests/model/test_cases.py"]
