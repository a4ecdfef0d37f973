"""The soak's changes of our own code: one node each, the same for a seed, and the tests that are bought."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import ModuleType

import pytest

from soak.mutating import Mutant, draw, find_sites, sites_of
from soak.patching import find_patch
from soak.private_tree import forget_compiled
from soak.reach import Mentions, Place, Reach, file_of
from soak.row_27_mutants import Equals, Record, Trial

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
        "class P(Protocol):\n    def f(self, a: int = 3) -> int:\n        '3 of them'\n        ...",
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


NAMING = """
from flysid.model.a import SIZE as size, other
LIMIT = other
def test_size():
    assert size == 3
def test_else():
    assert True
"""


def test_a_test_that_reads_a_constant_counts_for_it(tmp_path: Path) -> None:
    for folder in ("model", "tests"):
        (tmp_path / folder).mkdir()
    (tmp_path / "model" / "a.py").write_text("SIZE = 3\nother = 4\n")
    (tmp_path / "tests" / "test_a.py").write_text(NAMING)
    name = "tests/test_a.py::test_"
    reach = Reach({f"{name}size[1]": 1.0, f"{name}else": 1.0, "tests/test_b.py::test_size": 1.0})
    mentions = Mentions.find(tmp_path)
    assert reach.tests_of(Place("model/a.py", 1, 1, ("SIZE",)), mentions) == [f"{name}size[1]"]
    assert reach.tests_of(Place("model/a.py", 2, 2, ("other",)), mentions) == [
        f"{name}else",
        f"{name}size[1]",
    ]


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


PATCHED = """
LIMIT = 3
def plain(x, by=3):
    return x > 3
class Box:
    size = 3
    @property
    def width(self):
        return [3 for _ in (1,)][0]
def outer():
    def inner():
        return 3
    return inner
def made(x):
    return x > LIMIT
kept = outer()
"""


def test_the_body_of_a_function_is_patched_where_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Constants, defaults and class bodies have acted already; so have functions made inside others."""
    (tmp_path / "model").mkdir()
    file = tmp_path / "model" / "patched.py"
    file.write_text(PATCHED)
    loaded = ModuleType("flysid.model.patched")
    loaded.__file__ = str(file)
    exec(compile(PATCHED, str(file), "exec"), vars(loaded))
    monkeypatch.setitem(sys.modules, "flysid.model.patched", loaded)
    mutants = [m for site in sites_of(PATCHED.encode(), "model/patched.py") for m in site]
    news = {m.line: m for m in mutants if m.before == "3" and m.after == "4"}
    patches = {line: find_patch(tmp_path, mutant) for line, mutant in news.items()}
    assert {line for line, patch in patches.items() if patch} == {4, 9, 12}
    for patch in patches.values():
        if patch:
            patch.apply()
    assert loaded.plain(3.5) is False
    assert loaded.Box().width == loaded.outer()() == 4
    assert (loaded.LIMIT, loaded.Box.size, loaded.plain.__defaults__, loaded.kept()) == (3, 3, (3,), 3)
    file.write_text(f"import numba\n{PATCHED}")
    moved = [m for site in sites_of(file.read_bytes(), "model/patched.py") for m in site]
    assert not any(find_patch(tmp_path, m) for m in moved)


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
