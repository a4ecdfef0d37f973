from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flysid.dataset import BEGAN
from flysid.errors import DataError, RecipeError
from flysid.flight import ClockMap, Flight, Source, field_metadata
from flysid.ingest.align.align import align, dataset, segments_of
from flysid.ingest.align.recipe import Recipe, load_recipe, parse_recipe
from flysid.ingest.align.resample import period_ns
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.align.things import autopilot_system, find_stream

MS = 1_000_000


def table(t_ns: Any, units: Mapping[str, str] | None = None, boot: Any = 0, **columns: Any) -> pa.Table:
    units = units or {}
    t = np.asarray(t_ns, dtype=np.int64)
    fields = [pa.field("time_ns", pa.int64()), pa.field("boot", pa.int32())]
    arrays = [pa.array(t), pa.array(np.broadcast_to(boot, t.shape).astype(np.int32))]
    for name, values in columns.items():
        matrix = np.asarray(values)
        array = (
            pa.FixedSizeListArray.from_arrays(pa.array(matrix.ravel()), matrix.shape[1])
            if matrix.ndim == 2
            else pa.array(matrix)
        )
        arrays.append(array)
        fields.append(pa.field(name, array.type, metadata=field_metadata(unit=units.get(name, ""))))
    return pa.table(arrays, schema=pa.schema(fields))


def flight_of(name: str = "f.tlog", **tables: pa.Table) -> Flight:
    return Flight(
        Source(name, "tlog", 1, "0" * 64),
        {k.replace("__", "/").replace("_dot_", "."): v for k, v in tables.items()},
    )


def recipe(u: Mapping[str, Any] | None = None, y: Mapping[str, Any] | None = None, **top: Any) -> Recipe:
    source_u = {"stream": "CMD", "field": "u", "unit": "deg"}
    source_y = {"stream": "STATE", "field": "y", "unit": "m/s"}
    return parse_recipe(
        {
            "name": "r",
            "signals": {
                "u": {"unit": "deg", "hold": "zero", "sources": [source_u], **(u or {})},
                "y": {"unit": "m/s", "sources": [source_y], **(y or {})},
            },
            "channels": {"c": {"inputs": ["u"], "outputs": ["y"]}},
            **top,
        }
    )


T50 = np.arange(500, dtype=np.int64) * 20 * MS + 7 * MS
RNG = np.random.default_rng(0)
U50 = RNG.normal(size=500)
Y50 = RNG.normal(size=500)


def test_equal_rates_come_through_bit_for_bit() -> None:
    data = dataset([flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50))], recipe(), "c")
    assert data.dt_s == pytest.approx(0.02)
    assert [len(s) for s in data.segments] == [500]
    np.testing.assert_array_equal(data.segments[0].u[:, 0], U50)
    np.testing.assert_array_equal(data.segments[0].y[:, 0], Y50)
    assert data.segments[0].t0_ns == T50[0]
    assert (data.inputs[0].name, data.inputs[0].unit) == ("u", "deg")


def test_segments_carry_the_date_of_their_flight_where_the_log_knows_it() -> None:
    dated = replace(
        flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50)),
        clocks=(ClockMap(0, int(T50[0]), int(T50[-1]), utc_offset_ns=1_700_000_000_000_000_000),),
    )
    (segment,) = dataset([dated], recipe(), "c").segments
    assert segment.marks[BEGAN] == pytest.approx(1.7e9 + T50[0] * 1e-9)
    (segment,) = dataset([replace(dated, clocks=())], recipe(), "c").segments
    assert BEGAN not in segment.marks


def enumerated(t_ns: Any, names: Mapping[int, str], **columns: Any) -> pa.Table:
    """A table whose first column is an enumeration."""
    made = table(t_ns, **columns)
    field = made.schema.field(2).with_metadata(field_metadata(enum=names))
    return made.set_column(2, field, made.column(2))


@pytest.mark.parametrize("wanted", ["MAIN", 1, 1.0])
def test_where_keeps_rows_by_number_or_name(wanted: object) -> None:
    core = np.tile([0, 1], 500)
    t_ns = np.repeat(T50, 2)
    state = enumerated(t_ns, {0: "SPARE", 1: "MAIN"}, core=core, y=np.where(core, np.repeat(Y50, 2), 99.0))
    source = {"stream": "STATE", "field": "y", "unit": "m/s", "where": {"core": wanted}}
    data = dataset([flight_of(CMD=table(T50, u=U50), STATE=state)], recipe(y={"sources": [source]}), "c")
    np.testing.assert_array_equal(data.segments[0].y[:, 0], Y50)


