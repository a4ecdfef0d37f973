"""What `make release` refuses, and what the archives must hold."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tests import release
from tests.release import TAG, Refused, changes, dated, for_an_index, missing, project_urls, refuse_unready

HOME = "https://example.org/team/flysid"
NEXT = "## [Unreleased]\n\n### Added\n\n- Reads logs.\n\n## [0.0.9] - 2025-01-01\n\n- Older.\n"


def repository(place: Path) -> Path:
    for command in (
        ["init", "--quiet"],
        ["config", "user.name", "A"],
        ["config", "user.email", "a@example.org"],
        ["commit", "--quiet", "--allow-empty", "--message", "First"],
    ):
        subprocess.run(["git", *command], cwd=place, check=True)
    return place


def test_a_tree_that_is_not_clean_is_refused(tmp_path: Path) -> None:
    root = repository(tmp_path)
    refuse_unready(root)
    (root / "new.py").touch()
    with pytest.raises(Refused, match="not committed"):
        refuse_unready(root)


def test_a_version_is_released_once(tmp_path: Path) -> None:
    root = repository(tmp_path)
    subprocess.run(["git", "tag", TAG], cwd=root, check=True)
    with pytest.raises(Refused, match="raise the version"):
        refuse_unready(root)


def test_nothing_is_left_behind_where_a_step_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = repository(tmp_path)
    for name in ("README.md", "pyproject.toml"):
        (root / name).touch()
    (root / "CHANGELOG.md").write_text(NEXT)
    subprocess.run(["git", "add", "."], cwd=root, check=True)
    subprocess.run(["git", "commit", "--quiet", "--message", "Second"], cwd=root, check=True)
    head = release.git(root, "rev-parse", "HEAD")

    def refuse(clone: Path, _out: Path) -> tuple[Path, Path]:
        said = release.git(clone, "log", "-1", "--format=%B")
        assert re.fullmatch(r"Release [\d.]+\n\nSigned-off-by: A <a@example.org>\n+", said)
        raise Refused("no")

    monkeypatch.setattr(release, "build", refuse)
    with pytest.raises(Refused, match="no"):
        release.release(root, HOME)
    assert release.git(root, "rev-parse", "HEAD") == head
    assert not release.git(root, "tag", "--list")
    assert not (root / "dist").exists()


def test_the_tag_tells_the_changes_of_its_version() -> None:
    released = dated(NEXT, "0.1.0", "2026-11-23")
    assert changes(released, "0.1.0") == "### Added\n\n- Reads logs."
    assert released.startswith("## [Unreleased]\n\n## [0.1.0] - 2026-11-23\n")
    assert dated(released, "0.1.0", "2026-11-24") == released
    with pytest.raises(Refused, match="says nothing of"):
        changes(NEXT, "0.2.0")


def test_links_lead_out_of_an_index() -> None:
    text = "![a page](docs/report.png) [more](docs/models.md), [there](https://example.org)"
    assert for_an_index(text, HOME) == (
        f"![a page]({HOME}/raw/{TAG}/docs/report.png) [more]({HOME}/blob/{TAG}/docs/models.md), "
        "[there](https://example.org)"
    )
    assert for_an_index(text, "") == " more, [there](https://example.org)"
    assert f'Homepage = "{HOME}"' in project_urls(HOME)
    assert project_urls("") == ""


def test_a_file_that_an_archive_lacks_is_named() -> None:
    committed = ["flysid/a.py", "flysid/ingest", "ingest/b.py", "docs/c.md", ".ci/run"]
    wheel = ["flysid/a.py", "flysid/ingest/b.py"]
    source = ["flysid-0.1.0/flysid/a.py", "flysid-0.1.0/flysid/ingest/b.py", "flysid-0.1.0/docs/c.md"]
    assert list(missing(committed, wheel, source)) == []
    assert list(missing(committed, wheel[:1], source[:2])) == [
        "wheel: flysid/ingest/b.py",
        "source archive: docs/c.md",
    ]
