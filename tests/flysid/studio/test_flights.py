"""Flights, fields and curves over HTTP; queries that make no sense; logs that are dropped."""

from __future__ import annotations

import json
import random
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.faulty_carriers import PLANE, carrier_bytes, travel
from bench.faulty_quadrotor import draw_quadrotor
from flysid.ingest.lake.lake import open as open_lake
from flysid.showing import fold
from tests.command import call
from tests.flysid.studio.server import SAMPLES, Server, studio


def decoded(body: bytes) -> tuple[dict[str, Any], list[tuple[np.ndarray, np.ndarray]]]:
    """The head of an answer, and (times, values) of every series."""
    length = struct.unpack_from("<I", body)[0]
    head = json.loads(body[4 : 4 + length])
    at = 4 + length
    assert at % 8 == 0
    curves = []
    for one in head["series"]:
        times = np.frombuffer(body, "<f4", one["points"], at) + head["start_s"]
        values = np.frombuffer(body, "<f4", one["points"], at + 4 * one["points"]).astype(float) + one["base"]
        curves.append((times, values))
        at += 8 * one["points"]
    assert at == len(body)
    return head, curves


@pytest.fixture(scope="module")
def flight(server: Server) -> Any:
    found = server.get("flights").json
    assert found["count"] == 2
    return server.get("flights/" + found["flights"][0]["id"]).json


def test_listed_flights_are_searched_by_their_facts(server: Server) -> None:
    assert server.get("flights", {"q": "mcap"}).json["count"] == 1
    assert server.get("flights", {"q": "mcap nowhere"}).json["count"] == 0
    assert len(server.get("flights", {"most": 1}).json["flights"]) == 1


def test_a_curve_is_what_the_table_holds(server: Server, flight: Any) -> None:
    entry = next(s for s in flight["streams"] if s["fields"] and s["rows"] > 100)
    name, unit = entry["fields"][0]
    asked = {"f": flight["id"], "s": f"{entry['stream']}:{name}", "w": 8000}
    head, [(times, values)] = decoded(server.get("series", asked).body)
    log = next(log for log in open_lake(server.data).logs if log.name == flight["id"])
    table = log.table(entry["stream"], ["time_ns", name])
    expected = table[name].to_numpy().astype(float)
    assert head["series"][0]["whole"]
    assert head["series"][0]["unit"] == unit
    kept = np.isfinite(values)
    assert kept.sum() == len(expected)
    reach = np.ptp(expected) or 1.0
    assert np.abs(values[kept] - expected).max() < 1e-6 * reach
    first_ns = min(c.first_ns for c in log.manifest.clocks)
    assert np.abs(times[kept] - (table["time_ns"].to_numpy() - first_ns) * 1e-9).max() < 1e-4


def test_the_signals_of_recipes_are_curves_too(server: Server, flight: Any) -> None:
    group = flight["signals"][0]
    signal = group["channels"][0][0]
    head, [(_, values)] = decoded(
        server.get("series", {"f": flight["id"], "s": f"{group['stream']}:{signal}"}).body
    )
    assert np.isfinite(values).any()
    assert head["series"][0]["unit"]


def test_modes_events_and_the_track_come_with_the_flight(server: Server, flight: Any) -> None:
    assert all(start < end for start, end, _ in flight["modes"])
    assert flight["clocks"][0][2] == 0.0
    points = server.get(f"flights/{flight['id']}/track").json["points"]
    assert all(-90 <= lat <= 90 for _, lat, _ in points)


@pytest.mark.parametrize(
    "query",
    [
        {"f": "nothing"},
        {"f": ".."},
        {"s": "nothing:x"},
        {"s": "@nothing:x"},
        {"s": "@px4-attitude:nothing"},
        {"s": ":"},
        {"w": "x"},
        {"w": 1},
        {"w": 10**9},
        {"t0": "nan"},
        {"t0": "inf"},
        {"t0": 5, "t1": 5},
        {"t0": 9, "t1": 1},
        {"other": "x"},
        {"w": ["100", "200"]},
        {"s": ["a:b"] * 17},
    ],
)
def test_queries_that_make_no_sense_are_told(server: Server, flight: Any, query: dict[str, Any]) -> None:
    answer = server.get("series", {"f": flight["id"]} | query)
    assert answer.status in (400, 404), answer.body
    assert answer.json["message"]


def test_random_queries_never_break_the_server(server: Server, flight: Any) -> None:
    rng = random.Random(3)
    paths = [
        "series",
        "align",
        "flights",
        "flights/x",
        "runs/x",
        "jobs/x",
        "recipes/x",
        "uploads/x",
        "runs/x/models/a/b",
    ]
    words = ["f", "s", "t0", "t1", "w", "q", "most", "r", "ch", "\u00e9", "", "f[]"]
    values = [
        flight["id"],
        "",
        "nan",
        "-1",
        "1e400",
        "\x00",
        "%",
        "9" * 400,
        "a:b",
        "\u202e",
        "../..",
        "null",
        "[]",
    ]
    for _ in range(200):
        query = [(rng.choice(words), rng.choice(values)) for _ in range(rng.randint(0, 5))]
        answer = server.get(rng.choice(paths), query)
        assert answer.status in (200, 400, 404), (query, answer.status, answer.body)