@pytest.mark.parametrize("wanted", ["NOWHERE", 7])
def test_where_that_matches_no_row_says_what_there_is(wanted: object) -> None:
    state = enumerated(T50, {0: "SPARE", 1: "MAIN"}, core=np.arange(500) % 2, y=Y50)
    other = enumerated(T50, {7: "NOWHERE"}, core=np.full(500, 7), y=Y50)
    source = {"stream": "STATE", "field": "y", "unit": "m/s", "where": {"core": wanted}}
    wanting = flight_of("a", CMD=table(T50, u=U50), STATE=state)
    with pytest.raises(DataError, match=f"no row of STATE has core = {wanted}: core is SPARE, MAIN"):
        dataset([wanting], recipe(y={"sources": [source]}), "c")
    having = flight_of("b", CMD=table(T50, u=U50), STATE=other)
    aligned = align([wanting, having], recipe(y={"sources": [source]}), "c")
    assert [len(s) for s in aligned.dataset.segments] == [500]
    assert aligned.report.flights[0].reason.startswith("no row of STATE has core")


def test_a_condition_that_holds_for_less_than_its_margins_says_so() -> None:
    landed = table(T50, landed=np.arange(500) % 50 != 0)
    logs = [flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50), L=landed)]
    source = {"stream": "L", "field": "landed"}
    condition = {"name": "airborne", "sources": [source], "any_of": [0], "margin_s": 2.0}
    with pytest.raises(DataError, match="'airborne' never holds for longer than its margins, 2 x 2 s"):
        dataset(logs, recipe(conditions=[condition]), "c")
    still = [flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50), L=table(T50, landed=T50 > 0))]
    with pytest.raises(DataError, match=r"'airborne' never holds \(0\): L.landed is 1 in this log"):
        dataset(still, recipe(conditions=[condition]), "c")


def test_where_and_conditions_take_elements_of_lists() -> None:
    state = table(T50, y=Y50, flags=np.column_stack([np.arange(500) < 250, np.ones(500)]).astype(np.int8))
    source = {"stream": "STATE", "field": "y", "unit": "m/s", "where": {"flags[0]": 1}}
    logs = [flight_of(CMD=table(T50, u=U50), STATE=state)]
    data = dataset(logs, recipe(y={"sources": [source]}), "c")
    assert [len(s) for s in data.segments] == [250]
    condition = {"name": "on", "sources": [{"stream": "STATE", "field": "flags[0]"}], "any_of": [1]}
    assert [len(s) for s in dataset(logs, recipe(conditions=[condition]), "c").segments] == [250]
    whole = {**source, "where": {"flags": 1}}
    with pytest.raises(RecipeError, match="cannot use the list 'flags'"):
        dataset(logs, recipe(y={"sources": [whole]}), "c")


def test_a_gap_cuts_and_short_pieces_are_dropped_and_counted() -> None:
    keep = np.ones(500, dtype=bool)
    keep[200:230] = False
    keep[240:260] = False
    aligned = align([flight_of(CMD=table(T50, u=U50), STATE=table(T50[keep], y=Y50[keep]))], recipe(), "c")
    assert [len(s) for s in aligned.dataset.segments] == [200, 240]
    np.testing.assert_array_equal(aligned.dataset.segments[1].y[:, 0], Y50[260:])
    (flight,) = aligned.report.flights
    assert (flight.segments, flight.short_segments, flight.gaps) == (2, 1, 2)
    lines = aligned.report.lines()
    assert "2 segments" in lines[0]
    assert "from 1 of 1 flight;" in lines[0]
    assert any("2 gaps, 1 short segment dropped" in line for line in lines)


def test_one_lost_sample_is_bridged() -> None:
    keep = np.arange(500) != 100
    data = dataset([flight_of(CMD=table(T50, u=U50), STATE=table(T50[keep], y=Y50[keep]))], recipe(), "c")
    assert len(data.segments) == 1
    assert data.segments[0].y[100, 0] == pytest.approx((Y50[99] + Y50[101]) / 2)


