"""What comes piece by piece stands on the grid as it does when the whole log is aligned."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega

import flysid
from flysid.dataset import FloatArray, Segment
from flysid.errors import RecipeError
from flysid.ingest.align import align, resample
from flysid.ingest.align.recipe import Recipe, parse_recipe
from flysid.live.decoding import Decoder
from flysid.live.gridding import GridPiece, RunningGrid, streams_of

SOURCES = {
    "tilt": {"stream": "ATTITUDE_TARGET", "field": "q", "transform": "pitch", "scale": -1.0},
    "thrust": {"stream": "ATTITUDE_TARGET", "field": "thrust"},
    "forward": {
        "stream": "LOCAL_POSITION_NED",
        "field": ["vx", "vy"],
        "transform": "forward",
        "unit": "m/s",
        "yaw": {"stream": "ATTITUDE", "field": "yaw", "unit": "rad"},
    },
    "yaw": {"stream": "ATTITUDE", "field": "yaw", "transform": "unwrap", "unit": "rad"},
    "rate": {"stream": "ATTITUDE", "field": "yaw", "transform": "derivative", "unit": "rad"},
    "climb": {"stream": "LOCAL_POSITION_NED", "field": "vz", "unit": "m/s", "scale": -1.0, "offset": 0.5},
}
RECIPE = parse_recipe(
    {
        "name": "running",
        "min_segment_s": 0.0,
        "signals": {
            "tilt": {"unit": "deg", "hold": "zero", "sources": [SOURCES["tilt"]]},
            "thrust": {"unit": "", "hold": "zero", "max_gap_s": float("inf"), "sources": [SOURCES["thrust"]]},
            "forward": {"unit": "m/s", "sources": [SOURCES["forward"]]},
            "yaw": {"unit": "deg", "sources": [SOURCES["yaw"]]},
            "rate": {"unit": "deg/s", "sources": [SOURCES["rate"]]},
            "climb": {"unit": "m/s", "max_rate": 30.0, "sources": [SOURCES["climb"]]},
        },
        "channels": {
            "forward": {"inputs": ["tilt"], "outputs": ["forward"]},
            "turn": {"inputs": ["tilt", "thrust"], "outputs": ["yaw", "rate"]},
            "climb": {"inputs": ["thrust"], "outputs": ["climb"]},
        },
        "conditions": [
            {
                "name": "armed",
                "has_bits": 128,
                "sources": [{"stream": "HEARTBEAT", "field": "base_mode"}],
                "margin_s": 0.0,
            }
        ],
    },
    "running",
)


def log(
    seed: int,
    seconds: float = 12.0,
    *,
    jitter_ms: int = 0,
    gap: bool = False,
    fast: int = 1,
) -> list[bytes]:
    """A tlog's records: attitudes (`fast` times as many), positions, targets at 50 Hz, heartbeats."""
    rng = np.random.default_rng(seed)
    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    pace = 20 // fast
    made: list[tuple[int, bytes]] = []

    def put(at_ms: int, message: object) -> None:
        made.append((at_ms, bytes(message.pack(link))))  # type: ignore[attr-defined]

    yaw = 0.0
    for at_ms in range(5_000, 5_000 + round(1e3 * seconds), pace):
        lost = gap and 9_000 < at_ms < 9_400
        stamp = at_ms + int(rng.integers(-jitter_ms, jitter_ms + 1))
        yaw = (yaw + 0.1 * rng.standard_normal() + 0.05 + np.pi) % (2 * np.pi) - np.pi
        roll, pitch = rng.uniform(-0.3, 0.3, 2)
        if not lost:
            put(stamp, link.attitude_encode(stamp, roll, pitch, yaw, 0.0, 0.0, 0.0))
        if at_ms % 20:
            continue
        v = rng.uniform(-0.5, 0.5, 3) + np.array([0.0, 0.0, 40.0 * (rng.random() < 0.01)])
        q = [float(np.cos(pitch / 2)), 0.0, float(np.sin(pitch / 2)), 0.0]
        put(at_ms, link.attitude_target_encode(at_ms, 7, q, 0.0, 0.0, 0.0, float(rng.random())))
        if not lost:
            put(stamp, link.local_position_ned_encode(stamp, 0.0, 0.0, 0.0, *map(float, v)))
        if at_ms % 1_000 == 0:
            mode = 128 if at_ms != 13_000 else 0
            put(at_ms, link.heartbeat_encode(2, 3, mode, 0, 4))
    made.sort(key=lambda pair: pair[0])
    return [struct.pack(">Q", 10**15 + 1000 * at_ms) + frame for at_ms, frame in made]


