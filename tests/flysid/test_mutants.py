"""The soak's changes of our own code: one node each, the same for a seed, and a campaign that goes on."""

from __future__ import annotations

import ast
import json
import shutil
from pathlib import Path

import pytest

from soak import Budget, row_27_mutants
from soak.mutating import Mutant, draw, find_sites, sites_of
from soak.private_tree import forget_compiled, stamp
from soak.reach import Mentions, Place, Reach, file_of
from soak.row_27_mutants import Bench, Equals, Record, Trial, measure, run_tests

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def sites() -> list[list[Mutant]]:
    return find_sites(ROOT)


def news(text: str) -> set[tuple[str, str]]:
    """Kind and new file of every change of a text."""
    source = text.encode()
    return {(m.kind, m.apply(source).decode()) for site in sites_of(source, "model/a.py") for m in site}


def differing(one: ast.AST, other: ast.AST) -> int:
    """The smallest nodes in which two trees differ."""
    if type(one) is not type(other):
        return 1
    count = 0
    for name, value in ast.iter_fields(one):
        pairs = zip(*(v if isinstance(v, list) else [v] for v in (value, getattr(other, name))), strict=True)
        for a, b in pairs:
            count += differing(a, b) if isinstance(a, ast.AST) else a != b
    return count


def test_a_change_changes_one_node_and_compiles(sites: list[list[Mutant]]) -> None:
    for mutant in draw(sites, 1, 100):
        source = (ROOT / mutant.place.path).read_bytes()
        new = mutant.apply(source)
        compile(new, mutant.place.path, "exec")
        assert differing(ast.parse(source), ast.parse(new)) == 1, str(mutant)
        line = source.splitlines()[mutant.line - 1].decode()
        assert mutant.before.splitlines()[0] in line, str(mutant)


@pytest.mark.parametrize(
    ("text", "changed"),
    [
        ("x = 4", {("number", f"x = {n}") for n in (2, 8, 3, 5)}),
        ("x = 0.5", {("number", f"x = {n}") for n in (0.25, 1.0, 1.5, "(-0.5)")}),
        ("x = 1e-12", {("number", f"x = {n}") for n in (1.000000000001, "(-0.999999999999)")}),
        ("x = 50", {("number", f"x = {n}") for n in (25, 100)}),
        ("x = True", {("truth", "x = False")}),
        ("x = a < b", {("boundary", "x = (a <= b)"), ("comparison", "x = (a >= b)")}),
        ("x = a in b", {("comparison", "x = (a not in b)")}),
        ("x = a is b", {("comparison", "x = (a is not b)")}),
        ("x = a - b", {("sign", "x = (a + b)")}),
        ("x = -a", {("sign", "x = (a)")}),
        ("x += a", {("sign", "x -= a")}),
        ("x = a and not b", {("logic", "x = (a or not b)"), ("logic", "x = a and (b)")}),
        ("x = a < 0.3 * 0", {("comparison", "x = (a >= 0.3 * 0)"), ("boundary", "x = (a <= 0.3 * 0)")}),
        (
            "x = a < b == c",
            {
                ("boundary", "x = (a <= b == c)"),
                ("comparison", "x = (a >= b == c)"),
                ("comparison", "x = (a < b != c)"),
            },
        ),
    ],
)
def test_the_changes_of_a_site(text: str, changed: set[tuple[str, str]]) -> None:
    found = news(text)
    assert changed <= found
    assert len(found) == len(changed) or "0.3" in text  # whose own changes are not listed


@pytest.mark.parametrize("text", ["x = a < 0.3", "x = 0.3 < a", "T = 0.3\nx = a < T"])
def test_no_boundary_is_shifted_beside_what_is_measured(text: str) -> None:
    assert "comparison" in {kind for kind, _ in news(text)}
    assert "boundary" not in {kind for kind, _ in news(text)}


