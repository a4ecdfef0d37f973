"""Packed logs: .gz, .zst and members of .zip archives are read like the logs that they hold."""

from __future__ import annotations

import gzip
import io
import json
import random
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import zstandard
from click.testing import CliRunner, Result
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import flysid
from flysid.cli import root
from flysid.errors import FormatError, UsageError
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import compression
from flysid.ingest.formats.common.compression import CompressionError, unpacked_pieces
from flysid.ingest.formats.opening import open_log
from flysid.ingest.formats.scrubbing import scrub_log
from tests.format_trials import FORMATS, module_of, sample
from tests.private_logs import PRIVATE
from tests.samplelogs import dataflash, tlog, ulog

LOG = tlog.build()
LOGS = Path(__file__).resolve().parents[4] / "shared" / "logs"
REAL = sorted([*LOGS.glob("tlog/sitl_copter*.tlog"), *LOGS.glob("dataflash/*")])
PLACE = st.integers(0, 10**6)


def zst(blob: bytes) -> bytes:
    packed: bytes = zstandard.ZstdCompressor(write_checksum=True).compress(blob)
    return packed


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, blob in members.items():
            archive.writestr(name, blob)
    return out.getvalue()


def streamed_zip(members: dict[str, bytes]) -> bytes:
    """An archive as it is written into a pipe: sizes stand behind the members."""

    class Pipe(io.BytesIO):
        def seekable(self) -> bool:
            return False

        def tell(self) -> int:
            raise OSError

    out = Pipe()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, blob in members.items():
            archive.writestr(name, blob)
    return out.getvalue()


def gz(blob: bytes) -> bytes:
    return gzip.compress(blob)


PACKINGS: dict[str, Callable[[bytes], bytes]] = {".gz": gz, ".zst": zst, ".zstd": zst}


def cli(*words: str | Path) -> Result:
    return CliRunner().invoke(root, [str(w) for w in words], standalone_mode=False)


def put(path: Path, blob: bytes) -> Path:
    path.write_bytes(blob)
    return path


# ------------------------------------------------------------------------------------------- every format


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("suffix", [*PACKINGS, ".zip"])
def test_every_format_is_read_packed(tmp_path: Path, kind: str, suffix: str) -> None:
    name = "log" + module_of(kind).SUFFIX
    plain = flysid.read(put(tmp_path / name, sample(kind)))
    pack = PACKINGS[suffix] if suffix in PACKINGS else lambda blob: zipped({name: blob})
    packed = flysid.read(put(tmp_path / (name + suffix), pack(sample(kind))))
    assert packed.source == plain.source
    assert packed.tables == plain.tables
    assert packed.damage == plain.damage


def compare_with_the_log(path: Path) -> None:
    """A real log is read the same from every packing."""
    plain = flysid.read(path)
    blob = path.read_bytes()
    packings: dict[str, Callable[[bytes], bytes]] = {
        **PACKINGS,
        ".zip": lambda whole: zipped({path.name: whole}),
    }
    with tempfile.TemporaryDirectory() as folder:
        for suffix, pack in packings.items():
            packed = flysid.read(put(Path(folder) / (path.name + suffix), pack(blob)))
            assert packed.source == plain.source
            assert set(packed.tables) == set(plain.tables)
            assert packed.rows == plain.rows
            assert packed.damage == plain.damage


@pytest.mark.skipif(not REAL, reason="no ../shared/logs")
def test_a_real_log_is_read_the_same_from_every_packing() -> None:
    compare_with_the_log(REAL[0])


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_each_member_of_an_archive_is_a_log(tmp_path: Path, method: int) -> None:
    blob = zipped({"monday/one.tlog": LOG, "two.ulg": ulog.build(), "README.md": b"two flights\n"}, method)
    path = put(tmp_path / "flights.zip", blob)
    assert flysid.read(path / "monday" / "one.tlog").tables == flysid.read(put(tmp_path / "a", LOG)).tables
    done = cli("ingest", path, "-o", tmp_path / "data")
    assert done.return_value == 0, done.stderr
    assert [line.rpartition("-")[0] for line in done.stdout.split()] == ["one", "two"]
    with pytest.raises(FormatError, match="an archive of 3 files"):
        flysid.read(path)
    with pytest.raises(FormatError, match="no member 'three'"):
        flysid.read(path / "three")


