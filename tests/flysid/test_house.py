"""The house itself: what is installed, what is exported, what start-up costs."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import flysid
from flysid import errors
from flysid.cli.output import ExitCode
from flysid.model.structures import OWN
from tests.command import shell
from tests.samplelogs import blackbox, dataflash

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {"numpy", "scipy", "pandas", "pyarrow", "control", "numba", "pymavlink", "mcap", "rich", "jinja2"}
HEAVY |= {"obstore", "deltalake", "dask", "distributed"}
SLOW = {"pandas", "scipy.signal", "scipy.stats"}


def modules_after(code: str) -> set[str]:
    """Names of the modules that a fresh interpreter holds after running `code`."""
    script = f"{code}\nimport sys; print('MODULES', *sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, timeout=60, check=True
    )
    return set(done.stdout.rpartition("MODULES")[2].split())


@pytest.mark.parametrize(
    "line",
    [
        "doctor flight.bin",
        "ls flight.bin --suggest -q",
        "show flight.bin --fields",
        "plot flight.bin ATT.Roll,ATT.Pitch -o flight.html",
        "export flight.bin ATT --to mat",
        "scrub flight.bbl -o shared.bbl",
    ],
)
def test_what_looks_at_a_log_imports_nothing_slow(line: str, tmp_path: Path) -> None:
    """Neither do its workers: a process pays 0.2 s of CPU for pandas, 0.4 s for scipy.signal."""
    (tmp_path / "flight.bin").write_bytes(dataflash.build())
    (tmp_path / "flight.bbl").write_bytes(blackbox.build())
    done = shell(*line.split(), cwd=tmp_path, PYTHONPROFILEIMPORTTIME="1")
    assert done.returncode in (0, ExitCode.LOSSES), done.stderr
    imported = {row.rpartition("|")[2].strip() for row in done.stderr.splitlines()}
    assert "numpy" in imported
    assert not imported & SLOW


def test_judging_loops_and_vehicles_imports_nothing_slow() -> None:
    code = "import flysid.loops.judged, flysid.reviews.series, flysid.sixdof.changes, flysid.sixdof.judging"
    assert not modules_after(code) & {*SLOW, "scipy.ndimage", "scipy.spatial"}


def test_every_folder_with_a_file_is_in_the_wheel() -> None:
    """Data folders too: setuptools takes one that is no package for a forgotten one, and warns."""
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]["find"]
    code = f"import setuptools; print(*setuptools.find_namespace_packages('.', **{asked!r}))"
    found = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=60,
        check=True,
    )
    on_disk = {"flysid"}
    for top in ("flysid", "ingest", "model", "validate"):
        for file in (ROOT / top).rglob("*.*"):
            parts = file.parent.relative_to(ROOT).parts
            if not file.is_file() or parts[-1] == "__pycache__":
                continue
            on_disk.add(".".join(parts if parts[0] == "flysid" else ("flysid", *parts)))
    assert set(found.stdout.split()) == on_disk


def test_a_script_beside_a_clone_imports_the_installed_package(tmp_path: Path) -> None:
    (tmp_path / "flysid").symlink_to(ROOT)
    script = tmp_path / "script.py"
    script.write_text("import flysid; print(flysid.__file__, flysid.ARX, sep='\\n')")
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, cwd=tmp_path, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.splitlines()[0]).name == "__init__.py"


def test_an_editable_install_is_a_path() -> None:
    """Of a plain root setuptools makes a path; of any other map an import hook, which is asked last."""
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-dir"] == {
        "": "."
    }


@pytest.mark.parametrize("name", ["ingest", "model", "validate"])
def test_package_links_resolve_to_the_folders_at_the_top(name: str) -> None:
    link = ROOT / "flysid" / name
    assert link.is_symlink()
    assert not link.readlink().is_absolute()
    assert link.resolve() == ROOT / name


def test_exported_names_are_exactly_the_public_ones() -> None:
    structures = {row.estimator.rpartition(":")[2] for row in OWN.values() if row.estimator}
    assert set(flysid.__all__) == set(flysid._HOME) | structures | {"__version__"}
    for name in flysid.__all__:
        assert getattr(flysid, name) is not None


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = flysid.nonsense


def test_version_stands_once() -> None:
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"] == flysid.__version__


def test_the_changelog_keeps_its_form() -> None:
    """Keep a Changelog 1.1: what is unreleased comes first, and six kinds of change."""
    headings = re.findall(r"^(##+) (.+)$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.M)
    versions = [name for depth, name in headings if depth == "##"]
    assert versions[0] == "[Unreleased]"
    assert all(re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", name) for name in versions[1:])
    kinds = {name for depth, name in headings if depth == "###"}
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


@pytest.mark.parametrize(
    "code",
    [
        "import flysid",
        "from flysid.cli import root; root.main(['--help'], standalone_mode=False)",
        "from flysid.studio import app; app.asset_routes()",  # all that the first answer waits for
    ],
)
def test_start_up_imports_nothing_heavy(code: str) -> None:
    assert not modules_after(code) & HEAVY


def test_every_error_is_in_the_tree_that_the_docstring_draws() -> None:
    classes = [v for v in vars(errors).values() if isinstance(v, type) and issubclass(v, errors.FlysidError)]
    assert len(classes) >= 7
    for cls in classes:
        assert cls.__name__ in (errors.__doc__ or "")


def test_error_text_says_what_where_and_what_to_try() -> None:
    error = errors.FormatError("bad frame", path="a.tlog", byte=12, flight_time_s=3.5, hint="cut the file")
    assert str(error) == "bad frame (a.tlog, byte 12, flight time 3.500 s) Try: cut the file"