def test_nothing_crosses_a_boot() -> None:
    boot = (np.arange(500) >= 250).astype(int)
    t = np.concatenate([T50[:250], T50[:250]])
    data = dataset(
        [flight_of(CMD=table(t, boot=boot, u=U50), STATE=table(t, boot=boot, y=Y50))], recipe(), "c"
    )
    assert [s.flight for s in data.segments] == ["f.tlog#0", "f.tlog#1"]
    np.testing.assert_array_equal(data.segments[1].y[:, 0], Y50[250:])


def test_units_signs_and_offsets_apply() -> None:
    y = {"sources": [{"stream": "STATE", "field": "y", "scale": -2.0, "offset": 1.0}]}
    data = dataset(
        [
            flight_of(
                CMD=table(T50, {"u": "cdeg"}, u=100 * U50), STATE=table(T50, {"y": "mm/s"}, y=1000 * Y50)
            )
        ],
        recipe(y=y),
        "c",
    )
    np.testing.assert_allclose(data.segments[0].u[:, 0], U50)
    np.testing.assert_allclose(data.segments[0].y[:, 0], 1.0 - 2.0 * Y50)


def test_a_missing_unit_is_refused_and_a_disagreeing_one_is_noted() -> None:
    y = {"sources": [{"stream": "STATE", "field": "y"}]}
    log = flight_of(CMD=table(T50, {"u": "cdeg"}, u=U50), STATE=table(T50, y=Y50))
    with pytest.raises(RecipeError, match=r"STATE\.y has no unit") as caught:
        dataset([log], recipe(y=y), "c")
    assert "unit =" in caught.value.hint
    notes = [n for s in align([log], recipe(), "c").report.flights[0].signals for n in s.notes]
    assert any("the log's unit is used" in n for n in notes)


def test_the_grid_takes_the_slower_rate_and_faster_states_are_filtered() -> None:
    t200 = np.arange(4000, dtype=np.int64) * 5 * MS
    s = t200 * 1e-9
    slow = np.sin(2 * np.pi * 0.5 * s)
    fast = np.sin(2 * np.pi * 19.7 * s)
    t20 = t200[::10]
    u = np.sign(np.sin(2 * np.pi * 0.1 * t20 * 1e-9))
    aligned = align([flight_of(CMD=table(t20, u=u), STATE=table(t200, y=slow + fast))], recipe(), "c")
    assert aligned.dataset.dt_s == pytest.approx(0.05)
    assert aligned.report.flights[0].filtered == 10
    (segment,) = aligned.dataset.segments
    np.testing.assert_allclose(segment.y[:, 0], np.sin(2 * np.pi * 0.5 * segment.time_s(0.05)), atol=6e-3)


def test_filtering_leaves_the_relation_between_input_and_output_alone() -> None:
    t = np.arange(8000, dtype=np.int64) * 5 * MS
    u = np.repeat(RNG.normal(size=160), 50)  # held for five grid samples each
    y = np.zeros(8000)
    for k in range(1, 8000):
        y[k] = 0.98 * y[k - 1] + 0.02 * u[k - 1]
    data = dataset([flight_of(CMD=table(t[::10], u=u[::10]), STATE=table(t, y=y))], recipe(), "c")
    (s,) = data.segments
    phi = np.stack([s.y[1:-1, 0], s.u[1:-1, 0], s.u[:-2, 0], s.u[2:, 0]], axis=1)
    theta, *_ = np.linalg.lstsq(phi, s.y[2:, 0], rcond=None)
    assert theta[0] == pytest.approx(0.98**10, abs=4e-3)
    assert theta[1] + theta[2] + theta[3] == pytest.approx(1 - 0.98**10, abs=5e-3)


def test_commands_sent_only_on_change_are_held_for_ever_when_the_recipe_says_so() -> None:
    cmd = table(np.array([0, 3, 7]) * 1_000_000_000, u=np.array([0.0, 1.0, -1.0]))
    log = flight_of(CMD=cmd, STATE=table(T50, y=Y50))
    data = dataset([log], recipe(u={"max_gap_s": float("inf")}), "c")
    assert len(data.segments) == 1
    at = data.segments[0].time_s(0.02)
    wanted = np.where(at < 3 - 1e-9, 0.0, np.where(at < 7 - 1e-9, 1.0, -1.0))
    wanted[[149, 349]] = 7 / 20, (13 - 7) / 20  # changes 13 ms behind a point, whose steps they share
    np.testing.assert_allclose(data.segments[0].u[:, 0], wanted, atol=1e-12)