def test_a_log_may_be_packed_twice_and_no_more(tmp_path: Path) -> None:
    members = {"a.tlog.gz": gzip.compress(LOG), "b.ulg.zst": zst(ulog.build())}
    twice = put(tmp_path / "twice.zip", zipped(members))
    done = cli("ingest", twice, "-o", tmp_path / "data")
    assert done.return_value == 0, done.stderr
    assert len(done.stdout.split()) == 2
    for name, blob in {
        "a.zip": zipped({"b.zip": zipped({"one.tlog": LOG})}),
        "b.gz": gzip.compress(gzip.compress(LOG)),
        "c.zst": zst(zipped({"one.tlog": LOG})),
    }.items():
        with pytest.raises(FormatError, match=r"packed too many times: (an archive|gzip) inside"):
            flysid.read(put(tmp_path / name, blob))


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("name", ["a.zip.gz", "a.bin"])
def test_an_archive_that_is_packed_itself_is_named_as_such(tmp_path: Path, name: str, count: int) -> None:
    """Its headers were looked for in the packed bytes: found by chance, or "cut off or damaged"."""
    members = {f"{k}.tlog": LOG + random.Random(k).randbytes(30_000) for k in range(count)}
    path = put(tmp_path / name, gzip.compress(zipped(members)))
    for said in (
        cli("ingest", path, "-o", tmp_path / "one"),
        cli("ingest", tmp_path, "-o", tmp_path / "all"),
    ):
        assert said.return_value != 0
        assert "an archive inside" in said.stderr
        assert "damaged" not in said.stderr


@pytest.mark.parametrize("size", [0, 100, 300, 200_000])
@pytest.mark.parametrize("off_by", [-1, 1, 5000])
def test_a_zstd_frame_that_states_a_wrong_size_keeps_what_it_holds(size: int, off_by: int) -> None:
    """Before, libzstd's check of the size took a whole block with it: all of a short log."""
    blob = random.Random(size).randbytes(size) + LOG[:300]
    packed = bytearray(zst(blob))
    single = bool(packed[4] & 0x20)
    width = (1, 2, 4)[packed[4] >> 6]
    at = 5 + (not single)
    stated = int.from_bytes(packed[at : at + width], "little") + off_by
    packed[at : at + width] = (stated % 256**width).to_bytes(width, "little")
    found: list[bytes] = []
    with pytest.raises(CompressionError, match=rf"states \d+ bytes and holds {len(blob)}"):
        found.extend(unpacked_pieces(memoryview(bytes(packed)), 200.0))
    assert b"".join(found) == blob


def test_frames_one_behind_the_other_are_one_log(tmp_path: Path) -> None:
    third = len(LOG) // 3
    parts = [LOG[:third], LOG[third : 2 * third], LOG[2 * third :]]
    skippable = struct.pack("<II", 0x184D2A53, 5) + b"about"
    for suffix, blob in {
        ".gz": b"".join(map(gzip.compress, parts)) + bytes(600),
        ".zst": skippable.join(map(zst, parts)) + skippable,
    }.items():
        flight = flysid.read(put(tmp_path / ("a.tlog" + suffix), blob))
        assert flight.source.size_bytes == len(LOG)
        assert not flight.damage.lossy


# --------------------------------------------------------------------------------------- cut and damaged


