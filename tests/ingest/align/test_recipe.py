import contextlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flysid
from flysid.errors import RecipeError
from flysid.ingest.align.recipe import Source, load_recipe, parse_recipe, shipped_recipes
from flysid.ingest.align.signals import FlightLog, load_source
from flysid.ingest.formats.common.units import factor


def document(**changes: Any) -> dict[str, Any]:
    base: dict[str, Any] = {
        "name": "test",
        "signals": {
            "u": {"unit": "deg", "hold": "zero", "sources": [{"stream": "A", "field": "x", "unit": "deg"}]},
            "y": {"unit": "m/s", "sources": [{"stream": "B", "field": "y", "unit": "m/s"}]},
        },
        "channels": {"c": {"inputs": ["u"], "outputs": ["y"]}},
    }
    return {**base, **changes}


OF_A_VEHICLE = {"voltage", *(f"motor{k}" for k in range(5, 9))}
"""Signals that `flysid vehicle` takes where a log has them: no channel asks for them."""


@pytest.mark.parametrize("name", shipped_recipes())
def test_every_shipped_recipe_loads_under_its_own_name(name: str) -> None:
    recipe = load_recipe(name)
    assert recipe.name == name
    assert recipe.description
    named = recipe.with_references()
    used = {s for channel in named.channels for s in named.signals_of(channel)}
    assert used == set(recipe.signals) - {s for s in OF_A_VEHICLE if name == "sixdof"}


def test_shipped_recipes_cover_the_first_pipeline() -> None:
    assert {"ardrone-synthetic", "ardupilot-attitude", "ardupilot-velocity"} <= set(shipped_recipes())


@pytest.mark.parametrize(
    ("place", "key", "near"),
    [
        ((), "rate_hx", "rate_hz"),
        (("signals", "u"), "holds", "hold"),
        (("signals", "u", "sources", 0), "feild", "field"),
        (("channels", "c"), "input", "inputs"),
    ],
)
def test_an_unknown_key_names_the_nearest_known_one(place: tuple[Any, ...], key: str, near: str) -> None:
    doc: Any = document()
    target = doc
    for step in place:
        target = target[step]
    target[key] = 1
    with pytest.raises(RecipeError, match=key) as caught:
        parse_recipe(doc, "my.toml")
    assert near in caught.value.hint
    assert caught.value.path == "my.toml"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"rate_hz": "fast"}, "rate_hz"),
        ({"rate_hz": -1.0}, "positive"),
        ({"min_segment_s": -1.0}, "min_segment_s is negative"),
        ({"channels": {}}, "at least one"),
        ({"channels": {"c": {"inputs": ["v"], "outputs": ["y"]}}}, r"signals\.v"),
        ({"channels": {"c": {"inputs": [], "outputs": ["y"]}}}, "inputs and outputs"),
        ({"name": 5}, "name must be text, not a whole number"),
        ({"signals": [1, 2]}, "signals must be a table, not a list"),
    ],
)
def test_what_makes_no_sense_is_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(RecipeError, match=says):
        parse_recipe(document(**change))


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ({"stream": "A", "field": "q", "transform": "pich"}, "unknown transform"),
        ({"stream": "A", "field": ["a", "b"]}, "takes 1 fields"),
        ({"stream": "A", "field": ["a", "b"], "transform": "forward"}, "needs a yaw"),
        ({"stream": "A", "field": "a", "unit": "furlong"}, "unknown unit"),
        ({"stream": "A", "field": "a", "scale": 0.0}, "must not be 0"),
        ({"stream": "A"}, "field"),
    ],
)
def test_a_source_that_makes_no_sense_is_refused(source: dict[str, Any], says: str) -> None:
    doc = document()
    doc["signals"]["u"]["sources"] = [source]
    with pytest.raises(RecipeError, match=says):
        parse_recipe(doc)


def test_a_recipe_is_read_from_a_path_and_bad_files_are_named(tmp_path: Path) -> None:
    good = tmp_path / "mine.toml"
    good.write_text(
        'name = "mine"\n[signals.u]\nunit = ""\nsources = [{ stream = "A", field = "x" }]\n'
        '[signals.y]\nunit = ""\nsources = [{ stream = "A", field = "y" }]\n'
        '[channels.c]\ninputs = ["u"]\noutputs = ["y"]\n'
    )
    assert load_recipe(good).rate_hz == "auto"
    (tmp_path / "broken.toml").write_text("name = [")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for name, says in [("broken", "not TOML"), ("binary", "UTF-8"), ("absent", "cannot be read")]:
        with pytest.raises(RecipeError, match=says):
            load_recipe(tmp_path / f"{name}.toml")


def test_an_unknown_name_offers_the_nearest() -> None:
    with pytest.raises(RecipeError) as caught:
        load_recipe("ardupilot-atitude")
    assert "ardupilot-attitude" in caught.value.hint


def test_an_unknown_channel_offers_the_nearest() -> None:
    with pytest.raises(RecipeError) as caught:
        load_recipe("ardrone-synthetic").channel("longitudnal")
    assert "longitudinal" in caught.value.hint


json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(["name", "signals", "channels", "conditions", "rate_hz", "antialias"]), json_like)
def test_any_document_parses_or_raises_a_recipe_error(key: str, value: object) -> None:
    with contextlib.suppress(RecipeError):
        assert parse_recipe(document(**{key: value})).channels


@pytest.mark.parametrize(
    ("unit", "wanted", "expected"),
    [("cdeg", "deg", 0.01), ("rad", "deg", 57.29577951308232), ("mm/s", "m/s", 1e-3), ("m", "m", 1.0)],
)
def test_units_convert(unit: str, wanted: str, expected: float) -> None:
    assert factor(unit, wanted) == pytest.approx(expected)


@pytest.mark.parametrize(("unit", "wanted"), [("deg", "m"), ("m", "m/s"), ("", "deg"), ("parsec", "m")])
def test_units_of_different_things_do_not_convert(unit: str, wanted: str) -> None:
    with pytest.raises(RecipeError):
        factor(unit, wanted)


def test_rows_whose_own_time_is_missing_are_left_out(tmp_path: Path) -> None:
    rows = [f"{k / 10:.1f},{'' if k == 7 else 100_000 * k},{k % 5}.5" for k in range(40)]
    path = tmp_path / "t.csv"
    path.write_text("time_s,sampled_us,y\n" + "\n".join(rows) + "\n")
    log = FlightLog(flysid.read(path))
    loaded = load_source(Source("table", ("y",), time="sampled_us"), "table", "", log)
    assert loaded.boots[0].t_ns.tolist() == [100_000_000 * k for k in range(40) if k != 7]
    assert loaded.notes == ("table: rows without a sampled_us, left out: 1",)