def given_out(
    records: Sequence[bytes], recipe: Recipe, channel: str, sizes: Sequence[int]
) -> list[GridPiece]:
    """The pieces of a channel, so many records at a time, once every stream has begun."""
    decoder = Decoder(streams_of(recipe))
    grid = RunningGrid(recipe, channel, 0.02, decoder)
    pieces: list[GridPiece] = []
    at = 0
    turn = 0
    while at < len(records):
        size = sizes[turn % len(sizes)] if at else 12
        rows = decoder.read(b"".join(records[at : at + size]))
        pieces += grid.take(rows) if rows else []
        at += size
        turn += 1
    return pieces


def joined(pieces: Sequence[GridPiece]) -> list[tuple[int, FloatArray, FloatArray]]:
    """Segments of pieces that follow on each other."""
    found: list[tuple[int, FloatArray, FloatArray]] = []
    for piece in pieces:
        if piece.follows:
            t0, u, y = found[-1]
            assert piece.t0_ns == t0 + len(u) * 20_000_000
            found[-1] = t0, np.concatenate([u, piece.u]), np.concatenate([y, piece.y])
        else:
            found.append((piece.t0_ns, piece.u, piece.y))
    return found


def whole(path: Path, records: Sequence[bytes], recipe: Recipe, channel: str) -> tuple[Segment, ...]:
    """The segments of the whole log."""
    path.write_bytes(b"".join(records))
    return align.segments_of(flysid.read(path), recipe, channel, 0.02)[1]


@pytest.mark.parametrize("channel", list(RECIPE.channels))
@pytest.mark.parametrize("fast", [1, 4])
@pytest.mark.parametrize("gap", [False, True])
def test_pieces_are_the_whole_to_the_last_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, channel: str, fast: int, *, gap: bool
) -> None:
    if fast > 1:  # stamps between the grid's leave its phase to rounding
        monkeypatch.setattr(resample, "phase_ns", lambda *_: 0)
    records = log(1, gap=gap, fast=fast)
    segments = whole(tmp_path / "a.tlog", records, RECIPE, channel)
    found = joined(given_out(records, RECIPE, channel, [32, 1, 7]))
    assert len(found) == len(segments)
    for segment, (t0_ns, u, y) in zip(segments, found, strict=True):
        assert t0_ns == segment.t0_ns
        assert len(segment) - len(u) <= 8  # the last samples wait for what would follow
        assert np.array_equal(u, segment.u[: len(u)])
        # a derivative is rounded in another way where all stamps of a log are equally far apart
        np.testing.assert_allclose(y, segment.y[: len(y)], rtol=0, atol=1e-9 * (channel == "turn"))


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 1_000),
    sizes=st.lists(st.integers(1, 90), min_size=1, max_size=5),
    jitter=st.integers(0, 4),
)
def test_however_they_are_cut_they_are_the_whole(
    tmp_path_factory: pytest.TempPathFactory, seed: int, sizes: list[int], jitter: int
) -> None:
    """Stamps that jitter: the grid's phase is then a matter of which are known, and is given."""
    records = log(seed, 6.0, jitter_ms=jitter)
    path = tmp_path_factory.mktemp("cut") / "a.tlog"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resample, "phase_ns", lambda *_: 3_000_000)
        segments = whole(path, records, RECIPE, "forward")
        found = joined(given_out(records, RECIPE, "forward", sizes))
    assert len(found) == len(segments) == 1
    t0_ns, u, y = found[0]
    assert t0_ns == segments[0].t0_ns
    assert len(segments[0]) - len(u) <= 4
    assert np.array_equal(u, segments[0].u[: len(u)])
    assert np.array_equal(y, segments[0].y[: len(y)])


def test_a_vehicle_that_begins_anew_begins_a_new_segment() -> None:
    first = log(3, 6.0)
    after_ms = 10_000
    second = [struct.pack(">Q", int.from_bytes(r[:8], "big") + 1000 * after_ms) + r[8:] for r in log(4, 6.0)]
    later = first + second
    pieces = given_out(later, RECIPE, "climb", [10])
    assert sum(not piece.follows for piece in pieces) == 2
    assert 10.0 < sum(len(p.u) for p in pieces) * 0.02 < 12.1


def test_an_absurd_time_costs_its_own_row_only() -> None:
    records = log(5, 6.0)
    odd = records[400]
    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    far = bytes(link.attitude_encode(4_000_000_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0).pack(link))
    pieces = given_out([*records[:400], odd[:8] + far, *records[400:]], RECIPE, "turn", [5])
    plain = given_out(records, RECIPE, "turn", [5])
    assert sum(len(p.u) for p in pieces) == sum(len(p.u) for p in plain)


