"""Files that cannot be read as logs: each is refused by its own cause, with the byte and the way out.

Sixty and more that people have: other files under a log's name, harm on the way, missing beginnings.
"""

from __future__ import annotations

import base64
import gzip
import io
import lzma
import random
import sqlite3
import struct
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

import flysid
from flysid.errors import FormatError
from tests.command import call
from tests.samplelogs import blackbox, dataflash, mcap, parquet, rosbag, rosbag2, ulog

TABLE = "time,x\n" + "".join(f"{k / 10},{k}\n" for k in range(99))
PARAMETERS = b"ACRO_RP_P,4.5\nACRO_YAW_P,4.5\nAHRS_GPS_GAIN,1.0\n" * 9
WIFI = struct.pack("<IHHiIII4I", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 105, 1, 1, 60, 60) + bytes(60)


MISSION_PLANNER = "".join(
    f"2024-05-03T14:07:11.{k:03d},FE,1C,{k:X},1,1,1E,mavlink_attitude_t,time_boot_ms,{k},roll,0.1,Len,36\n"
    for k in range(90)
).encode()


def rows_of(spell: Callable[[int], str]) -> bytes:
    return "".join(spell(k) + "\n" for k in range(90)).encode()


def noise(count: int = 20_000) -> bytes:
    return random.Random(5).randbytes(count)


def without_definitions() -> bytes:
    blob = dataflash.build()
    kept = (blob[record.start : record.end] for record in dataflash.records(blob))
    return b"".join(piece for piece in kept if piece[:3] != b"\xa3\x95\x80")


def one_session() -> bytes:
    """A blackbox log of one session."""
    blob = blackbox.build()
    again = blob.find(b"H Product", 1)
    return blob[:again] if again > 0 else blob


def without_first_line() -> bytes:
    return one_session().split(b"\n", 1)[1]


def without_header() -> bytes:
    blob = one_session()
    return blob[blob.rindex(b"\nH ") + 1 :].split(b"\n", 1)[1]


