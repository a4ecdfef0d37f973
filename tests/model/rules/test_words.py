"""Rules in words: labels a pilot understands, equations that read well."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from flysid.dataset import Signal
from flysid.errors import StoreError
from flysid.model.base import OperatingPoint, Rule, write_document
from flysid.model.rules.linguistics import labels, pieces, set_words
from flysid.model.rules.memberships import Partition
from flysid.model.rules.operating_words import answers_alike, answers_like, sentences
from flysid.model.rules.phrases import condition_in_words, equation, gains, in_words, meanings
from flysid.model.rules.vocabulary import Axis
from flysid.showing import significant

V_X = Axis("v_x(k-1)", "m/s", -2.0, 2.1)
SIZES = {"slow": 1, "moderately fast": 2, "fast": 3, "": 2, "very slow": 0, "very fast": 4}


def one_axis(*sets: tuple[float, float], low: float = -3.0, high: float = 3.0) -> Partition:
    """Symmetric Gaussian sets (centre, width) of one antecedent."""
    centre, width = (np.array([s[i] for s in sets])[:, None] for i in range(2))
    return Partition(centre, width, width, np.array([low]), np.array([high]))


def said_of(partition: Partition, name: str = "v_x(k-1)", unit: str = "m/s") -> list[str]:
    """The word of every rule."""
    conditions = [condition_in_words(partition, r, [name], [unit]) for r in range(len(partition))]
    found = [re.search("'(.*)'", c) for c in conditions]
    return ["" if f is None else f[1] for f in found]


def test_speeds_are_told_by_size_and_direction() -> None:
    said = labels(np.array([-2.0, -0.6, 0.02, 0.7, 2.1]), V_X)
    assert said == ["fast backward", "slow backward", "hovering", "slow forward", "fast forward"]
    assert labels(np.array([-1.0, 1.0]), Axis("v_z(k-1)", "m/s", -1.1, 1.1)) == ["down", "up"]
    assert labels(np.array([-1.0, 1.0]), Axis("w", "m/s", -1.1, 1.1)) == ["negative", "positive"]


def test_other_quantities_are_low_middle_high_or_signed() -> None:
    assert labels(np.array([3.0, 1.0, 2.0]), Axis("h(k)", "m", 0.5, 3.5)) == ["high", "low", "middle"]
    assert labels(np.array([1.0, 1.001]), Axis("u", "", 0.0, 2.0)) == ["", ""]
    assert len(set(labels(np.arange(9.0), Axis("u", "", 0.0, 9.0)))) == 9
    signed = labels(np.array([-10.0, -1.0, 4.0, 9.0]), Axis("phi(k)", "deg", -12.0, 12.0))
    assert signed == ["negative", "near zero", "slightly positive", "strongly positive"]


def test_a_speed_without_a_sign_is_slow_or_fast() -> None:
    assert labels(np.array([12.0, 20.0]), Axis("airspeed(k-1)", "m/s", 9.0, 24.0)) == ["slow", "fast"]
    assert said_of(one_axis((2.0, 1.0), (15.0, 4.0), low=0.0, high=20.0), "airspeed") == ["slow", "fast"]


def test_only_one_speed_is_hovering() -> None:
    assert labels(np.array([-0.1, 0.05, 1.0]), V_X) == ["backward", "hovering", "forward"]
    assert labels(np.array([0.1, 0.3]), V_X) == ["hovering", "forward"]


def test_a_place_within_8_percent_of_the_range_is_at_zero() -> None:
    axis = Axis("v_x(k-1)", "m/s", -2.0, 2.0)  # 8 % are 0.32 m/s
    assert labels(np.array([0.31, 1.5]), axis) == ["hovering", "forward"]
    assert labels(np.array([0.33, 1.5]), axis) == ["slow forward", "fast forward"]


def test_a_piece_around_zero_hovers_within_15_percent_of_the_range() -> None:
    """The sets meet at -1 and 1 m/s: 15.2 and 14.9 % of the range."""
    sets = (-2.0, 1.0), (0.0, 1.0), (2.0, 1.0)
    wide = ["fast backward", "slow backward or slow forward", "fast forward"]
    assert said_of(one_axis(*sets, low=-3.3, high=3.3)) == wide
    assert said_of(one_axis(*sets, low=-3.35, high=3.35)) == ["backward", "hovering", "forward"]


def test_a_piece_of_less_than_3_percent_of_the_range_is_no_piece() -> None:
    """Equal sets meet halfway: 0.17 and 0.19 of 6 m/s from the end of the range."""
    assert [p.low for p in pieces(one_axis((-5.66, 1.0), (0.0, 1.0)))[0]] == [-3.0]
    assert [p.low for p in pieces(one_axis((-5.62, 1.0), (0.0, 1.0)))[0]] == pytest.approx(
        [-3.0, -2.81], abs=0.006
    )


def test_sets_a_quarter_of_their_width_apart_are_at_two_places() -> None:
    axis = Axis("u", "", 0.0, 4.0)
    assert set_words(np.array([1.0, 1.24]), np.array([1.0, 2.0]), axis) == ["near 1.12", "away from 1.12"]
    assert set_words(np.array([1.0, 1.26]), np.array([1.0, 2.0]), axis) == ["low", "high"]


def test_half_as_wide_again_is_another_set() -> None:
    axis = Axis("u", "", 0.0, 4.0)
    assert set_words(np.array([1.0, 1.0]), np.array([1.0, 1.49]), axis) == ["", ""]
    assert set_words(np.array([1.0, 1.0]), np.array([1.0, 1.5]), axis) == ["near 1", "away from 1"]


def test_signs_have_words_beyond_15_percent_of_the_range() -> None:
    values = np.array([-1.0, 4.0])
    assert labels(values, Axis("phi", "deg", -1.4, 8.6)) == ["low", "high"]
    assert labels(values, Axis("phi", "deg", -1.6, 8.4)) == ["negative", "positive"]
    assert labels(values, Axis("phi", "deg", -8.6, 1.4)) == ["low", "high"]


def test_changes_rise_and_fall() -> None:
    said = labels(np.array([-0.2, 0.0, 0.05, 0.3]), Axis("v_x(k-1)-v_x(k-2)", "m/s", -0.3, 0.3))
    assert said == ["falling", "steady", "rising slowly", "rising quickly"]


def test_one_rule_to_a_side_speaks_for_the_whole_side() -> None:
    assert said_of(one_axis((-0.9, 0.7), (0.7, 0.5))) == ["backward", "forward"]
    assert said_of(one_axis((-1.0, 0.5), (0.0, 0.2), (1.0, 0.5))) == ["backward", "hovering", "forward"]
    assert said_of(one_axis((0.2, 0.4), (2.0, 0.4))) == ["backward or slow forward", "fast forward"]


def test_a_wide_set_under_a_narrow_one_is_named_by_where_it_is_left() -> None:
    demo = one_axis((-0.813, 0.374), (-1.05, 0.267), (1.02, 0.326), low=-2.9, high=2.7)
    assert said_of(demo, "v_y(k-1)") == [
        "slow or fast to the left", "moderately fast to the left", "to the right",
    ]  # fmt: skip
    first = condition_in_words(demo, 0, ["v_y(k-1)"], ["m/s"])
    assert first.endswith("(about -0.813 +- 0.374 m/s; strongest below -1.64 and from -0.951 to 0.169 m/s)")
    assert "strongest" not in condition_in_words(demo, 1, ["v_y(k-1)"], ["m/s"])
    assert said_of(one_axis((1.5, 2.0), (0.0, 0.3))) == ["backward or forward", "hovering"]
    assert said_of(one_axis((0.0, 9.0), (-2.0, 0.6), (2.0, 0.6))) == [
        "anywhere else", "moderately fast backward", "moderately fast forward",
    ]  # fmt: skip
    height = one_axis((5.0, 9.0), (4.0, 0.5), low=0.0, high=10.0)
    assert said_of(height, "h(k-1)", "m") == ["away from 4 m", "near 4 m"]


def test_a_rule_that_is_nowhere_the_strongest_is_called_so() -> None:
    covered = one_axis((-1.0, 0.5), (0.0, 0.2), (-0.45, 0.05), (-0.6, 0.05), (-0.52, 0.02), (1.0, 0.5))
    hidden = Partition(
        covered.centre, covered.left, covered.right, np.array([-3.0]), np.array([3.0]), "gaussian", "minimum"
    )
    assert len(set(said_of(hidden))) == 6
    outside = one_axis((-1.0, 0.5), (1.0, 0.5), (9.0, 0.5))
    assert said_of(outside) == ["backward", "forward", "near 9 m/s"]
    last = condition_in_words(outside, 2, ["v_x(k-1)"], ["m/s"])
    assert last.endswith("'near 9 m/s' (+- 0.5 m/s; hardly anywhere the strongest)")


def test_sets_at_one_place_are_told_by_their_widths() -> None:
    p = one_axis((0.5, 0.2), (0.501, 2.0), (0.499, 0.25), low=-0.2, high=1.8)
    assert said_of(p, "y(k-1)", "m") == [
        "near 0.499 m, narrowly",
        "away from 0.499 m",
        "near 0.499 m, widely",
    ]
    assert said_of(one_axis((0.5, 0.2), (0.5, 0.2)), "y", "m")[1].endswith(", 2 of 2")


rule_sets = st.lists(
    st.tuples(st.floats(-3.0, 3.0), st.floats(0.1, 3.0)), min_size=2, max_size=5, unique_by=lambda s: s[0]
)
axes = st.sampled_from([("v_x(k-1)", "m/s"), ("u(k)", ""), ("v_y(k-1)-v_y(k-2)", "m/s"), ("h(k-1)", "m")])


@given(sets=rule_sets, axis=axes, high=st.sampled_from([3.0, 12.0]))
def test_rules_of_a_model_have_different_words(
    sets: list[tuple[float, float]], axis: tuple[str, str], high: float
) -> None:
    said = said_of(one_axis(*sets, high=high), *axis)
    assert len(set(said)) == len(sets)
    assert all(said)


def rank(word: str) -> float | None:
    """Where a speed of one word lies on the axis; None for several words."""
    if word == "hovering":
        return 0.0
    match = re.fullmatch(r"(.*?) ?(backward|forward)(, .*)?", word)
    if match is None or match[1] not in SIZES or match[3]:
        return None
    return (1 + SIZES[match[1]]) * (1.0 if match[2] == "forward" else -1.0)


@given(sets=rule_sets)
def test_words_are_ordered_as_the_centres_are(sets: list[tuple[float, float]]) -> None:
    """Of rules that are the strongest at their own centre, and on one stretch only."""
    partition = one_axis(*sets)
    found, levels = pieces(partition)
    said = said_of(partition)
    plain = []
    for level, rules in enumerate(levels):
        (centre, *_), mine = partition.centre[rules, 0], [p for p in found if p.level == level]
        if len(rules) == 1 and len(mine) == 1 and mine[0].low <= centre <= mine[0].high:
            plain.append((float(centre), rank(said[rules[0]])))
    ranks = [r for _, r in sorted(plain) if r is not None]
    assert ranks == sorted(ranks)
    assert len(set(ranks)) == len(ranks)


@given(sets=rule_sets)
def test_words_are_true_where_a_rule_is_the_strongest(sets: list[tuple[float, float]]) -> None:
    """Whoever is called backward and nothing else is not the strongest far forward, and the other way."""
    partition = one_axis(*sets)
    said = said_of(partition)
    x = np.linspace(-3.0, 3.0, 301)
    strongest = partition.firing(x[:, None]).argmax(axis=1)
    far = 0.2 * 6.0
    for r, word in enumerate(said):
        at = x[strongest == r]
        place = rank(word)
        if place is None or len(at) < 0.05 * len(x):  # short pieces are left to their neighbours
            continue
        wrong = at[at > far] if place < 0 else at[at < -far] if place > 0 else at[np.abs(at) > far]
        assert len(wrong) <= 0.1 * len(x)


@given(sets=rule_sets)
def test_a_mirrored_axis_has_mirrored_words(sets: list[tuple[float, float]]) -> None:
    partition = one_axis(*sets)
    assume(all(len(rules) == 1 for rules in pieces(partition)[1]))
    mirrored = one_axis(*((-c, w) for c, w in sets))
    swap = {"backward": "forward", "forward": "backward"}
    for word, other in zip(said_of(partition), said_of(mirrored), strict=True):
        if not re.search("anywhere|away|near", word):
            turned = re.sub("backward|forward", lambda m: swap[m[0]], word)
            assert sorted(turned.split(" or ")) == sorted(other.split(" or "))


@given(
    centres=st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=2, max_size=5),
    width=st.lists(st.floats(0.05, 5.0), min_size=10, max_size=10),
)
def test_rules_over_several_antecedents_have_different_words(
    centres: list[tuple[float, float]], width: list[float]
) -> None:
    widths = np.array(width).reshape(5, 2)[: len(centres)]
    ends = np.array([-1.2, -1.2]), np.array([1.2, 1.2])
    partition = Partition(np.array(centres), widths, widths, *ends)
    names = ["v_x(k-1)", "u(k-1)"]
    units = ["m/s", "deg"]
    said = [condition_in_words(partition, r, names, units) for r in range(len(centres))]
    words = [re.sub(r" is A\d+| \(about [^)]*\)", "", s) for s in said]
    assert len(set(words)) == len(words)


@given(
    values=st.lists(st.floats(-1, 1), min_size=2, max_size=9),
    name=st.sampled_from(["v_x(k-1)", "u(k)", "v_y(k-1)-v_y(k-2)"]),
    unit=st.sampled_from(["m/s", "", "deg"]),
)
def test_different_places_have_different_words(values: list[float], name: str, unit: str) -> None:
    said = labels(np.array(values), Axis(name, unit, -1.0, 1.0))
    for value, word in zip(values, said, strict=True):
        for other, other_word in zip(values, said, strict=True):
            if abs(value - other) > 0.08:
                assert word != other_word
                assert word


def test_equations_read_well() -> None:
    text = equation("y(k)", np.array([1.95828, -0.95898, 0.0]), ["y(k-1)", "y(k-2)", "u(k)"], -0.01)
    assert text == "y(k) = 1.95828 y(k-1) - 0.95898 y(k-2) - 0.01"
    assert equation("y(k)", np.array([0.0]), ["u(k)"], 0.0) == "y(k) = 0"
    assert significant(0.0) == "0"
    assert significant(1234567.0) == "1.23e+06"


def test_conditions_name_variable_label_place_and_unit() -> None:
    p = one_axis((-1.0, 0.3), (1.0, 0.3))
    assert condition_in_words(p, 1, ["v_x(k-1)"], ["m/s"]) == "v_x(k-1) is A2 'forward' (about 1 +- 0.3 m/s)"
    alone = Partition(p.centre[:1], p.left[:1], p.right[:1], p.low, p.high)
    assert condition_in_words(alone, 0, ["v_x(k-1)"], ["m/s"]) == "always"


def test_a_variable_that_covers_everything_is_left_out() -> None:
    width = np.array([[0.3, 50.0], [0.3, 50.0]])
    centre = np.array([[-1.0, 0.0], [1.0, 0.0]])
    p = Partition(centre, width, width, np.array([-2.0, -1.0]), np.array([2.0, 1.0]))
    assert "u(k)" not in condition_in_words(p, 0, ["y(k-1)", "u(k)"], ["", ""])


def test_write_says_where_it_failed(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="nowhere"):
        write_document({}, tmp_path / "nowhere" / "m.json")
    write_document({"a": 1.5}, tmp_path / "m.json")
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]


def rule(gain: list[list[float]], radius: float = 0.9) -> Rule:
    return Rule("R1", "always", "y(k) = u(k)", np.array(gain), 2.0, radius, 1.0)


def test_gains_have_units_and_of_several_names() -> None:
    vx = Signal("v_x", "m/s")
    vy = Signal("v_y", "m/s")
    tilt = Signal("theta_in", "deg")
    climb = Signal("vz_in", "m/s")
    assert gains(rule([[0.3]]), ([vx], [tilt])) == ["0.3 m/s per deg"]
    assert gains(rule([[0.3]]), ([vx], [climb])) == ["0.3"]
    assert gains(rule([[0.3]])) == ["0.3"]
    many = gains(rule([[0.3, 0.0], [0.1, 1.0]]), ([vx, vy], [tilt, climb]))
    assert many == [
        "theta_in -> v_x 0.3 m/s per deg",
        "vz_in -> v_x 0",
        "theta_in -> v_y 0.1 m/s per deg",
        "vz_in -> v_y 1",
    ]


def test_gain_and_time_constant_are_told_where_the_digits_of_the_equation_tell_them() -> None:
    def told(gain: float, radius: float) -> str:
        return in_words("t", [rule([[gain]], radius)], []).rpartition("[")[2].rstrip("]")

    assert told(1.0, 0.9) == "gain 1; time constant 2 s"
    assert told(1e4, 0.9995) == "nearly integrates"
    assert told(np.nan, 1.0) == "integrates"
    assert told(-3.0, 1.2) == "unstable by itself"


V = Signal("v_x", "m/s")
TILT = Signal("tilt", "deg")
FAN = Signal("fan")


def point(level: float, gain: list[float], reached: list[float], wide: float) -> OperatingPoint:
    """A place of a model of two rules; `wide`: from the middle of an interval to its ends, a factor."""
    g, t = np.array(gain), np.array(reached)
    ends = np.array([[1.0 / wide], [wide]])
    none = np.zeros(len(g))
    return OperatingPoint(
        0, np.array([level]), none, g, g * ends, t, t * ends, none, none, none, np.array([0.7, 0.3])
    )


def test_rules_that_are_nowhere_the_strongest_at_rest_are_told_apart() -> None:
    """Of two such rules "never at rest" was said, which they are not: they are in the blend."""
    slow = replace(point(0.1, [0.1], [0.8], 1.1), shares=np.array([0.6, 0.3, 0.1]))
    fast = replace(point(1.5, [0.3], [1.8], 1.1), shares=np.array([0.95, 0.01, 0.04]))
    plain = rule([[0.1]])
    told = meanings([replace(plain, here=(slow,)), plain, plain], ([V], [TILT]))
    assert told[1].endswith("never the strongest at rest, at most 30 % near v_x = 0.1 m/s")
    assert told[2].endswith("never the strongest at rest, at most 10 % near v_x = 0.1 m/s")
    (_, other) = meanings([replace(plain, here=(fast,)), plain], ([V], [TILT]))
    assert other.endswith("at most 1 % near v_x = 1.5 m/s")


def test_gains_name_their_input_where_there_are_several() -> None:
    plain = rule([[0.1]])
    (alone,) = meanings([replace(plain, here=(point(0.1, [0.1], [0.8], 1.1),))], ([V, V], [TILT]))
    assert "gain 0.1 m/s per deg, 63 %" in alone
    (both,) = meanings([replace(plain, here=(point(0.1, [0.1, 2.0], [0.8, 0.8], 1.1),))], ([V], [TILT, FAN]))
    assert "of tilt, " in both
    assert "of fan, 63 %" in both


def test_several_inputs_share_a_sentence_and_their_time() -> None:
    alike = point(0.5, [0.1, 2.0], [0.8, 0.8], 1.1)
    (said,) = sentences([alike], ([V], [TILT, FAN]))
    assert said == (
        "Near v_x = 0.5 m/s, one more deg of tilt adds 0.1 m/s (0.0909 to 0.11) to v_x and one unit more of "
        "fan adds 2 m/s (1.82 to 2.2) to v_x; 63 % of each is reached after 0.8 s (0.727 to 0.88)."
    )
    (apart,) = sentences([point(0.5, [0.1, 2.0], [0.8, 1.6], 1.1)], ([V], [TILT, FAN]))
    assert apart.count("63 % of that is reached after") == 2


def test_places_whose_intervals_meet_are_told_apart_where_their_figures_are_far_apart() -> None:
    """In hover 0.11, at half a metre per second 0.16: one sentence said 0.135 of both."""
    slow, cruise = point(0.05, [0.11], [0.7], 1.4), point(0.5, [0.16], [1.0], 1.4)
    assert answers_alike(slow, cruise)
    assert not answers_like(slow, cruise)
    said = sentences([slow, cruise], ([V], [TILT]))
    assert [text.partition(",")[0] for text in said] == ["Near v_x = 0.05 m/s", "Near v_x = 0.5 m/s"]
    fast = point(1.5, [0.3], [1.8], 1.4)
    assert "varies 2.73-fold" in sentences([slow, cruise, fast], ([V], [TILT]))[-1]


def test_places_that_are_poorly_determined_are_not_called_alike() -> None:
    """They were merged into the middle of both, and one rule was said to answer as the other does."""
    slow, fast = point(-0.25, [2.0], [0.3], 3.0), point(0.25, [0.9], [0.06], 30.0)
    assert answers_alike(slow, fast)
    assert not answers_like(slow, fast)
    (said,) = sentences([slow, fast], ([V], [TILT]))
    assert "adds 0.9 to 2 m/s (poorly determined) to v_x" in said
    assert answers_like(point(-0.5, [1.0], [0.5], 1.1), point(0.5, [1.05], [0.5], 1.1))


@pytest.mark.parametrize("places", [[-0.4, 0.4], [-2.0, -1.0, 1.0, 2.0], [-1.0, -0.4, 0.4], [0.1, 0.2, 2.0]])
def test_a_range_is_said_only_where_it_was_computed(places: list[float]) -> None:
    """From -0.394 to 0.394 one gain of 2.39 was said, of two places; at zero, in hover, it was 2.95."""
    (said,) = sentences([point(at, [0.5], [0.8], 1.1) for at in places], ([V], [TILT]))
    assert said.startswith(
        f"Near v_x = {', '.join(map(significant, places[:-1]))} and {significant(places[-1])} m/s"
    )
    (filled,) = sentences([point(at, [0.5], [0.8], 1.1) for at in (-1.0, 0.0, 1.0)], ([V], [TILT]))
    assert filled.startswith("From v_x = -1 to 1 m/s")


@pytest.mark.parametrize(("factor", "alike"), [(1.09, True), (1.11, False)])
def test_figures_within_10_percent_are_alike(factor: float, alike: bool) -> None:
    """Where intervals are narrower than that. The time counts as the gain does."""
    one = point(1.0, [1.0], [1.0], 1.01)
    assert answers_alike(one, point(2.0, [factor], [1.0], 1.01)) is alike
    assert answers_alike(point(2.0, [1.0], [factor], 1.01), one) is alike


@pytest.mark.parametrize(("factor", "alike"), [(1.49, True), (1.54, False)])
def test_figures_are_alike_where_their_intervals_allow_it(factor: float, alike: bool) -> None:
    """Half intervals of ln 1.35 each: together sqrt(2) of that, a factor of 1.529."""
    assert answers_alike(point(1.0, [1.0], [1.0], 1.35), point(2.0, [factor], [1.0], 1.35)) is alike


@pytest.mark.parametrize(("factor", "like"), [(1.24, True), (1.26, False)])
def test_figures_a_quarter_apart_are_two_in_words(factor: float, like: bool) -> None:
    one, other = point(1.0, [1.0], [1.0], 1.9), point(2.0, [factor], [1.0], 1.9)
    assert answers_alike(one, other)
    assert answers_like(one, other) is like
    assert answers_like(other, one) is like


@pytest.mark.parametrize(("wide", "known"), [(1.98, True), (2.02, False)])
def test_an_interval_of_twice_either_way_is_poorly_determined(wide: float, known: bool) -> None:
    (said,) = sentences([point(1.0, [0.5], [0.8], wide)], ([V], [TILT]))
    assert ("poorly determined" in said) is not known
    assert answers_like(point(1.0, [0.5], [0.8], wide), point(2.0, [0.5], [0.8], wide)) is known


def test_overshoot_and_wrong_way_have_words_beyond_5_percent() -> None:
    def said(overshoot: float, wrong_way: float, dead_s: float = 0.0) -> str:
        plain = point(1.0, [0.5], [0.8], 1.1)
        over, wrong, dead = (np.array([value]) for value in (overshoot, wrong_way, dead_s))
        alike = replace(plain, overshoot=over, wrong_way=wrong, dead_s=dead)
        return sentences([alike], ([V], [TILT]))[0].partition("(0.727 to 0.88)")[2]

    assert said(0.049, 0.049) == "."
    assert said(0.12, 0.049) == "; it overshoots by 12 %."
    assert said(0.049, 0.07, 0.02) == ", including a dead time of 0.02 s; it first moves 7 % the wrong way."


def test_mirrored_places_share_a_sentence_and_slow_ones_come_first() -> None:
    """A group of one answers beside zero, another farther out on both sides; none lies at zero itself."""
    inner = [point(at, [0.5], [0.8], 1.05) for at in (-1.0, 1.0)]
    outer = [point(at, [2.0], [0.8], 1.05) for at in (-4.0, -3.0, 3.0, 4.0)]
    said = sentences([*outer, *inner], ([V], [TILT]))
    assert [text.partition(",")[0] for text in said] == [
        "Near v_x = -1 and 1 m/s",
        "From 3 to 4 m/s of v_x either way",
        "Over this range the gain varies 4-fold",
    ]
    lone = [point(at, [2.0], [0.8], 1.05) for at in (-3.2, 3.0)]
    assert sentences([*lone, *inner], ([V], [TILT]))[1].startswith("Near v_x = 3.1 m/s in either direction")


@pytest.mark.parametrize(
    ("places", "covered"),
    [
        ((1.0, 1.5, 2.0, 2.98), True),
        ((1.0, 1.5, 2.0, 3.02), False),
        ((-2.0, -1.51, 0.49, 2.0), True),
        ((-2.0, -1.49, 0.51, 2.0), False),
        ((-2.0, -0.49, 1.51, 2.0), True),
    ],
    ids=str,
)
def test_a_gap_of_half_the_range_is_not_covered(places: tuple[float, ...], covered: bool) -> None:
    """Nor is one around zero with neither end within a quarter of it from zero: hover lies in it."""
    (said,) = sentences([point(at, [0.5], [0.8], 1.1) for at in places], ([V], [TILT]))
    assert said.startswith("From") is covered
