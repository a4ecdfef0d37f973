from collections.abc import Generator, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import flysid
from flysid.datasetfile import open_dataset
from flysid.errors import DataError, RecipeError, UsageError
from flysid.flight import Source, field_metadata
from flysid.ingest.formats.base import StreamPart, Summary
from flysid.store import create_data_folder, write_flight

T = np.arange(1000, dtype=np.int64) * 250_000_000


def stream(name: str, unit: str, **columns: np.ndarray) -> StreamPart:
    fields = [pa.field("time_ns", pa.int64()), pa.field("boot", pa.int32())]
    fields += [pa.field(c, pa.float64(), metadata=field_metadata(unit=unit)) for c in columns]
    arrays = [pa.array(T), pa.array(np.zeros(len(T), np.int32)), *(pa.array(v) for v in columns.values())]
    return StreamPart(name, pa.table(arrays, schema=pa.schema(fields)))


def parts(seed: int, roll_moves: bool) -> Generator[StreamPart, None, Summary]:
    yield from attitudes(seed, roll_moves)
    return Summary()


def attitudes(seed: int, roll_moves: bool = True) -> Iterator[StreamPart]:
    """Setpoints of 1 deg (standard deviation) and an attitude within a few deg of them."""
    rng = np.random.default_rng(seed)
    nav_roll = rng.normal(size=1000) if roll_moves else np.zeros(1000)
    nav_pitch = rng.normal(size=1000)
    roll = np.radians(nav_roll + rng.normal(size=1000))
    pitch = np.radians(nav_pitch + rng.normal(size=1000))
    yield stream("1.1/NAV_CONTROLLER_OUTPUT", "deg", nav_roll=nav_roll, nav_pitch=nav_pitch)
    yield stream("1.1/ATTITUDE", "rad", roll=roll, pitch=pitch)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    data = create_data_folder(tmp_path / "data")
    for i in range(3):
        write_flight(data, Source(f"flight{i}.tlog", "tlog", 1, f"{i}" * 64), parts(i, roll_moves=False))
    return data


def test_a_folder_opens_lists_and_gives_flights(folder: Path) -> None:
    lake = flysid.open(folder)
    assert len(lake) == 3
    assert [m.id for m in lake] == [m.id for m in lake.flights]
    assert lake.flight("flight1")["ATTITUDE"].num_rows == 1000


def test_recipes_and_channels_are_those_the_flights_serve(folder: Path) -> None:
    lake = flysid.open(folder)
    assert lake.recipes() == {"ardupilot-attitude": ("roll", "pitch")}
    assert lake.channels("ardupilot-velocity") == ()


def test_datasets_leave_out_channels_without_excitation(folder: Path) -> None:
    lake = flysid.open(folder)
    assert list(lake.datasets("ardupilot-attitude")) == ["pitch"]
    with pytest.raises(DataError, match="roll_in"):
        lake.dataset("ardupilot-attitude", "roll")
    with pytest.raises(RecipeError, match="LOCAL_POSITION_NED"):
        lake.datasets("ardupilot-velocity")


def test_a_channel_by_name_and_its_split(folder: Path) -> None:
    data = flysid.open(folder).channel("pitch")
    assert data.dt_s == pytest.approx(0.25)
    assert len(data) == 3000
    train, test = data.split(holdout=0.3, by="flight", seed=7)
    assert (len(train.flights), len(test.flights)) == (2, 1)
    assert data.flights == tuple(m.id for m in flysid.open(folder))


def test_what_is_not_there_is_said(folder: Path, tmp_path: Path) -> None:
    lake = flysid.open(folder)
    with pytest.raises(UsageError, match="no recipe gives channel 'yaw'") as caught:
        lake.channel("yaw")
    assert "pitch" in caught.value.hint
    with pytest.raises(UsageError, match="no such folder"):
        flysid.open(tmp_path / "absent")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="not an ingested folder"):
        flysid.open(tmp_path / "empty")
    with pytest.raises(RecipeError, match="no flights"):
        flysid.open(create_data_folder(tmp_path / "new")).dataset("ardupilot-attitude", "roll")


def test_a_dataset_goes_to_disk_flight_by_flight(folder: Path, tmp_path: Path) -> None:
    lake = flysid.open(folder)
    report = lake.write("ardupilot-attitude", "pitch", tmp_path / "pitch.parquet")
    opened = open_dataset(tmp_path / "pitch.parquet")
    assert opened.read().content_hash() == lake.dataset("ardupilot-attitude", "pitch").content_hash()
    assert report.used_s == pytest.approx(sum(len(s) - 1 for s in opened) * opened.dt_s)