def archive_of(name: str, blob: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(name, blob)
    return file.getvalue()


def tar_of(blob: bytes) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w:gz") as archive:
        about = tarfile.TarInfo("a.ulg")
        about.size = len(blob)
        archive.addfile(about, io.BytesIO(blob))
    return file.getvalue()


def other_database() -> bytes:
    link = sqlite3.connect(":memory:")
    link.execute("CREATE TABLE contacts(name TEXT)")
    link.execute("INSERT INTO contacts VALUES ('x')")
    link.commit()
    return link.serialize()


Row = tuple[str, bytes | Callable[[], bytes], str, str, int | None]
CAUSES: list[Row] = [
    # ------------------------------------------------------------------ harm on the way
    ("crlf.bbl", lambda: one_session().replace(b"\n", b"\r\n"), "copied as text", "binary mode", 60),
    ("utf8.bin", lambda: dataflash.build().decode("latin-1").encode(), "saved as text in UTF-8", "iconv", 0),
    ("seven.bin", lambda: bytes(b & 127 for b in dataflash.build()), "lost the first bit", "8 bits", 0),
    (
        "lf.mcap",
        lambda: mcap.build().replace(b"\r\n", b"\n"),
        "MCAP file that was copied as text",
        "binary",
        0,
    ),
    (
        "cr.mcap",
        lambda: mcap.build().replace(b"\n", b"\r\n"),
        "MCAP file that was copied as text",
        "binary",
        0,
    ),
    (
        "editor.bin",
        lambda: noise().decode("utf-8", "replace").encode(),
        "replaced, and are gone",
        "editor",
        None,
    ),
    ("hex.bin", lambda: dataflash.build().hex(" ").encode(), "written down in hexadecimal", "xxd", 0),
    ("base64.ulg", lambda: base64.encodebytes(ulog.build()), "written down in base64", "base64 -d", 0),
    ("utf16.csv", TABLE.encode("utf-16"), "UTF-16", "save it as UTF-8", 0),
    ("bare16.csv", TABLE.encode("utf-16-le"), "UTF-16", "save it as UTF-8", 0),
    ("big16.csv", TABLE.encode("utf-16-be"), "UTF-16", "save it as UTF-8", 0),
    # ------------------------------------------------------------------ what is missing
    ("nofmt.bin", without_definitions, "without their definitions (FMT)", "beginning of the log", 0),
    ("noline.bbl", without_first_line, "without its first line", "H Product:Blackbox", 0),
    ("nohead.bbl", without_header, "no Betaflight", "missing or overwritten", 0),
    ("nohead.bag", lambda: rosbag.build()[40:], "without its beginning: records", "--format rosbag", None),
    ("nohead.mcap", lambda: mcap.build()[20:], "without its beginning: records", "--format mcap", None),
    ("nohead.ulg", lambda: ulog.build()[200:], "no PX4 ULog begins so", "missing or overwritten", 0),
    ("nohead.db3", lambda: rosbag2.build()[4096:], "no ROS 2 bag", "missing or overwritten", 0),
    ("nohead.parquet", lambda: parquet.build()[20:], "no table in parquet", "missing or overwritten", 0),
    ("noend.parquet", lambda: parquet.build()[:-20], "footer", "copy it again", None),
    ("two.ulg.002", lambda: ulog.build()[3000:], "a piece of two.ulg", "cat two.ulg.* > two.ulg", 0),
    ("two.bin.part2", lambda: dataflash.build()[3000:], "a piece of two.bin", "cat two.bin.*", 0),
    ("empty.ulg", b"", "the file is empty", "download or copy finished", 0),
    ("zeros.bin", bytes(5000), "nothing but zeros", "never written", 0),
    ("erased.bin", b"\xff" * 5000, "nothing but bytes FF", "never written", 0),
    (
        "pointer.ulg",
        b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 1\n",
        "Git LFS",
        "lfs pull",
        0,
    ),
    ("annex.ulg", b"/annex/objects/SHA256E-s12345--4d7a.ulg\n", "git-annex", "git annex get", 0),
    ("link.bin", b"XSym\n0012\n3f2a\nlogs/a.bin", "symbolic link", "points to", 0),
    ("mac.csv", TABLE.replace("\n", "\r").encode(), "lines end with CR alone", "tr '", 6),
    ("._a.bin", b"\0\5\x16\7\0\2\0\0Mac OS X" + bytes(66), "note of macOS", "without ._", 0),
    (".DS_Store.bin", b"\0\0\0\1Bud1" + bytes(66), "about a folder", "give the log", 0),
    ("a.bin.lnk", b"L\0\0\0\1\x14\2\0" + bytes(66), "shortcut of Windows", "points to", 0),
    ("names.csv", b"time,x\n", "one line of text: 'time,x'", "rows below", 0),
    ("short.ulg.gz", lambda: gzip.compress(ulog.build())[:12], "end early", "download or copy", None),
    # ------------------------------------------------------------------ packed
    (
        "twice.zip",
        lambda: archive_of("in.zip", archive_of("a.ulg", ulog.build())),
        "an archive inside",
        "unpack",
        None,
    ),
    ("tar.tar.gz", lambda: tar_of(ulog.build()), "a tar archive", "tar xf", None),
    ("a.7z", b"7z\xbc\xaf\x27\x1c" + bytes(100), "an archive", "unpack it first", 0),
    ("a.rar", b"Rar!\x1a\x07\0" + bytes(100), "an archive", "unpack it first", 0),
    ("locked.ulge", b"ULogEnc\0" + noise(500), "an encrypted ULog", "decrypt_logs.py", 0),
    ("locked.bin", noise(), "as even as random ones", "decrypt or unpack", 0),
    # ------------------------------------------------------------------ of programs beside the log
    ("mission.csv", MISSION_PLANNER, "Mission Planner wrote as CSV", "the .tlog itself", 0),
    ("arduino.csv", rows_of(lambda k: f"14:07:11.{k:03d} -> {k},7"), "serial monitor", "sed", 0),
    ("serial.log", rows_of(lambda k: f"[14:07:11.{k:03d}] {k},7"), "serial monitor", "sed", 0),
    (
        "echo.txt",
        rows_of(lambda k: f"header:\n  stamp:\n    sec: {k}\nx: 0.5\n---"),
        "topic echo",
        "--csv",
        0,
    ),
    (
        "points.csv",
        rows_of(lambda k: f"att,id=1 roll={k}.5,y=1 1714745231{k:09d}"),
        "InfluxDB",
        "influx query",
        0,
    ),
    ("layout.xml", b"<root>\n <tabbed_widget name='a'/>\n</root>", "layout of PlotJuggler", "made for", 0),
    ("track.geojson", b'{"type": "FeatureCollection",\n "features": []}\n', "GeoJSON", "autopilot", 0),
    ("parrot.json", b'{"version": "1",\n"details_headers":["time"]}\n', "Parrot", "details_data", 0),
    (
        "beep.event",
        b'{"name":"Sync beep", "time":12}\n{"name":"Disarm", "time":15}\n',
        "blackbox_decode",
        ".bbl",
        0,
    ),
    ("rows.jsonl", rows_of(lambda k: f'{{"time": {k}, "roll": 1}}'), "one object a line", "lines=True", 0),
    ("rows.json", b'[{"time": 1, "x": 2},\n{"time": 2, "x": 3}]\n', "in one list", "read_json(PATH)", 0),
    ("columns.json", b'{"time": [1, 2],\n"x": [3, 4]}\n', "columns in JSON", "read_json(PATH)", 0),
    ("viewer.json", b'{"ATT": {"Roll": [1, 2],\n"Pitch": [1]}}\n', "several messages in JSON", ".tlog", 0),
    ("keyed.log", rows_of(lambda k: f"t={k}.5 roll=-1.5 m1={k}"), "name every number", "sed -E", 0),
    ("tilde.csv", b"time~x\n" + rows_of(lambda k: f"{k}~{k}"), "'~' separates", "tr '~' ','", 0),
    (
        "wider.csv",
        b"time,x\n" + rows_of(lambda k: f"{k},7") + b"time,x,y\n" + rows_of(lambda k: f"{k},7,8"),
        "two tables in one file: 91 lines of 2 cells and 91 of 3",
        "head -n 91 IN > one.csv; tail -n +92 IN",
        447,
    ),
    ("units.csv", b"time,x\ns,m\n", "names without rows", "before its first row", 0),
    ("a.lz", b"LZIP" + bytes(60), "an archive (lzip)", "lzip -d", 0),
    ("a.csv.lzma", lzma.compress(TABLE.encode(), lzma.FORMAT_ALONE), "an archive (lzma)", "unlzma", 0),
    (
        "stream.arrow",
        b"\xff" * 4 + struct.pack("<I", 168) + bytes(200),
        "a table in Feather",
        "to_parquet",
        0,
    ),
    ("v4.mat", struct.pack("<5I", 0, 1, 9, 0, 2) + b"t\0" + bytes(72), "a MATLAB file", "writetable", 0),
    # ------------------------------------------------------------------ something else
    ("page.bin", b"<!DOCTYPE html><html><body>log in</body></html>", "a web page", "log in", 0),
    ("page.ulg", b"<!-- cached -->\n<head><title>404</title></head>", "a web page", "download again", 0),
    (
        "denied.bin",
        b'<?xml version="1.0"?><Error><Code>AccessDenied</Code></Error>',
        "message of a store",
        "again",
        0,
    ),
    ("error.ulg", b'{"error": "not found",\n "status": 404}\n', "a JSON document", "the log itself", 0),
    ("a.xml.bin", b'<?xml version="1.0"?><session/>', "an XML document", "give the log", 0),
    ("track.csv", b"<?xml version='1.0'?>\n<!-- x --><gpx version='1.1'></gpx>", "GPS track", "autopilot", 0),
    ("track.kml", b"<kml><coordinates>7.1,51.2,80</coordinates></kml>\n", "GPS track", "autopilot", 0),
    ("watch.bin", b"\x0e\x10\xd9\x07\x10\0\0\0.FIT" + bytes(99), "(FIT)", "give the log", 0),
    ("glider.txt", b"AXXXABC flight\nHFDTE160701\nB1101355206343N\n", "IGC", "autopilot", 0),
    (
        "rinex.txt",
        b" " * 5 + b"3.03           OBSERVATION DATA    M                   RINEX VERSION\n",
        "RINEX",
        "own log",
        0,
    ),
    ("gps.txt", b"$GPGGA,123519,4807.038,N,01131.000,E*47\r\n" * 9, "NMEA", "gpsbabel", 0),
    ("gps.bin", b"\xb5\x62\x01\x07" + bytes(99), "u-blox", "positions", 0),
    ("settings.bin", PARAMETERS, "a list of parameters", "settings, not a flight", 0),
    ("settings.csv", PARAMETERS, "a list of parameters", "settings, not a flight", 0),
    (
        "qgc.ulg",
        b"# Onboard parameters\n#\n" + b"1\t1\tACRO_P\t4.5\t9\n# a note\n" * 5,
        "a list of parameters",
        "flight",
        0,
    ),
    ("dump.bbl", b"# diff all\n# version\nset gyro_lpf1 = 0\n", "CLI diff or dump", ".bbl", 0),
    ("plan.bin", b'{\n "fileType": "Plan",\n "version": 1}\n', "a plan of QGroundControl", "not a flight", 0),
    ("points.txt", b"QGC WPL 110\n0\t1\t0\t16\t0\t0\n", "a plan of waypoints", "not a flight", 0),
    ("board.bin", b'{"board_id": 9, "magic": "APJFWv1", "image": "eNq"}', "firmware", "give the log", 0),
    (
        "board.hex.bin",
        b":020000040800F2\n:10000000214601360121470136007EFE09D21901\n",
        "firmware",
        "give the log",
        0,
    ),
    ("film.tlog", b"\0\0\0\x20ftypisom" + bytes(300), "a video", "SD card", 0),
    ("photo.ulg", b"\xff\xd8\xff\xe0" + bytes(300), "a picture", "give the log", 0),
    ("sheet.csv", b"PK\3\4" + bytes(26) + b"[Content_Types].xml" + bytes(200), "office", "as CSV", 0),
    ("text.csv", b"{\\rtf1\\ansi time,x}\n", "RTF", "as CSV", 0),
    ("dump.csv", b"-- dump\nCREATE TABLE x (a int);\n", "SQL", "export the table", 0),
    ("frame.csv", b"\x80\x04\x95" + bytes(100), "a Python pickle", "to_parquet", 0),
    ("feather.parquet", b"ARROW1\0\0" + bytes(100), "Feather", "to_parquet", 0),
    ("mail.ulg", b"From: a@b.c\nSubject: log\n\nUVxvZw==\n", "an e-mail", "attachment", 0),
    (
        "link.url.bin",
        b"[InternetShortcut]\r\nURL=https://example.org\r\n",
        "link to a web page",
        "download",
        0,
    ),
    ("contacts.db3", other_database, "which holds contacts", "another program", 0),
    ("old.bag", b"#ROSBAG V1.2\n" + bytes(99), "before 2.0", "rosbag fix", 0),
    ("radio.pcap", WIFI, "link type 105", "not on the radio", 20),
    ("notes.log", b"Wind from west\nGusts\n", "its first line is 'Wind from west'", "the log itself", 0),
    ("words.csv", b"name,comment\n" + b"a,b\n" * 50, "no table of numbers", "numbers in the rows", 0),
    (
        "mini.bin",
        b"\x01\xfe\x02\x00\x80rest",
        "its first bytes are 01 FE 02 00 80",
        "missing or overwritten",
        0,
    ),
]


def lay(folder: Path) -> None:
    for name, blob, *_ in CAUSES:
        (folder / name).write_bytes(blob if isinstance(blob, bytes) else blob())


@pytest.mark.parametrize(("name", "blob", "said", "hint", "byte"), CAUSES, ids=[row[0] for row in CAUSES])
def test_the_cause_the_byte_and_the_way_out_are_named(
    name: str, blob: bytes | Callable[[], bytes], said: str, hint: str, byte: int | None, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(blob if isinstance(blob, bytes) else blob())
    with pytest.raises(FormatError) as raised:
        flysid.read(path)
    assert said in raised.value.message
    assert hint in raised.value.hint
    assert byte is None or raised.value.byte == byte or (not byte and (raised.value.byte or 0) < 99)


def test_the_command_names_every_cause(tmp_path: Path) -> None:
    lay(tmp_path)
    done = call("doctor", *(name for name, *_ in CAUSES), cwd=tmp_path)
    told = " ".join(done.stderr.split())
    assert done.returncode == 1
    assert "Traceback" not in told
    assert [name for name, _, said, *_ in CAUSES if " ".join(said.split()) not in told] == []


def test_no_cause_is_given_for_many(tmp_path: Path) -> None:
    lay(tmp_path)
    messages: dict[str, list[str]] = {}
    for name, *_ in CAUSES:
        with pytest.raises(FormatError) as raised:
            flysid.read(tmp_path / name)
        messages.setdefault(raised.value.message, []).append(name)
    assert max(len(names) for names in messages.values()) <= 3, messages


def test_a_damaged_log_that_was_copied_as_text_is_told_so(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(dataflash.build().replace(b"\n", b"\r\n"))
    done = call("doctor", "a.bin", cwd=tmp_path)
    assert "it was copied as text, which put a byte 0D ahead of every 0A" in " ".join(done.stderr.split())


def test_a_log_without_records_is_told_so(tmp_path: Path) -> None:
    """Two of these were advised to log more often."""
    blob = dataflash.build()
    last = max(record.end for record in dataflash.records(blob) if blob[record.start + 2] == 128)
    (tmp_path / "formats.bin").write_bytes(blob[:last])
    (tmp_path / "header.bbl").write_bytes(one_session()[: one_session().index(b"H Field")])
    done = call("doctor", "formats.bin", "header.bbl", cwd=tmp_path)
    told = " ".join((done.stdout + done.stderr).split())
    assert "formats.bin, header.bbl: empty: no record behind the definitions" in told, told


def test_files_that_are_skipped_for_one_kind_of_reason_share_no_words_of_one(tmp_path: Path) -> None:
    names = [f"{k}.log" for k in range(5)]
    for name in names:
        (tmp_path / name).write_text(f"note {name}")
    done = call("doctor", *names, cwd=tmp_path)
    assert (
        "skipped: 5 files: 0.log, 1.log, 2.log and 2 more: one line of text; try: give the log" in done.stderr
    )


def test_random_bytes_never_stop_a_refusal(fresh_seed: int) -> None:
    from flysid.ingest.formats.registry import detect

    rng = random.Random(fresh_seed)
    starts = [b"", b"H ", b"\xa3\x95", b"{", b"<", b"PK", b"\xef\xbf\xbd" * 9, b"\x89MCAP0", b"#"]
    for _ in range(300):
        head = rng.choice(starts) + rng.randbytes(rng.randrange(1, 3000))
        name = rng.choice(["a.bin", "a.ulg", "a.mcap", "a.bag", "a.bbl", "a.csv", "a", "a.bin.003"])
        refused = None
        try:
            detect(head, name)
        except FormatError as error:
            refused = error
        assert refused is None or (refused.message and refused.hint)