def test_quaternions_and_the_heading_frame() -> None:
    yaw = np.unwrap(np.linspace(3.0, 4.0, 500))
    pitch = 0.1 * np.sin(np.arange(500) / 20)
    turns = Rotation.from_euler("ZY", np.column_stack([yaw, pitch]))
    q = np.roll(turns.as_quat(), 1, axis=1)  # the scalar first
    forward = 2.0 * np.cos(np.arange(500) / 30)
    vn = forward * np.cos(yaw)
    ve = forward * np.sin(yaw)
    wrapped = (yaw + np.pi) % (2 * np.pi) - np.pi
    log = flight_of(
        **{
            "1_dot_1__ATTITUDE_TARGET": table(T50, q=q.astype(np.float32)),
            "1_dot_1__LOCAL_POSITION_NED": table(T50, {"vx": "m/s", "vy": "m/s"}, vx=vn, vy=ve),
            "1_dot_1__ATTITUDE": table(T50[::5], {"yaw": "rad"}, yaw=wrapped[::5]),
        }
    )
    data = dataset([log], "ardrone-synthetic", "longitudinal")
    (segment,) = data.segments
    first = int(np.searchsorted(T50, segment.t0_ns))
    rows = slice(first, first + len(segment))
    assert len(segment) > 490
    np.testing.assert_allclose(segment.u[:, 0], -np.degrees(pitch[rows]), atol=1e-5)
    np.testing.assert_allclose(segment.y[:, 0], forward[rows], atol=1e-4)


def test_the_autopilots_stream_is_preferred() -> None:
    rows = {
        "1.1/ATTITUDE": 10,
        "1.190/ATTITUDE": 99,
        "255.190/HEARTBEAT": 5,
        "1.1/HEARTBEAT": 5,
        "2.1/ATTITUDE": 3,
    }
    assert autopilot_system(rows) == "1"
    assert find_stream("ATTITUDE", rows) == "1.1/ATTITUDE"
    assert find_stream("2.1/ATTITUDE", rows) == "2.1/ATTITUDE"
    assert find_stream("ATT", rows) is None


def test_rows_are_chosen_by_instance_and_list_elements_by_index() -> None:
    t = np.repeat(T50, 2)
    core = np.tile([0, 1], 500)
    y = np.where(core == 1, np.repeat(Y50, 2), 99.0)
    source = {"stream": "STATE", "field": "v[1]", "unit": "m/s", "where": {"C": 1}}
    log = flight_of(CMD=table(T50, u=U50), STATE=table(t, v=np.stack([0 * y, y], axis=1), C=core))
    data = dataset([log], recipe(y={"sources": [source]}), "c")
    np.testing.assert_array_equal(data.segments[0].y[:, 0], Y50)


def test_alternatives_are_tried_in_order() -> None:
    y = {
        "sources": [
            {"stream": "ABSENT", "field": "y"},
            {"stream": "STATE", "field": "absent"},
            {"stream": "STATE", "field": "y", "unit": "m/s"},
        ]
    }
    log = flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50))
    assert len(dataset([log], recipe(y=y), "c")) == 500


def test_a_flight_without_the_streams_is_left_out_and_named() -> None:
    good = flight_of("good.tlog", CMD=table(T50, u=U50), STATE=table(T50, y=Y50))
    bad = flight_of("bad.tlog", CMD=table(T50, u=U50), OTHER=table(T50, y=Y50))
    aligned = align([good, bad], recipe(), "c")
    assert aligned.dataset.flights == ("good.tlog",)
    assert any("bad.tlog: left out, no source for y" in line for line in aligned.report.lines())


def test_no_stream_at_all_names_the_nearest() -> None:
    log = flight_of(CMD=table(T50, u=U50), STATES=table(T50, y=Y50))
    with pytest.raises(RecipeError, match=r"needs STATE\.y; not in f\.tlog") as caught:
        dataset([log], recipe(), "c")
    assert "STATES" in caught.value.hint
    with pytest.raises(RecipeError, match="no flights"):
        dataset([], recipe(), "c")