def test_a_stream_that_comes_late_begins_the_channel_late() -> None:
    records = log(6, 8.0)
    target = ardupilotmega.MAVLINK_MSG_ID_ATTITUDE_TARGET
    late = [r for k, r in enumerate(records) if k > 300 or r[15] != target]
    pieces = given_out(late, RECIPE, "forward", [20])
    assert 6_900_000_000 < pieces[0].t0_ns < 7_200_000_000


def test_without_its_streams_nothing_comes() -> None:
    tilt = RECIPE.signals["tilt"]
    elsewhere = replace(tilt, sources=(replace(tilt.sources[0], stream="MANUAL_CONTROL"),))
    recipe = replace(RECIPE, signals={**RECIPE.signals, "tilt": elsewhere})
    assert given_out(log(7, 4.0), recipe, "forward", [20]) == []


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 1_000_000),
    size=st.integers(12, 80),
    kind=st.sampled_from(["shuffled", "repeated", "thinned", "other times", "not numbers", "two boots"]),
)
def test_whatever_comes_is_survived(seed: int, size: int, kind: str) -> None:
    """Late, twice, hardly ever, years off, not a number: pieces are finite and rise in time within a boot."""
    rng = np.random.default_rng(seed)
    records = log(seed, 3.0, jitter_ms=3)
    if kind == "shuffled":
        records = [records[k] for k in np.argsort(np.arange(len(records)) + rng.uniform(0, 30, len(records)))]
    elif kind == "repeated":
        records = [r for r in records for _ in range(int(rng.integers(1, 4)))]
    elif kind == "thinned":
        records = [r for r in records if rng.random() < 0.1]
    elif kind == "two boots":
        records = records + log(seed + 1, 3.0)
    else:
        link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
        for k in rng.integers(0, len(records), 60).tolist():
            at_ms = int(rng.integers(0, 1 << 32)) if kind == "other times" else 5_000 + 8 * k
            v = [float(x) for x in rng.choice([np.nan, np.inf, 1e30, 0.0], 3)]
            frame = link.local_position_ned_encode(at_ms, 0.0, 0.0, 0.0, *v).pack(link)
            records[k] = records[k][:8] + bytes(frame)
    for channel in RECIPE.channels:
        pieces = given_out(records, RECIPE, channel, [size])
        assert all(np.isfinite(piece.u).all() and np.isfinite(piece.y).all() for piece in pieces)
        for before, after in itertools.pairwise(pieces):
            if after.follows:
                assert after.t0_ns == before.t0_ns + len(before.u) * 20_000_000


def test_a_condition_is_read_from_the_source_that_the_recipe_prefers() -> None:
    """Though another one has come first."""
    first = [{"stream": "SYS_STATUS", "field": "load"}, {"stream": "HEARTBEAT", "field": "base_mode"}]
    document = msgspec.to_builtins(RECIPE)
    document["conditions"] = [{"name": "armed", "has_bits": 128, "sources": first, "margin_s": 0.0}]
    decoder = Decoder(streams_of(recipe := parse_recipe(document, "running")))
    grid = RunningGrid(recipe, "forward", 0.02, decoder)
    records = log(3)
    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    status = bytes(link.sys_status_encode(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0).pack(link))  # not armed
    half = len(records) // 2
    before = grid.take(decoder.read(b"".join(records[:half])))
    assert sum(len(piece.u) for piece in before) > 100
    stamp = records[half][:8]
    after = grid.take(decoder.read(b"".join([stamp + status, *records[half:]])))
    assert not after
    assert grid.lack == "armed does not hold"


def test_a_channel_says_why_it_gives_nothing() -> None:
    """Streams that have not come, a recipe that a link cannot serve; the latter as long as it lasts."""
    records = log(3)
    decoder = Decoder(streams_of(RECIPE))
    grid = RunningGrid(RECIPE, "forward", 0.02, decoder)
    assert grid.lack == "no stream for tilt has come (ATTITUDE_TARGET)"
    document = msgspec.to_builtins(RECIPE)
    document["signals"]["tilt"]["sources"][0]["row_period_s"] = 0.02
    decoder = Decoder(streams_of(recipe := parse_recipe(document, "running")))
    grid = RunningGrid(recipe, "forward", 0.02, decoder)
    told = []
    for at in range(0, len(records), 50):
        try:
            assert not grid.take(decoder.read(b"".join(records[at : at + 50])))
        except RecipeError as error:
            told.append(error)
    assert told
    assert "a link has its own times" in grid.lack