@pytest.mark.parametrize(
    "text",
    [
        '"""Of 3 kinds: a < b."""',
        "def f(a: Literal[3] = x) -> Annotated[int, 3]:\n    '3 of them'",
        "@cached(maxsize=3)\ndef f(): ...",
        "x: Annotated[int, 3]",
        "Kind = Literal[1, 2]",
        "x = f'{a + 1:.3f}'",
        "raise ValueError(a + 3)",
        "tell(a, 3)",
        "warnings.warn(a, stacklevel=3)",
        "assert a < 3",
        "x = np.random.default_rng(3)",
        "_SEED = 3",
        "fit(x, seed=3)",
        "x = zip(a, b, strict=True)",
        "x = field(repr=False, kw_only=True)",
        "match x:\n    case 3: ...",
        "x = 'a' + b",
        "x = a + [b]",
        "x = 1e300",
        "from matplotlib.axes import Axes\nx = 3 - a",
        "def f():\n    import matplotlib\n    return 3 - a",
    ],
)
def test_what_decides_nothing_is_left_alone(text: str) -> None:
    assert news(text) == set()


def test_where_something_is_drawn_comparisons_count() -> None:
    assert news("import matplotlib\nx = a == 3") == {("comparison", "import matplotlib\nx = (a != 3)")}
    around = "def f():\n    import matplotlib\ndef g():\n    return a - b"
    assert {kind for kind, _ in news(around)} == {"sign"}


def test_a_seed_draws_the_same_and_no_site_twice(sites: list[list[Mutant]]) -> None:
    drawn = draw(sites, 7, 500)
    assert drawn == draw(sites, 7, 500)
    assert drawn != draw(sites, 8, 500)
    assert len({(m.place.path, m.start, m.end) for m in drawn}) == 500
    assert len({m.key for m in draw(sites, 7, len(sites) + 1)}) == len(sites)


KERNEL = """
SIZE = 3
def kernel(x):
    return inner(x)
def inner(x):
    return x + 1
def caller(
    x,
    by=2,
):
    return kernel(x) * by + SIZE
"""


def test_tests_are_found_by_line_or_through_who_names_it(tmp_path: Path) -> None:
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "a.py").write_text(KERNEL)
    reach = Reach({"t.py::one": 3.0, "t.py::two": 1.0, "u.py::far": 1.0})
    reach.lines["model/a.py"] = {11: ["t.py::one"], 1: ["u.py::far", "t.py::two"]}
    mentions = Mentions.find(tmp_path)
    found = {}
    for site in sites_of(KERNEL.encode(), "model/a.py"):
        found[site[0].line] = reach.tests_of(site[0].place, mentions)
    assert set(found) == {2, 6, 9, 11}
    assert all(tests == ["t.py::one"] for tests in found.values())  # never that of line 1
    assert reach.tests_of(Place("model/b.py", 1, 1, ("nobody",)), mentions) == []


def test_tests_are_bought_with_what_they_share() -> None:
    """A fixture is paid once, the second case of a test is worth half, and no fixture is made twice."""
    costs = {"a.py::slow": 9.0, "a.py::x[1]": 1.0, "a.py::x[2]": 1.0, "b.py::y": 1.4, "a.py::z": 0.1}
    needs: dict[str, tuple[str, ...]] = {name: (file_of(name),) for name in costs}
    needs["a.py::z"] = ("a.py", "fit")
    reach = Reach(costs, {"a.py": 0.5, "b.py": 0.5, "fit": 4.0}, needs)
    reach.lines["model/a.py"] = {1: list(costs)}

    def bought(left_s: float) -> list[str]:
        return reach.affordable(costs, left_s, set())

    assert bought(0.0) == ["a.py::x[1]"]
    assert bought(3.9) == ["a.py::x[1]", "b.py::y"]
    assert bought(8.6) == ["a.py::x[1]", "b.py::y", "a.py::x[2]", "a.py::z"]
    assert bought(8.4) == ["a.py::x[1]", "b.py::y", "a.py::x[2]"]
    together = reach.side_by_side(bought(99.0))
    assert together == ["a.py::x[1]", "a.py::x[2]", "a.py::slow", "a.py::z", "b.py::y"]
    paid = {"a.py", "fit"}
    assert reach.affordable(["a.py::z", "b.py::y"], 1.0, paid) == ["a.py::z"]