def test_an_input_that_never_moves_is_refused() -> None:
    log = flight_of(CMD=table(T50, u=np.full(500, 3.0)), STATE=table(T50, y=Y50))
    with pytest.raises(DataError, match="'u' stays at 3 deg") as caught:
        dataset([log], recipe(), "c")
    assert "doublets" in caught.value.hint
    with pytest.raises(DataError, match="output 'y'"):
        dataset([flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=np.zeros(500)))], recipe(), "c")


def test_segments_that_are_all_too_short_are_refused() -> None:
    log = flight_of(CMD=table(T50[:15], u=U50[:15]), STATE=table(T50[:15], y=Y50[:15]))
    with pytest.raises(DataError, match="no segment of 20 samples"):
        dataset([log], recipe(), "c")


def test_values_that_are_not_finite_cut_like_gaps() -> None:
    y = Y50.copy()
    y[200:210] = np.nan
    aligned = align([flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=y))], recipe(), "c")
    assert [len(s) for s in aligned.dataset.segments] == [200, 290]
    assert aligned.report.flights[0].signals[1].non_finite == 10


def test_the_step_of_a_quantised_signal_is_found() -> None:
    y = np.round(300 * Y50)
    log = flight_of(CMD=table(T50, u=U50), STATE=table(T50, {"y": "cm/s"}, y=y.astype(np.int16)))
    data = dataset([log], recipe(), "c")
    assert data.outputs[0].resolution == pytest.approx(0.01)
    assert data.inputs[0].resolution == 0.0


def test_conditions_cut() -> None:
    mode = np.where((np.arange(500) >= 100) & (np.arange(500) < 400), 4, 0)
    conditions = [{"name": "guided", "sources": [{"stream": "MODE", "field": "m"}], "any_of": [4]}]
    log = flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50), MODE=table(T50, m=mode))
    data = dataset([log], recipe(conditions=conditions), "c")
    assert [len(s) for s in data.segments] == [300]
    np.testing.assert_array_equal(data.segments[0].y[:, 0], Y50[100:400])
    never = [{**conditions[0], "any_of": [9]}]
    with pytest.raises(DataError, match="'guided' never holds"):
        dataset([log], recipe(conditions=never), "c")
    high = [
        {
            "name": "fast",
            "sources": [{"stream": "STATE", "field": "y", "unit": "m/s"}],
            "unit": "m/s",
            "above": 9.0,
        }
    ]
    with pytest.raises(DataError, match=r"'fast' never holds: STATE.y is -2.93 to 2.49 m/s"):
        dataset([log], recipe(conditions=high), "c")


def test_shipped_recipe_objects_are_accepted_as_well_as_names() -> None:
    log = flight_of(
        NAV_CONTROLLER_OUTPUT=table(T50, {"nav_roll": "deg"}, nav_roll=U50.astype(np.float32)),
        ATTITUDE=table(T50, {"roll": "rad"}, roll=np.radians(Y50)),
    )
    by_name = dataset([log], "ardupilot-attitude", "roll")
    assert by_name.content_hash() == dataset([log], load_recipe("ardupilot-attitude"), "roll").content_hash()
    np.testing.assert_allclose(by_name.segments[0].y[:, 0], Y50)


def test_an_input_that_moves_less_than_noise_is_cautioned() -> None:
    log = flight_of(CMD=table(T50, u=1e-6 * U50), STATE=table(T50, y=Y50))
    report = align([log], recipe(), "c").report
    assert "no model can be identified" in report.doubts[0].text
    assert any("caution" in line for line in report.lines())
    louder = align([flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50))], recipe(), "c").report
    assert "quiet" not in [d.kind for d in louder.doubts]


def test_labels_cut_and_mark() -> None:
    mode = np.where(np.arange(500) < 200, 0, 4)
    labels = [{"name": "mode", "sources": [{"stream": "MODE", "field": "m"}]}]
    log = flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50), MODE=table(T50[::10], m=mode[::10]))
    data = dataset([log], recipe(labels=labels), "c")
    assert [(len(s), s.marks["mode"]) for s in data.segments] == [(200, "0"), (300, "4")]
    whole = dataset([log], recipe(labels=[{**labels[0], "cut": False}]), "c")
    assert [(len(s), s.marks["mode"]) for s in whole.segments] == [(500, "4")]