@pytest.mark.parametrize("suffix", [".gz", ".zst", ".zip"])
def test_a_cut_file_gives_what_it_holds_and_says_so(tmp_path: Path, suffix: str) -> None:
    log = LOG + random.Random(2).randbytes(400_000)  # several blocks of zstd
    pack = PACKINGS[suffix] if suffix in PACKINGS else lambda blob: zipped({"a.tlog": blob})
    whole = pack(log)
    path = put(tmp_path / ("a.tlog" + suffix), whole[: len(whole) // 2])
    with open_log(path / "a.tlog" if suffix == ".zip" else path) as opened:
        got = bytes(opened.view)
    assert log.startswith(got)
    assert len(got) > 100
    done = cli("ingest", path, "-o", tmp_path / "data")
    assert done.return_value == 3
    assert "ends" in done.stderr
    assert len(done.stdout.split()) == 1


@pytest.mark.parametrize("suffix", [".gz", ".zst", ".zip"])
def test_damage_inside_loses_only_what_stands_behind_it(tmp_path: Path, suffix: str) -> None:
    log = random.Random(1).randbytes(400_000) + bytes(400_000)
    pack = PACKINGS[suffix] if suffix in PACKINGS else lambda blob: zipped({"a.tlog": blob})
    whole = bytearray(pack(log))
    at = len(whole) * 3 // 4
    whole[at : at + 40] = bytes(40)
    path = put(tmp_path / ("a.tlog" + suffix), bytes(whole))
    with open_log(path) as opened:
        got = bytes(opened.view)
        assert opened.lost
    same = next((k for k, (a, b) in enumerate(zip(got, log, strict=False)) if a != b), len(got))
    assert same > 100_000, (same, opened.lost)


def test_a_wrong_checksum_keeps_every_byte_and_is_told(tmp_path: Path) -> None:
    packed = bytearray(gzip.compress(LOG))
    packed[-8] ^= 1
    archive = bytearray(zipped({"a.tlog": LOG}))
    at = archive.index(b"PK\x01\x02") + 16
    archive[at] ^= 1
    for name, blob in {"a.tlog.gz": packed, "a.zip": archive}.items():
        flight = flysid.read(put(tmp_path / name, bytes(blob)))
        assert flight.source.size_bytes == len(LOG), name
        assert flight.damage.lossy
        assert "check" in flight.damage.reasons["packing"]


def test_what_stands_behind_the_packed_data_is_told(tmp_path: Path) -> None:
    flight = flysid.read(put(tmp_path / "a.tlog.gz", gzip.compress(LOG) + b"garbage"))
    assert flight.source.size_bytes == len(LOG)
    assert "7 bytes behind the gzip data" in flight.damage.reasons["packing"]


@pytest.mark.parametrize("make", [zipped, streamed_zip])
def test_an_archive_without_its_list_gives_its_members(
    tmp_path: Path, make: Callable[[dict[str, bytes]], bytes]
) -> None:
    members = {"one.tlog": LOG, "two.bin": dataflash.build(), "three.ulg": ulog.build()}
    blob = make(members)
    path = put(tmp_path / "a.zip", blob[: blob.index(b"PK\x01\x02")])
    for name, log in members.items():
        with open_log(path / name) as opened:
            assert bytes(opened.view) == log
            assert not opened.lost
    done = cli("ingest", path, "-o", tmp_path / "data")
    assert done.return_value == 3
    assert "list of members is cut off" in done.stderr
    assert len(done.stdout.split()) == 3


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits=st.lists(st.tuples(PLACE, st.integers(0, 255)), max_size=6), cut=PLACE)
@pytest.mark.parametrize("suffix", [".gz", ".zst", ".zip"])
def test_no_damage_ends_in_anything_but_words(
    tmp_path: Path, suffix: str, edits: list[tuple[int, int]], cut: int
) -> None:
    members = {"b.ulg": ulog.build()}
    pack = PACKINGS[suffix] if suffix in PACKINGS else lambda log: zipped({"a.tlog": log, **members})
    blob = bytearray(pack(LOG[:4000]))
    for at, value in edits:
        blob[4 + at % (len(blob) - 4)] = value  # the magic stays: without it, it is no packed log
    path = put(tmp_path / f"a{suffix}", bytes(blob[: 4 + cut % (len(blob) - 3)]))
    with suppress(FormatError), open_log(path / "a.tlog" if suffix == ".zip" else path) as opened:
        assert opened.lost or bytes(opened.view) == LOG[:4000]


# ------------------------------------------------------------------------------------------------ hostile


def test_a_member_cannot_lead_out_of_its_archive(tmp_path: Path) -> None:
    put(tmp_path / "secret.tlog", LOG)
    names = ("../../secret.tlog", "/etc/one.tlog", "C:\\logs\\two.tlog", "a/../../three.tlog", "..")
    path = put(tmp_path / "a.zip", zipped(dict.fromkeys(names, LOG)))
    found = [str(p.relative_to(path)) for p in flysid_members(path)]
    assert found == ["secret.tlog", "etc/one.tlog", "logs/two.tlog", "a/three.tlog", "(no name)"]


def flysid_members(path: Path) -> list[Path]:
    from flysid.ingest.formats.opening import members_of

    return [path / name for name in members_of(path)]


def test_two_members_of_one_name_are_two_logs(tmp_path: Path) -> None:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("a.tlog", LOG)
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("a.tlog", ulog.build())
    path = put(tmp_path / "a.zip", out.getvalue())
    assert flysid.read(path / "a.tlog").source.format == "tlog"
    assert flysid.read(path / "a.tlog#2").source.format == "ulog"


def test_an_encrypted_member_is_named_with_the_way_out(tmp_path: Path) -> None:
    blob = bytearray(zipped({"a.tlog": LOG}))
    blob[6] |= 1
    blob[blob.index(b"PK\x01\x02") + 8] |= 1
    path = put(tmp_path / "a.zip", bytes(blob))
    with pytest.raises(FormatError, match=r"is encrypted .*unpack it first"):
        flysid.read(path)


@pytest.mark.parametrize("suffix", [".gz", ".zst", ".zip"])
@pytest.mark.parametrize("front", [0, 3 << 20])
def test_bombs_stop_at_the_limits(
    tmp_path: Path, suffix: str, front: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However much stands ahead of it, a bomb adds no more than is free, and what it follows is read."""
    monkeypatch.setattr(compression, "FREE_BYTES", 4 << 20)
    log = LOG + random.Random(3).randbytes(front) + LOG
    packed = (
        PACKINGS[suffix](log + bytes(64 << 20))
        if suffix in PACKINGS
        else zipped({"a.tlog": log + bytes(64 << 20)})
    )
    path = put(tmp_path / f"a{suffix}", packed)
    flight = flysid.read(path, limits=Limits(max_ratio=50))
    assert "more than 50 times their size: the rest is left out" in flight.damage.reasons["packing"]
    assert flight.source.size_bytes < len(log) + (24 << 20)
    copies = sum(flight.damage.repeats.values())
    assert flight.rows + copies == 2 * flysid.read(put(tmp_path / "one.tlog", LOG)).rows
    assert flight.damage.truncated


def test_many_small_bombs_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compression, "FREE_BYTES", 4 << 20)
    packed = gzip.compress(LOG) + 100 * gzip.compress(bytes(1 << 20))
    found: list[int] = []
    with pytest.raises(CompressionError, match="the rest is left out"):
        found.extend(map(len, unpacked_pieces(memoryview(packed), 50.0)))
    assert len(LOG) < sum(found) < 8 << 20


def test_members_that_share_their_bytes_are_refused(tmp_path: Path) -> None:
    blob = zipped({"a.tlog": LOG, "b.tlog": LOG})
    at = [m for m in range(len(blob)) if blob[m : m + 4] == b"PK\x01\x02"][1]
    forged = bytearray(blob)
    forged[at + 42 : at + 46] = bytes(4)  # the second begins where the first does
    path = put(tmp_path / "a.zip", bytes(forged))
    with pytest.raises(FormatError, match="shares bytes with another member"):
        flysid.read(path / "b.tlog")


# ---------------------------------------------------------------------------------------------- the verbs


def test_the_same_log_packed_and_not_is_one_flight(tmp_path: Path) -> None:
    put(tmp_path / "a.tlog", LOG)
    put(tmp_path / "a.tlog.gz", gzip.compress(LOG))
    first = cli("ingest", tmp_path / "a.tlog", "-o", tmp_path / "data")
    again = cli("ingest", tmp_path / "a.tlog.gz", "-o", tmp_path / "data")
    assert (first.return_value, again.return_value) == (0, 0)
    assert "1 unchanged" in again.stderr


def test_doctor_names_the_packed_file(tmp_path: Path) -> None:
    put(tmp_path / "a.tlog.gz", gzip.compress(LOG))
    put(tmp_path / "b.zip", zipped({"one.tlog": LOG}))
    seen = cli("doctor", tmp_path)
    assert seen.return_value == 0
    assert [line.split()[0] for line in seen.stdout.splitlines()[:3]] == [
        "FILE",
        "a.tlog.gz",
        "b.zip/one.tlog",
    ]
    document = json.loads(cli("doctor", tmp_path / "a.tlog.gz", "--json").stdout)
    assert document["logs"][0]["file"] == "a.tlog.gz"


def test_a_fit_takes_a_packed_log_and_a_member(tmp_path: Path) -> None:
    rows = "\n".join(f"{k * 0.02:.2f},{k % 17},{k % 5}" for k in range(200))
    table = f"t,u,y\n{rows}\n".encode()
    for path in (
        put(tmp_path / "a.csv.gz", gzip.compress(table)),
        put(tmp_path / "a.zip", zipped({"a.csv": table})) / "a.csv",
    ):
        done = cli("tf", path, "--from", "u", "--to", "nothing")
        assert isinstance(done.exception, UsageError)
        assert "no log has a field 'nothing'" in str(done.exception)


@pytest.mark.parametrize("suffix", ["", ".gz", ".zst"])
def test_a_scrubbed_copy_is_packed_as_its_name_says(tmp_path: Path, suffix: str) -> None:
    log = PRIVATE["tlog"]()
    path = put(tmp_path / "a.zip", zipped({"a.tlog": log.blob}))
    scrub_log(path, tmp_path / ("copy.tlog" + suffix))
    raw = (tmp_path / ("copy.tlog" + suffix)).read_bytes()
    copy = zlib.decompress(raw, 31) if suffix == ".gz" else raw
    copy = zstandard.ZstdDecompressor().decompressobj().decompress(raw) if suffix == ".zst" else copy
    assert not [s for s in log.secrets if s in copy]
    assert flysid.read(tmp_path / ("copy.tlog" + suffix)).rows
    with pytest.raises(UsageError, match="one log, not an archive"):
        scrub_log(path, tmp_path / "copy.zip")


@pytest.mark.parametrize("added", [b"", b"garbage" * 9])
def test_an_archive_whose_bytes_moved_gives_what_its_members_hold_up_to_there(
    added: bytes, tmp_path: Path
) -> None:
    log = sample("tlog") * 3
    path = tmp_path / "flights.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.tlog", log)
    blob = path.read_bytes()
    at = len(blob) // 2
    path.write_bytes(blob[:at] + added + blob[at + (0 if added else 64) :])
    flight = flysid.read(path)
    assert 50 < flight.rows < 3 * 135
    assert flight.damage.truncated
