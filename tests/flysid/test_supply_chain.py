"""The rules of `tests/audit.py` hold here, and the audit sees when they do not."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import audit


def test_the_supply_chain_keeps_its_rules() -> None:
    assert audit.faults() == []


def test_everything_needed_is_locked_with_hashes() -> None:
    pins = audit.locked()
    assert len(pins) > 40
    assert all(hashes for _, hashes in pins.values())


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("--extra-index-url somewhere", "a host or a place"),
        ("evil @ https://example.org/evil.whl", "a host or a place"),
        ("unhashed==1.0", "without a hash"),
    ],
)
def test_a_lock_that_breaks_a_rule_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, fault: str
) -> None:
    (tmp_path / "lock").write_text(audit.LOCK.read_text() + line + "\n")
    monkeypatch.setattr(audit, "LOCK", tmp_path / "lock")
    assert any(fault in found for found in audit.faults())


def test_a_missing_pin_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "lock").write_text(audit.LOCK.read_text().replace("numpy==", "other=="))
    monkeypatch.setattr(audit, "LOCK", tmp_path / "lock")
    assert any("does not satisfy numpy" in found for found in audit.faults())


@pytest.mark.parametrize(
    "licence", ["GPL-3.0-only", "GNU General Public License v3", "AGPLv3", "Proprietary", ""]
)
def test_a_licence_that_binds_is_seen(monkeypatch: pytest.MonkeyPatch, licence: str) -> None:
    wrong = audit.Package("wrong", "1.0", licence, True)
    monkeypatch.setattr(audit, "packages", lambda: [wrong])
    assert any("licence" in found for found in audit.faults())


def test_a_changed_vendored_file_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in audit.ASSETS.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes() + b" " * path.name.endswith(".min.js"))
    monkeypatch.setattr(audit, "ASSETS", tmp_path)
    assert any("is not the file" in found for found in audit.faults())
