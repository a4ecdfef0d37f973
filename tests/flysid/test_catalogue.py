"""The catalogue: an index that never lies, and what it saves."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import msgspec
import pytest

from flysid import catalogue as catalogue_module
from flysid import manifest, store
from flysid.catalogue import CATALOGUE_FILE, catalogue
from flysid.errors import StoreError
from flysid.flight import ClockMap, Damage, Source
from flysid.ingest.formats.base import Summary
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from tests.flysid.test_store import parts, table
from tests.ingest.lake.test_batch import write_logs

MANY = 300


def sha(number: int) -> str:
    return f"{number:04x}" * 16


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A folder of three flights."""
    folder = store.create_data_folder(tmp_path / "data")
    summary = Summary(Damage(bytes_skipped=1), (ClockMap(0, 0, 10**9, 5 * 10**18),), {"vehicle": "quadrotor"})
    for k in range(3):
        source = Source(f"log{k}.tlog", "tlog", 3, sha(k))
        rows = parts(("1.1/A", table([10, 20])), ("1.1/B", table([1])), summary=summary)
        store.write_flight(folder, source, rows)
    return folder


@pytest.fixture
def many(data: Path) -> Path:
    """The same with many copies of one flight."""
    (first, *_) = sorted((data / "flights").iterdir())
    text = (first / "manifest.json").read_text()
    for k in range(3, MANY):
        folder = data / "flights" / f"log{k}-{sha(k)[:8]}"
        shutil.copytree(first, folder)
        (folder / "manifest.json").write_text(text.replace(first.name, folder.name).replace(sha(0), sha(k)))
    return data


class Opened:
    """Which files of a folder are opened, and how many bytes of them are read."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.files: list[str] = []
        self.bytes = 0
        read = Path.read_bytes

        def noted(path: Path) -> bytes:
            content = read(path)
            self.files.append(path.name)
            self.bytes += len(content)
            return content

        monkeypatch.setattr(Path, "read_bytes", noted)


def test_it_holds_what_the_manifests_say(data: Path) -> None:
    for facts, flight in zip(catalogue(data), store.list_flights(data), strict=True):
        assert facts.id == flight.id
        assert (facts.log, facts.format) == (flight.source.name, "tlog")
        assert (facts.size_bytes, facts.sha256) == (3, flight.source.sha256)
        assert facts.streams == {"1.1/A": 2, "1.1/B": 1}
        assert (facts.rows, facts.duration_s, facts.lossy) == (3, 1.0, True)
        assert facts.start_utc_ns == 5 * 10**18
        assert facts.info == {"vehicle": "quadrotor"}
    assert len({facts.layout for facts in catalogue(data)}) == 1


def test_a_folder_is_listed_and_opened_without_opening_its_flights(
    many: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(catalogue(many)) == MANY
    opened = Opened(monkeypatch)
    lake = open_lake(many)
    assert len(lake) == len(lake.flights) == MANY
    assert opened.files == ["flysid-data.json", "flysid-data.json", CATALOGUE_FILE]
    assert opened.bytes < 400 * MANY
    opened.files.clear()
    assert lake.channels("ardupilot-attitude") == ()
    assert opened.files == []  # no flight has a stream of that name
    assert lake.flights[7].id == lake.facts[7].id
    assert opened.files == ["manifest.json"]
    opened.files.clear()
    assert store.find_flight(many, "log7-").source.sha256 == sha(7)
    assert opened.files == ["flysid-data.json", "manifest.json"]


def test_unchanged_logs_are_known_without_opening_flights(
    many: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = find_logs(write_logs(tmp_path / "logs", 5))
    assert all(r.flight for r in ingest_logs(logs, many, bounds=None))
    opened = Opened(monkeypatch)
    results = list(ingest_logs(logs, many, bounds=None))
    assert [r.unchanged for r in results] == [True] * 5
    assert "manifest.json" not in opened.files


def change(folder: Path) -> None:
    """Another stream, by another length of the manifest."""
    path = folder / "manifest.json"
    document = json.loads(path.read_text())
    document["info"] = {"vehicle": "changed"}
    path.write_text(json.dumps(document))


def test_what_changes_in_the_folder_shows(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, third = (data / "flights" / facts.id for facts in catalogue(data))
    change(first)
    shutil.rmtree(second)
    store.write_flight(data, Source("new.tlog", "tlog", 3, sha(9)), parts(("s", table([1]))))
    (third / "manifest.json").rename(third / "manifest.gone")
    opened = Opened(monkeypatch)
    found = catalogue(data)
    assert [(facts.id, dict(facts.info)) for facts in found] == [
        (first.name, {"vehicle": "changed"}),
        (f"new-{sha(9)[:8]}", {}),
    ]
    assert opened.files.count("manifest.json") == 2  # what changed and what is new
    assert [m.id for m in store.list_flights(data)] == [facts.id for facts in found]


def test_a_flight_that_is_replaced_by_one_of_equal_length_shows(data: Path) -> None:
    (facts, *_) = catalogue(data)
    source = Source(facts.log, "tlog", 3, facts.sha256)
    summary = Summary(info={"vehicle": "octorotor"})
    written = store.write_flight(data, source, parts(("1.1/A", table([1])), summary=summary), replace=True)
    assert catalogue(data)[0].info == written.info


@pytest.mark.parametrize(
    "content",
    [b"", b"\x00", b"not msgpack at all", b"\x92\x02\x90", b"\x92\x01\x91\xc0", b"\x91" * 5000],
    ids=["empty", "a number", "text", "another version", "forged", "deep"],
)
def test_a_damaged_catalogue_is_made_anew(data: Path, content: bytes) -> None:
    before = catalogue(data)
    (data / CATALOGUE_FILE).write_bytes(content)
    assert catalogue(data) == before
    assert (data / CATALOGUE_FILE).read_bytes() != content


def test_a_catalogue_names_no_flight_that_is_not_there(data: Path) -> None:
    before = catalogue(data)
    forged = [msgspec.structs.replace(before[0], id=name) for name in ("../x", "y")]
    content = msgspec.msgpack.encode((1, (*before, *forged)))
    (data / CATALOGUE_FILE).write_bytes(content)
    assert catalogue(data) == before


def test_a_folder_that_is_read_only_has_no_catalogue(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(catalogue_module, "write_atomically", refused)
    assert len(catalogue(data)) == 3
    assert not (data / CATALOGUE_FILE).exists()


def test_a_damaged_manifest_is_named_though_the_catalogue_knew_it(data: Path) -> None:
    (facts, *_) = catalogue(data)
    path = data / "flights" / facts.id / "manifest.json"
    path.write_text("{")
    with pytest.raises(StoreError, match="not JSON") as found:
        open_lake(data)
    assert str(found.value.path) == str(path)


def test_what_a_killed_writer_of_the_catalogue_left_is_cleaned(data: Path) -> None:
    (data / f".{CATALOGUE_FILE}.{os.getpid()}").write_bytes(b"half")
    store.clean(data)
    assert sorted(p.name for p in data.iterdir()) == ["flights", "flysid-data.json"]


def test_columns_of_many_flights_are_kept_once(many: Path) -> None:
    first, second, *_ = store.list_flights(many)
    assert first.stream("A").columns is second.stream("A").columns
    assert manifest.to_json(first) == (many / "flights" / first.id / "manifest.json").read_bytes()