def test_what_was_compiled_from_a_changed_file_is_forgotten(tmp_path: Path) -> None:
    """Kernels of others with it, if these import it: Numba looks at their own files only."""
    sources = {
        "base": "",
        "user": "from flysid.model.base import f",
        "far": "from flysid.model import user",
        "other": "",
    }
    (tmp_path / "model" / "__pycache__").mkdir(parents=True)
    for name, text in sources.items():
        (tmp_path / "model" / f"{name}.py").write_text(text)
        for end in ("cpython-311.pyc", "f-1.py311.nbi", "f-1.py311.1.nbc"):
            (tmp_path / "model" / "__pycache__" / f"{name}.{end}").touch()
    assert sorted(forget_compiled(tmp_path, "model/base.py", 1)) == [
        "base.cpython-311.pyc",
        "base.f-1.py311.1.nbc",
        "base.f-1.py311.nbi",
        "far.f-1.py311.1.nbc",
        "far.f-1.py311.nbi",
        "user.f-1.py311.1.nbc",
        "user.f-1.py311.nbi",
    ]


@pytest.mark.parametrize(
    ("text", "line", "is_in_kernels"),
    [
        ("SIZE = 3\ndef f():\n    return 3", 1, True),
        ("SIZE = 3\ndef f():\n    return 3", 3, False),
        ("from numba import njit\ndef f():\n    return 3", 3, True),
        ("from flysid.model.filters import compiled\ndef f():\n    return 3", 3, True),
    ],
)
def test_kernels_of_others_stay_where_they_hold_nothing_of_the_change(
    tmp_path: Path, text: str, line: int, is_in_kernels: bool
) -> None:
    (tmp_path / "model" / "__pycache__").mkdir(parents=True)
    (tmp_path / "model" / "base.py").write_text(text)
    (tmp_path / "model" / "user.py").write_text("from flysid.model.base import f")
    (tmp_path / "model" / "__pycache__" / "user.f-1.py311.nbi").touch()
    gone = forget_compiled(tmp_path, "model/base.py", line)
    assert gone == ["user.f-1.py311.nbi"] * is_in_kernels


def test_what_changes_nothing_is_known_by_its_line_not_by_its_number(tmp_path: Path) -> None:
    for folder in ("model", "soak"):
        (tmp_path / folder).mkdir()
    (tmp_path / "soak" / "equal_changes.toml").write_text(
        '[[change]]\nfile = "model/a.py"\nline = "x = a < b"\n'
        'change = "a < b -> (a <= b)"\nwhy = "never equal"\n'
    )
    found = set()
    for text in ("x = a < b", "# a line more\nx = a < b", "y = a < b"):
        (tmp_path / "model" / "a.py").write_text(text)
        equals = Equals(tmp_path)
        found |= {(text, m.kind, equals.why(m)) for m in sites_of(text.encode(), "model/a.py")[0]}
    assert {entry for entry in found if entry[2]} == {
        ("x = a < b", "boundary", "never equal"),
        ("# a line more\nx = a < b", "boundary", "never equal"),
    }


def test_listed_changes_that_change_nothing_are_still_there(sites: list[list[Mutant]]) -> None:
    """A line that was changed or deleted leaves the list."""
    equals = Equals(ROOT)
    assert {equals.why(m) for site in sites for m in site} >= set(equals.reasons.values())


def test_a_record_survives_a_line_that_was_cut_off(tmp_path: Path) -> None:
    record = Record(tmp_path / "5.jsonl")
    first, second, third = (Trial(key, "x", "sign", "a test", 1, 1) for key in "abc")
    record.add(first)
    record.add(second)
    file = tmp_path / "5.jsonl"
    file.write_text(file.read_text()[:-20])
    again = Record(file)
    assert list(again.trials) == ["a"]
    again.add(third)
    assert list(Record(file).trials) == ["a", "c"]


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

    def killed(self: Bench, mutant: Mutant) -> Trial:
        if len(tried) == 2:
            raise KeyboardInterrupt
        tried.append(mutant.key)
        return attempt(self, mutant)

    monkeypatch.setattr(Bench, "attempt", killed)
    with pytest.raises(KeyboardInterrupt):
        list(row_27_mutants.run(Budget()))
    assert len(_records(small)) == 2

    def goes_on(self: Bench, mutant: Mutant) -> Trial:
        tried.append(mutant.key)
        return attempt(self, mutant)

    monkeypatch.setattr(Bench, "attempt", goes_on)
    measured = {file: file.stat().st_mtime_ns for file in small.rglob("tests-*.json")}
    model, validate = row_27_mutants.run(Budget())
    assert len(set(tried)) == len(tried) == 4
    assert {file: file.stat().st_mtime_ns for file in small.rglob("tests-*.json")} == measured
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
