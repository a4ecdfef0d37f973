"""`python -m tests.kernels` compiles anew what has changed, and only that."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests import kernels


@pytest.fixture
def filled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """One compiled source; a word for every time that the cache is filled."""
    source = tmp_path / "one.py"
    source.write_text("njit", "utf-8")
    (tmp_path / "__pycache__").mkdir()
    times: list[str] = []
    monkeypatch.setattr(kernels, "STAMP", tmp_path / "cache" / "kernels")
    monkeypatch.setattr(kernels, "compiled_modules", lambda: [("one", str(source))])
    monkeypatch.setattr(kernels, "fill", lambda: times.append("filled"))
    kernels.main()
    return times


def test_nothing_is_compiled_where_nothing_has_changed(filled: list[str]) -> None:
    kernels.main()
    assert filled == ["filled"]


def test_a_changed_source_is_compiled(filled: list[str], tmp_path: Path) -> None:
    os.utime(tmp_path / "one.py", (1.0, 1.0))
    kernels.main()
    assert filled == ["filled"] * 2


def test_a_lost_cache_is_made_again(filled: list[str], tmp_path: Path) -> None:
    cached = tmp_path / "__pycache__" / "one.f-1.py311.nbi"
    cached.touch()
    kernels.main()
    cached.unlink()
    kernels.main()
    assert filled == ["filled"] * 3