def test_segments_are_cut_by_time_and_marked_where_an_input_stands_at_its_limit() -> None:
    u = np.clip(U50, -1.0, 1.0)
    log = flight_of(CMD=table(T50, u=u), STATE=table(T50, y=Y50))
    data = dataset([log], recipe(u={"limits": [-1.0, 1.0]}, max_segment_s=4.0), "c")
    assert [len(s) for s in data.segments] == [167, 166, 167]
    np.testing.assert_array_equal(np.concatenate([s.y[:, 0] for s in data.segments]), Y50)
    for segment in data.segments:
        assert segment.marks["saturated"] == pytest.approx(float((np.abs(segment.u) >= 1.0).mean()))
        assert segment.marks["duration_s"] == pytest.approx(len(segment) * 0.02)


def test_a_rate_that_misses_the_dynamics_is_cautioned() -> None:
    channels = {"c": {"inputs": ["u"], "outputs": ["y"], "min_rate_hz": 200.0, "remedy": "log faster"}}
    log = flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50))
    found = align([log], recipe(channels=channels), "c").report.doubts
    (slow,) = [d for d in found if d.kind == "slow"]
    assert "25 Hz only" in slow.text
    assert slow.todo == "log faster"


def test_segments_are_grouped_by_flight_vehicle_and_mode() -> None:
    mode = np.where(np.arange(500) < 200, 0, 4)
    labels = [{"name": "mode", "sources": [{"stream": "MODE", "field": "m"}]}]
    tables = {"CMD": table(T50, u=U50), "STATE": table(T50, y=Y50), "MODE": table(T50, m=mode)}
    logs = [
        Flight(Source(f"{i}", "tlog", 1, "0" * 64), tables, info={"autopilot": "px4", "vehicle": f"v{i}"})
        for i in range(2)
    ]
    data = dataset(logs, recipe(labels=labels), "c")
    assert {k: len(d.segments) for k, d in data.group_by("vehicle").items()} == {"px4 v0": 2, "px4 v1": 2}
    assert {k: len(d) for k, d in data.group_by("mode").items()} == {"0": 400, "4": 600}
    assert list(data.group_by("flight")) == ["0", "1"]
    assert list(data.group_by("absent")) == [""]


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 480), st.integers(1, 60)), max_size=6),
    st.integers(0, 2**31),
    st.sampled_from(["order", "shuffle", "repeat"]),
)
@example(gaps=[(374, 23)], seed=374, disorder="order")
def test_no_sample_is_made_up_inside_a_gap_whatever_the_stamps(
    gaps: list[tuple[int, int]], seed: int, disorder: str
) -> None:
    rng = np.random.default_rng(seed)
    keep = np.ones(500, dtype=bool)
    for start, length in gaps:
        keep[start : start + length] = False
    t = T50[keep] + rng.integers(-2 * MS, 2 * MS, size=int(keep.sum()))
    y = Y50[keep]
    if disorder == "shuffle":
        order = rng.permutation(len(t))
        t = t[order]
        y = y[order]
    elif disorder == "repeat":
        t = np.repeat(t, 2)
        y = np.repeat(y, 2)
    try:
        data = dataset([flight_of(CMD=table(T50, u=U50), STATE=table(t, y=y))], recipe(rate_hz=50.0), "c")
    except DataError:
        return
    stamps = np.unique(t)
    for segment in data.segments:
        at = segment.t0_ns + np.arange(len(segment), dtype=np.int64) * 20 * MS
        after = np.clip(np.searchsorted(stamps, at), 1, len(stamps) - 1)
        assert (at >= stamps[0]).all()
        assert (at <= stamps[-1]).all()
        bridged = (stamps[after] - stamps[after - 1])[~np.isin(at, stamps)]
        assert (bridged <= 2.5 * period_ns(stamps)).all()
        assert np.abs(segment.y).max() <= np.abs(Y50).max()


EVENTS = [{"name": "armed", "sources": [{"stream": "EV", "field": "Id"}], "set_by": [10], "cleared_by": [11]}]


