"""Fields over time: what patterns name, gaps, boots, modes and changes of parameters."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from flysid.errors import UsageError
from flysid.flight import Flight, Source, field_metadata
from flysid.ingest.align.allowed import Allowed
from flysid.ingest.align.recipe import parse_recipe
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.events import events, settings
from flysid.ingest.lake.stretches import Stretches
from flysid.ingest.lake.timeline import find_fields, lay_out, read_channels, read_fields

SECOND = 1_000_000_000


def table(time_s: np.ndarray, boot: np.ndarray | None = None, **columns: pa.Array) -> pa.Table:
    fields = [pa.field("time_ns", pa.int64()), pa.field("boot", pa.int32())]
    arrays = [
        pa.array((np.asarray(time_s) * SECOND).astype(np.int64)),
        pa.array(np.zeros(len(time_s), np.int32) if boot is None else boot.astype(np.int32)),
    ]
    for name, array in columns.items():
        fields.append(
            pa.field(name, array.type, metadata=field_metadata(unit="deg") if name == "Roll" else None)
        )
        arrays.append(array)
    schema = pa.schema(fields, metadata={"time_source": "TimeUS"})
    return pa.table(arrays, schema=schema)


def flight(**streams: pa.Table) -> FlightLog:
    source = Source("0001.BIN", "dataflash", 1, "0" * 64)
    return FlightLog(Flight(source, streams, info={"autopilot": "ardupilot", "vehicle": "copter"}))


T = 100.0 + np.arange(200) / 10
ATT = table(T, TimeUS=pa.array(T), Roll=pa.array(np.sin(T)), DesRoll=pa.array(np.cos(T)))


def test_patterns_name_streams_fields_and_elements() -> None:
    q = pa.FixedSizeListArray.from_arrays(pa.array(np.arange(800.0)), 4)
    log = flight(ATT=ATT, att=table(T, q=q, name=pa.array(["a"] * 200)))
    assert find_fields(log, ["ATT.*Roll"]) == [("ATT", "Roll"), ("ATT", "DesRoll")]
    assert find_fields(log, ["ATT"]) == [("ATT", "Roll"), ("ATT", "DesRoll")], "not the stream's own clock"
    assert find_fields(log, ["DesRoll"]) == [("ATT", "DesRoll")], "a field of any stream"
    assert find_fields(log, ["att.q"]) == [("att", f"q[{i}]") for i in range(4)]
    assert find_fields(log, ["att.q[2]", "att.q[2]"]) == [("att", "q[2]")]
    [[curve]] = read_fields(log, ["att.q[2]"])
    np.testing.assert_array_equal(curve.boots[0].x, np.arange(2.0, 800.0, 4.0))


def test_columns_whose_own_names_have_brackets_are_named_like_elements() -> None:
    columns = {f"gyroADC[{axis}]": pa.array(T + axis) for axis in range(3)}
    log = flight(main=table(T, **columns))
    assert find_fields(log, ["main.gyroADC[1]"]) == [("main", "gyroADC[1]")]
    assert find_fields(log, ["main.gyro*[2]"]) == [("main", "gyroADC[2]")]
    assert find_fields(log, ["main.gyroADC"]) == [("main", name) for name in columns]
    [[curve]] = read_fields(log, ["main.gyroADC[1]"])
    np.testing.assert_array_equal(curve.boots[0].x, T + 1)


@pytest.mark.parametrize(
    ("pattern", "near"), [("ATT.Rol", "ATT.Roll"), ("ATX.Roll", "ATT.Roll"), ("ATT.Mode", "ATT")]
)
def test_a_pattern_that_names_nothing_says_what_is_near(pattern: str, near: str) -> None:
    with pytest.raises(UsageError, match=f"no numeric field '{pattern}'") as caught:
        find_fields(flight(ATT=ATT), [pattern])
    assert near in str(caught.value.hint)


def test_an_argument_is_a_panel_and_units_do_not_share_one() -> None:
    panels = read_fields(flight(ATT=ATT), ["ATT.Roll,ATT.DesRoll", "ATT.Roll"])
    assert [[c.name for c in panel] for panel in panels] == [["ATT.Roll"], ["ATT.DesRoll"], ["ATT.Roll"]]
    assert panels[0][0].unit == "deg"


def test_no_line_crosses_a_pause_and_nothing_else_is_left_out() -> None:
    kept = np.r_[0:80, 120:200]
    log = flight(ATT=table(T[kept], Roll=pa.array(np.sin(T[kept]))))
    [[trace]] = lay_out(log, read_fields(log, ["ATT.Roll"])).panels
    holes = np.flatnonzero(np.isnan(trace.values))
    assert holes.tolist() == [80, 161], "one inside the pause, one at the end"
    np.testing.assert_array_equal(trace.values[~np.isnan(trace.values)], np.sin(T[kept]))
    assert 8.0 < trace.time_s[80] < 12.0


def test_boots_follow_one_another() -> None:
    boot = np.r_[np.zeros(100), np.ones(100)]
    time_s = np.r_[np.arange(100) / 10 + 500.0, np.arange(100) / 10 + 3.0]
    log = flight(ATT=table(time_s, boot, Roll=pa.array(np.arange(200.0))))
    [[trace]] = lay_out(log, read_fields(log, ["ATT.Roll"])).panels
    assert trace.time_s[0] == pytest.approx(0.0)
    assert trace.time_s[-1] == pytest.approx(9.9 + 9.9)
    assert (np.diff(trace.time_s) >= 0.0).all()


def test_modes_messages_and_changed_parameters_stand_beside_the_fields() -> None:
    log = flight(
        ATT=ATT,
        MODE=table(np.array([99.0, 105.0]), ModeNum=pa.array([0, 5])),
        MSG=table(np.array([101.0]), Message=pa.array(["Takeoff"])),
        PARM=table(
            np.array([90.0, 90.0, 110.0, 111.0]),
            Name=pa.array(["P", "I", "P", "I"]),
            Value=pa.array([0.1, 0.2, 0.15, 0.2]),
        ),
    )
    line = lay_out(log, read_fields(log, ["ATT.Roll"]))
    assert [name for _, _, name in line.modes] == ["STABILIZE", "LOITER"]
    assert [band[:2] for band in line.modes] == [pytest.approx((0.0, 5.0)), pytest.approx((5.0, 19.9))]
    told = [(round(m.time_s, 3), m.kind, m.text) for m in line.moments]
    assert told == [(1.0, "message", "Takeoff"), (10.0, "parameter", "P = 0.15 (was 0.1)")]
    assert [e.kind for e in events(log)] == ["mode", "message", "mode", "parameter"]


def test_defaults_that_a_ulog_lists_are_no_changes() -> None:
    origins = ["initial", "system default", "setup default", "changed"]
    rows = table(
        np.array([90.0, 90.0, 90.0, 110.0]),
        name=pa.array(["P"] * 4),
        value=pa.array([0.3, 0.1, 0.2, 0.4]),
        origin=pa.array(origins),
    )
    log = flight(ATT=ATT, parameters=rows)
    assert [setting.value for setting in settings(log)] == [0.3, 0.4]
    assert [e.text for e in events(log)] == ["P = 0.4 (was 0.3)"]


def test_channels_put_what_was_asked_for_beside_what_came() -> None:
    recipe = parse_recipe(
        {
            "name": "mine",
            "signals": {
                "roll_in": {"unit": "deg", "sources": [{"stream": "ATT", "field": "DesRoll", "unit": "rad"}]},
                "roll": {"unit": "deg", "sources": [{"stream": "ATT", "field": "Roll"}]},
                "lost": {"unit": "deg", "sources": [{"stream": "GPS", "field": "Spd", "unit": "deg"}]},
            },
            "channels": {
                "roll": {"inputs": ["roll_in"], "outputs": ["roll"]},
                "other": {"inputs": ["roll_in"], "outputs": ["lost"]},
                "drawn already": {"inputs": ["roll"], "outputs": ["roll_in"]},
            },
        }
    )
    [panel] = read_channels(flight(ATT=ATT), recipe)
    assert [c.name for c in panel] == ["roll_in", "roll"]
    np.testing.assert_allclose(panel[0].boots[0].x, np.degrees(np.cos(T)))


def test_a_stretch_keeps_the_times_of_the_whole_flight() -> None:
    log = flight(ATT=ATT)
    panels = read_fields(log, ["ATT.Roll"])
    [[whole]] = lay_out(log, panels).panels
    half = (T[0] + T[-1]) / 2.0
    [[part]] = lay_out(log, panels, Allowed({0: [(round(half * SECOND), round(1e6 * SECOND))]})).panels
    assert 0.4 < len(part.time_s) / len(whole.time_s) < 0.6
    assert part.time_s[0] == pytest.approx(half - T[0], abs=0.1)
    assert part.time_s[-1] == whole.time_s[-1]
    with pytest.raises(UsageError, match="no sample lies in the time asked for"):
        lay_out(log, panels, Allowed({0: [(0, 0)]}))


def test_a_mode_that_was_not_flown_is_said() -> None:
    log = flight(ATT=ATT)
    with pytest.raises(UsageError, match="mode LOITER never holds"):
        lay_out(log, read_fields(log, ["ATT.Roll"]), Stretches(modes=("LOITER",)).allowed(log))
