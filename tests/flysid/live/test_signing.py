"""Signed links, with pymavlink as the sender: what is accepted, and what is refused without harm."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from flysid.errors import UsageError
from flysid.live.recording import heartbeat_of
from flysid.live.signing import KEY_VARIABLE, OLD, UNSIGNED, WRONG_HASH, Guard, load_key

KEY = bytes(range(32))
OTHER = bytes(32)
NOW = 35_000_000_000_000  # 10 us since 2015
LINK_AT = -13  # the signature begins with the link id


def signed(
    count: int, key: bytes = KEY, *, link_id: int = 3, first: int = NOW, system: int = 1
) -> list[bytes]:
    """Frames that pymavlink signs."""
    link = common.MAVLink(None, srcSystem=system, srcComponent=1)
    link.signing.secret_key = key
    link.signing.sign_outgoing = True
    link.signing.link_id = link_id
    link.signing.timestamp = first
    made = []
    for k in range(count):
        link.seq = k & 0xFF
        made.append(bytes(link.attitude_encode(k, 0.1, 0.2, 0.3, 0, 0, 0.5).pack(link)))
    return made


def unsigned() -> bytes:
    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(link.attitude_encode(7, 0.1, 0.2, 0.3, 0, 0, 0.5).pack(link))


def radio_status() -> bytes:
    link = common.MAVLink(None, srcSystem=51, srcComponent=68)
    return bytes(link.radio_status_encode(100, 100, 100, 20, 20, 0, 0).pack(link))


def judge(guard: Guard, *contents: bytes) -> list[bool]:
    ends = np.cumsum([len(content) for content in contents])
    starts = np.array([0, *ends[:-1].tolist()], np.int64)
    accepted: list[bool] = guard.accepted(0, np.array([*b"".join(contents)], np.uint8), starts).tolist()
    return accepted


def test_what_pymavlink_signs_is_accepted_whole() -> None:
    guard = Guard(KEY)
    assert all(judge(guard, *signed(2000)))
    assert not guard.refused


GENUINE = signed(100)
AHEAD = GENUINE[60]
ATTACKS = {
    "unsigned": (unsigned(), UNSIGNED),
    "replayed": (GENUINE[10], OLD),
    "signed by another key": (signed(1, OTHER, first=NOW + 10_000)[0], WRONG_HASH),
    "payload changed": (AHEAD[:14] + b"\x55" + AHEAD[15:], WRONG_HASH),
    "link id swapped": (AHEAD[:LINK_AT] + b"\x09" + AHEAD[LINK_AT + 1 :], WRONG_HASH),
    "time 2^48 - 1": (AHEAD[:-12] + b"\xff" * 6 + AHEAD[-6:], WRONG_HASH),
    "time 2^48 - 1 by another key": (signed(1, OTHER, first=(1 << 48) - 2)[0], WRONG_HASH),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_an_attack_is_refused_and_the_genuine_stream_goes_on(attack: str) -> None:
    forged, reason = ATTACKS[attack]
    guard = Guard(KEY)
    assert all(judge(guard, *GENUINE[:50]))
    assert judge(guard, forged) == [False]
    assert dict(guard.refused) == {(0, reason): 1}
    assert all(judge(guard, *GENUINE[50:]))


def test_a_whole_recording_played_again_is_refused() -> None:
    guard = Guard(KEY)
    genuine = signed(300)
    assert all(judge(guard, *genuine))
    assert not any(judge(guard, *genuine))
    assert guard.refused[0, OLD] == 300


def test_a_new_stream_may_be_a_minute_behind_and_no_more() -> None:
    guard = Guard(KEY)
    judge(guard, *signed(1, link_id=1))
    assert judge(guard, *signed(1, link_id=2, first=NOW - 5_900_000)) == [True]
    assert judge(guard, *signed(1, link_id=4, first=NOW - 6_100_000)) == [False]


def test_streams_have_clocks_of_their_own() -> None:
    guard = Guard(KEY)
    judge(guard, *signed(10, system=1, first=NOW + 1_000_000))
    assert all(judge(guard, *signed(10, system=2, first=NOW)))


@pytest.mark.parametrize(("policy", "kept"), [("reject", 0), ("radio", 1), ("keep", 2)])
def test_policies_for_unsigned_frames(policy: str, kept: int) -> None:
    assert sum(judge(Guard(KEY, policy), unsigned(), radio_status())) == kept


def test_our_heartbeats_are_signed() -> None:
    beat = heartbeat_of(KEY)
    assert judge(Guard(KEY), beat(), beat()) == [True, True]


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("content", [KEY, KEY.hex().encode(), KEY.hex().encode() + b"\n"])
def test_keys_are_bytes_or_digits(tmp_path: Path, content: bytes) -> None:
    assert load_key(key_file(tmp_path, content)) == KEY


def test_a_phrase_is_hashed(tmp_path: Path) -> None:
    import hashlib

    assert load_key(key_file(tmp_path, b"open sesame\n")) == hashlib.sha256(b"open sesame").digest()


def test_a_key_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_key(None) is None
    monkeypatch.setenv(KEY_VARIABLE, KEY.hex())
    assert load_key(None) == KEY


@pytest.mark.skipif(os.name != "posix", reason="modes are POSIX's")
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o666])
def test_a_key_that_others_can_read_is_refused(tmp_path: Path, mode: int) -> None:
    with pytest.raises(UsageError, match="others can read"):
        load_key(key_file(tmp_path, KEY, mode))


def test_a_key_that_is_empty_or_not_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="empty"):
        load_key(key_file(tmp_path, b"\n"))
    with pytest.raises(UsageError, match="cannot be read"):
        load_key(tmp_path / "none")


def test_a_recording_refuses_and_counts(tmp_path: Path) -> None:
    """The whole way: what is refused is in the sidecar and beside the file, never in it."""
    from tests.flysid.live.test_recording import recording, send, wait_for
    from tests.link_trials import free_port, without_stamps

    port = free_port()
    genuine = signed(100)
    with recording(tmp_path / "s.tlog", f"udp:127.0.0.1:{port}", guard=Guard(KEY)) as made:
        send(port, *genuine[:50], unsigned(), genuine[3], *signed(1, OTHER), *genuine[50:])
        wait_for(100, made)
    assert without_stamps(tmp_path / "s.tlog") == b"".join(genuine)
    peer = made.last_facts["links"][0]["peers"][0]
    assert peer["refused"] == {UNSIGNED: 1, OLD: 1, WRONG_HASH: 1}
    assert peer["systems"][0]["signed"] == 100
    assert (tmp_path / "s.rejects").read_bytes() == unsigned() + genuine[3] + signed(1, OTHER)[0]