@pytest.mark.parametrize(
    ("ids", "at", "lengths"),
    [
        ([10, 11], [100, 400], [300]),
        ([11], [400], [400]),  # it was armed before the log began
        ([17, 18, 10], [50, 60, 300], [200]),
        ([10, 11, 10, 11], [50, 150, 250, 400], [100, 150]),
        ([17, 28], [50, 60], [500]),  # nothing is said of it: nothing is cut
    ],
)
def test_events_switch_a_condition_on_and_off(ids: list[int], at: list[int], lengths: list[int]) -> None:
    events = table(T50[at], Id=np.array(ids))
    log = flight_of(CMD=table(T50, u=U50), STATE=table(T50, y=Y50), EV=events)
    assert [len(s) for s in dataset([log], recipe(conditions=EVENTS), "c").segments] == lengths


def test_conditions_of_one_name_are_alternatives_and_those_of_several_must_all_hold() -> None:
    beat = {"name": "armed", "sources": [{"stream": "HEARTBEAT", "field": "base_mode"}], "has_bits": 128}
    flying = {"name": "airborne", "sources": [{"stream": "LAND", "field": "landed"}], "any_of": [0]}
    mode = np.where(np.arange(500) < 300, 209, 81)
    landed = (np.arange(500) < 100).astype(np.uint8)
    tables = {"CMD": table(T50, u=U50), "STATE": table(T50, y=Y50), "HEARTBEAT": table(T50, base_mode=mode)}
    both = recipe(conditions=[*EVENTS, beat, flying])
    aligned = align([flight_of(**tables)], both, "c")
    assert [len(s) for s in aligned.dataset.segments] == [300]
    assert "condition 'airborne' could not be checked: no LAND in the log" in aligned.report.flights[0].notes
    with_landing = flight_of(**tables, LAND=table(T50, landed=landed))
    assert [len(s) for s in dataset([with_landing], both, "c").segments] == [200]


def test_a_mode_never_entered_is_refused_naming_those_of_the_log() -> None:
    wanted = {"name": "loiter", "sources": [{"stream": "MODE", "field": "ModeNum"}], "any_of": ["LOITER"]}
    modes = table(T50[[0, 250]], ModeNum=np.array([0, 3], dtype=np.uint8))
    tables = {"CMD": table(T50, u=U50), "STATE": table(T50, y=Y50), "MODE": modes}
    log = Flight(
        Source("f.bin", "dataflash", 1, "0" * 64),
        tables,
        info={"autopilot": "ardupilot", "vehicle": "copter"},
    )
    with pytest.raises(DataError, match=r"'loiter' never holds \(LOITER\): MODE.ModeNum is STABILIZE, AUTO"):
        dataset([log], recipe(conditions=[wanted]), "c")
    data = dataset([log], recipe(conditions=[{**wanted, "any_of": ["AUTO"]}]), "c")
    assert [len(s) for s in data.segments] == [250]


def test_a_condition_says_one_thing() -> None:
    source = [{"stream": "MODE", "field": "m"}]
    for kinds in ({}, {"any_of": [1], "above": 2.0}):
        with pytest.raises(RecipeError, match="must say one thing"):
            recipe(conditions=[{"name": "c", "sources": source, **kinds}])


def test_signals_of_one_log_are_loaded_once_and_those_of_the_next_log_anew() -> None:
    """A channel asks for an input three times: for its pauses, its rate, and its samples."""
    read: Counter[str] = Counter()

    class Counting(FlightLog):
        def table(self, stream: str, columns: Sequence[str]) -> pa.Table:
            read[stream] += 1
            return super().table(stream, columns)

    found = []
    for turn, factor in enumerate((1.0, 2.0), start=1):
        log = Counting(flight_of(CMD=table(T50, u=factor * U50), STATE=table(T50, y=Y50)))
        found.append(align([log], recipe(), "c").dataset)
        assert read == {"CMD": turn, "STATE": turn}
        segments_of(log, recipe(), "c", 0.02)
        assert read == {"CMD": turn + 1, "STATE": turn + 1}
        read.subtract(["CMD", "STATE"])
    (one,), (other,) = (data.segments for data in found)
    assert np.array_equal(other.u, 2.0 * one.u)
    assert np.array_equal(other.y, one.y)