@pytest.mark.parametrize("name", ["9" * 400, "%00", "..", "%2e%2e", "a%2Fb", "%F0%9F%9A%81"])
@pytest.mark.parametrize(
    "path", ["flights/{}", "flights/{}/track", "uploads/{}", "runs/{}", "jobs/{}", "recipes/{}"]
)
def test_names_that_no_folder_has(server: Server, path: str, name: str) -> None:
    assert server.get(path.format(name)).status in (307, 404)


@pytest.mark.parametrize(
    "body", [b"", b"{", b"[]", b'{"recipe": 5}', b'{"nothing": 1}', b"\xff", b"[" * 100_000]
)
@pytest.mark.parametrize("path", ["fits", "validates", "compares"])
def test_bodies_that_make_no_sense_are_told(server: Server, path: str, body: bytes) -> None:
    answer = server.send("POST", path, body)
    assert answer.status == 400
    assert answer.json["message"]


def test_a_dropped_log_becomes_a_flight(tmp_path: Path) -> None:
    """Under a hostile name; damaged ones are refused in flysid's words, and nothing is left beside."""
    log = (SAMPLES / "01-steps-seed2.tlog").read_bytes()
    with studio(tmp_path / "data") as server:
        sent = server.send("POST", "uploads?name=..%2F..%2Fx%20%3Cb%3E.tlog", log)
        assert sent.status == 202
        assert "/" not in sent.json["name"]
        look = server.get(f"uploads/{sent.json['upload']}").json
        assert look["format"] == "tlog"
        assert any(rate > 1 for _, rate in look["streams"].values())
        ended = server.wait(sent.json["job"]["id"])
        assert (ended["state"], ended["code"]) == ("done", 0)
        [flight] = server.get("flights").json["flights"]
        assert ended["out"].strip() == flight["id"]

        garbage = server.send("POST", "uploads?name=noise.bin", random.Random(1).randbytes(20_000))
        assert server.wait(garbage.json["job"]["id"])["state"] in ("failed", "done")
        said = (server.data.with_name("data.studio") / "jobs" / garbage.json["job"]["id"] / "log").read_text()
        assert "noise.bin" in said
        for name in ("", ".", "..", "%2F"):
            assert server.send("POST", f"uploads?name={name}", b"x").status == 400
        assert server.send("POST", "uploads?name=empty.bin", b"").status == 400
        assert len(server.get("flights").json["flights"]) == 1
    beside = {p.name for p in tmp_path.iterdir()}
    assert beside == {"data", "data.studio"}


def test_a_flight_is_reviewed_and_its_figures_lead_to_curves(server: Server, flight: Any) -> None:
    review = server.get(f"flights/{flight['id']}/review").json
    assert review["log"] == flight["log"]
    assert review["findings"][0]["text"]
    for section in review["sections"].values():
        for fact in section["facts"].values():
            for field in fact["plots"]:
                assert server.get("series", {"f": flight["id"], "s": field}).status == 200


def test_the_page_of_a_review_stands_in_a_frame_of_its_own(server: Server, flight: Any) -> None:
    page = server.get(f"flights/{flight['id']}/review.html")
    assert b"<h1" in page.body
    assert "sandbox" in page.headers["content-security-policy"]


def test_spectrum_and_filters_say_what_the_verbs_say(tmp_path: Path) -> None:
    vehicle = replace(draw_quadrotor(np.random.default_rng(3)), bent_m_s2=20.0)
    (tmp_path / "log.bin").write_bytes(carrier_bytes(travel(vehicle, PLANE), PLANE, imu_hz=200.0))
    assert call("ingest", "log.bin", "-o", "data", cwd=tmp_path).returncode == 0
    printed = call("spectrum", "log.bin", cwd=tmp_path).stdout
    filters = call("filters", "log.bin", "--try", "notch 86 40", cwd=tmp_path).stdout
    with studio(tmp_path / "data") as server:
        path = f"flights/{server.get('flights').json['flights'][0]['id']}"
        shown = server.get(f"{path}/spectrum").json
        assert "\n".join(fold(line) for line in shown["lines"]) == printed.rstrip()
        assert shown["spectra"][0]["peaks"]
        assert b"<svg" in server.get(f"{path}/spectrum.svg").body
        tried = server.get(f"{path}/filters", {"more": "notch 86 40"}).json
        assert tried["rows"][1][0].strip() in filters
        assert all(note in " ".join(filters.split()) for note in tried["notes"])
        assert server.get(f"{path}/filters", {"more": "comb 86"}).status == 400


def test_a_flight_that_is_not_there_has_no_review(server: Server) -> None:
    assert server.get("flights/nothing/review").status == 404


def test_an_empty_studio_makes_a_flight(tmp_path: Path) -> None:
    with studio(tmp_path / "data") as empty:
        made = empty.send("POST", "samples").json["job"]
        assert empty.wait(made["id"])["state"] == "done"
        [reading] = [
            job
            for job in empty.get("jobs").json["jobs"]
            if job["about"].get("sample") == made["about"]["sample"] and job["id"] != made["id"]
        ]
        assert empty.wait(reading["id"])["state"] == "done"
        assert empty.get("flights").json["count"] == 1
