"""The page of a vehicle says what its file says, keeps names of logs text, and fits every screen."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flysid.extras import Extra
from flysid.reviews.fact import Picture, TopView
from flysid.reviews.vehicle_page import render_vehicle, thrust_curve, top_view, write_vehicle_page
from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle, FlightFacts
from flysid.sixdof.judging import ALONE, AXES, BLIND, BOX, HELD, HORIZONS_S, LOOP, Judgement
from tests.browser import needs_browser, opened
from tests.flysid.reviews.test_page import HOSTILE
from tests.flysid.studio.page import until

MOTORS = 4
PLACES = np.array([[0.1, -0.12], [-0.1, -0.12], [-0.1, 0.12], [0.1, 0.12]])
"""Where motors that roll and pitch like `SIGNS` sit, m forward and left."""

SIGNS = np.array([[-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]])
"""Of roll, pitch and yaw by motors front right, rear right, rear left, front left."""


def some_vehicle(name: str = "flight", damage: tuple[str, ...] = ()) -> FittedVehicle:
    """Drag is held and one motor's pitch is uncertain; everything else is determined."""
    theta = np.zeros(layout.count(MOTORS))
    theta[[layout.LAG, layout.CURVE, layout.POWER, layout.THRUST]] = 0.04, 0.7, 1.1, 5.0
    theta[layout.TRIM : layout.INERTIA] = 0.1, -0.2, 0.05, 0.3, 0.2, 0.1, 0.4, -0.5
    theta[layout.INERTIA : layout.EFFECTS] = 1.2, 1.9, 0.001
    theta[layout.EFFECTS :] = (SIGNS * np.array([[120.0], [100.0], [15.0]])).ravel()
    errors = 0.01 * np.abs(theta)
    errors[layout.EFFECTS + MOTORS + 2] = 90.0
    drags = range(layout.ROTOR_DRAG, layout.TRIM)
    inside = np.ones(len(theta), dtype=bool)
    inside[drags] = False
    held = dict.fromkeys(drags, "no velocity and attitude are logged, held at 0")
    flight = FlightFacts(name, 19.0, (1.5, -2.0), (0.01, 0.0, -0.02), None, damage, 3.25)
    return FittedVehicle(
        theta, np.diag(errors**2), inside, held, 0.0, 1000.0, 11.1, 0.01, "regression", (flight,),
        flown_v=(10.2, 12.4),
    )  # fmt: skip


def some_judgement(alone: float = 0.5) -> Judgement:
    """Errors of physics alone are a share of everybody else's."""
    rows = np.arange(1.0, 17.0).reshape(4, 4)
    others = dict.fromkeys((HELD, BLIND, AXES, BOX, LOOP), rows)
    return Judgement({**others, ALONE: alone * rows}, (40, 30, 20, 10), "1 flight left out (last)")


def cells_of(page: str) -> list[list[str]]:
    """The rows of all tables as text."""
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", page, re.DOTALL)
    cells = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL) for row in rows]
    return [[html.unescape(re.sub("<[^>]+>", "", cell)).strip() for cell in row] for row in cells]


def check_against_document(page: str, document: dict[str, Any]) -> None:
    """Every number of the document stands on the page, with its interval or as not determined."""
    rows = cells_of(page)
    by_label = {row[0]: row[1] for row in rows if len(row) > 1}
    motors = document["motors"]
    effects = {row[0]: row[1:4] for row in rows if len(row) == 5 and row[0].isdigit()}
    assert len(effects) == motors
    for number in (*document["numbers"], *(document["body"] or ())):
        words = f"{number['value']:.4g} ± {number['half_width_95'] or 0:.2g}"
        match = re.fullmatch(r"(roll|pitch|yaw) of motor (\d+)", number["name"])
        if match:
            found = effects[match[2]][layout.AXES.index(match[1])]
            assert found == (words if number["is_determined"] else "not determined")
        elif number["is_determined"]:
            assert by_label[number["name"]] == f"{words} {number['unit'].replace('^2', '²')}".rstrip()
        else:
            lacking = f"{number['name']}</dt><dd>{number['reason']}. Next time: {number['flight']}</dd>"
            assert lacking in html.unescape(page)


def test_every_number_of_the_file_is_on_the_page() -> None:
    vehicle = some_vehicle()
    check_against_document(render_vehicle(vehicle), vehicle.to_dict())


def test_numbers_that_places_add_are_on_the_page() -> None:
    vehicle = some_vehicle().placed(PLACES)
    document = vehicle.to_dict()
    assert len(document["body"]) == 5
    page = render_vehicle(vehicle)
    check_against_document(page, document)
    assert "on the other side" not in page


def test_motors_on_the_other_side_are_a_finding() -> None:
    page = render_vehicle(some_vehicle().placed(PLACES[[1, 0, 2, 3]]))
    assert "Motor 1 acts about pitch as if it were on the other side" in page


def test_errors_on_the_page_are_those_of_the_judgement() -> None:
    judged = some_judgement()
    rows = [row[1:] for row in cells_of(render_vehicle(some_vehicle(), judged)) if row[0] == ALONE]
    found = np.array([[float(cell) for cell in row] for row in rows])
    table = np.array(judged.to_dict()["errors"][ALONE], dtype=float).T
    table[2:] = np.degrees(table[2:])
    assert found.shape == (4, len(HORIZONS_S))
    np.testing.assert_allclose(found, table, rtol=5e-3)


@pytest.mark.parametrize(("alone", "grade"), [(0.5, "good"), (2.0, "watch")])
def test_the_headline_says_how_far_physics_leads(alone: float, grade: str) -> None:
    judged = some_judgement(alone)
    page = render_vehicle(some_vehicle(), judged)
    words = judged.words()[0].partition(". ")[0]
    assert f'<h1 class="{grade}">{words[0].upper()}{words[1:]}</h1>' in page


def test_what_leads_for_a_while_is_neither_good_nor_bad() -> None:
    judged = some_judgement()
    judged.table[ALONE][2:] *= 4.0
    assert judged.led == HORIZONS_S[:2]
    assert '<h1 class="plain">Physics alone predicts best up to 0.5 s</h1>' in render_vehicle(
        some_vehicle(), judged
    )


def test_the_flight_that_tells_most_comes_first() -> None:
    page = render_vehicle(some_vehicle())
    first = page.index("Log velocities, and fly to and fro at half speed")
    assert page.index("Do next") < first < page.index("It tells rotor drag x, rotor drag y, rotor drag z")


def test_motors_stand_where_their_effects_place_them() -> None:
    view = top_view(some_vehicle())
    assert isinstance(view, TopView)
    assert np.sign(view.places).tolist() == [[1, 1], [-1, 1], [-1, -1], [1, -1]]
    assert view.spins == (-1, 1, -1, 1)
    assert view.is_known == (True, True, False, True)
    page = render_vehicle(some_vehicle())
    assert page.count('class="motor unsure"') == 1
    assert page.count('class="spin"') == MOTORS


def test_motors_without_effects_are_not_drawn() -> None:
    vehicle = some_vehicle()
    theta = vehicle.theta.copy()
    theta[layout.EFFECTS :] = 0.0
    page = render_vehicle(replace(vehicle, theta=theta))
    assert "From above" not in page
    assert "Thrust of a motor" in page


def test_the_curve_is_what_the_vehicle_lifts() -> None:
    vehicle = some_vehicle()
    picture = thrust_curve(vehicle)
    assert isinstance(picture, Picture)
    volts = [vehicle.reference_v, *(vehicle.flown_v or ())]
    assert [line.name for line in picture.lines] == ["11.1 V", "10.2 V", "12.4 V", "95 %"]
    for line, voltage in zip(picture.lines, volts, strict=False):
        for x, y in zip(line.x, line.y, strict=True):
            commands = np.full((2, MOTORS), vehicle.zero + vehicle.full * x)
            share = vehicle.shares(commands, np.full(2, voltage), vehicle.dt_s)[0, 0]
            assert y == pytest.approx(5.0 * share)


def test_the_band_of_the_curve_is_that_of_draws() -> None:
    vehicle = some_vehicle()
    places = [layout.THRUST, layout.CURVE]
    draws = np.random.default_rng(1).multivariate_normal(
        vehicle.theta[places], vehicle.covariance[np.ix_(places, places)], 20_000
    )
    picture = thrust_curve(vehicle)
    assert picture is not None
    band = picture.lines[-1]
    half = len(band.x) // 2
    x = band.x[:half]
    thrust = draws[:, :1] * ((1.0 - draws[:, 1:]) * x + draws[:, 1:] * x**2)
    np.testing.assert_allclose(band.y[half + 1 :] - band.y[:half], 2.0 * 1.96 * thrust.std(axis=0), rtol=0.05)


def test_thrust_that_is_not_determined_is_drawn_as_a_share() -> None:
    vehicle = some_vehicle()
    inside = vehicle.inside.copy()
    inside[layout.THRUST] = False
    picture = thrust_curve(replace(vehicle, inside=inside))
    assert picture is not None
    assert picture.y_label == "share of full"
    assert "thrust of a motor" in picture.aside
    assert not picture.marks
    assert "full thrust over weight" not in render_vehicle(replace(vehicle, inside=inside))


def test_what_each_flight_gave_is_in_its_row() -> None:
    rows = cells_of(render_vehicle(some_vehicle(damage=("2 link losses",))))
    assert ["flight", "19", "3.2", "1.5, -2", "0.57, 0, -1.1", "-"] in rows
    assert ["flight", "2 link losses"] in rows


def test_a_file_from_before_has_a_page() -> None:
    vehicle = some_vehicle()
    document = vehicle.to_dict()
    del document["flown_v"], document["flights"][0]["lost_s"]
    before = FittedVehicle.from_dict(document)
    assert before.flown_v is None
    check_against_document(render_vehicle(before), vehicle.to_dict())


def test_names_from_a_log_are_text() -> None:
    page = render_vehicle(some_vehicle(HOSTILE, (HOSTILE,)), replace(some_judgement(), tested=HOSTILE))
    assert HOSTILE not in page
    assert page.count("&lt;script&gt;") >= 4
    assert "script-src ;" in html.unescape(page)


def test_a_picture_that_breaks_leaves_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ValueError("injected")

    monkeypatch.setattr("flysid.reviews.page.draw_top_view", fail)
    page = render_vehicle(some_vehicle())
    assert f"{Extra.REVIEW_PICTURE.value.capitalize()} of Motors could not be given" in page
    check_against_document(page, some_vehicle().to_dict())


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Any:
    long = "a-long-name-of-a-flight-" * 4
    path = write_vehicle_page(tmp_path / "vehicle.html", some_vehicle(long, (long,)), some_judgement(), long)
    browser.set_window_size(1280, 1000)
    assert opened(browser, path) == []
    return browser


@needs_browser
@pytest.mark.parametrize("width", [390, 768, 1280])
def test_nothing_is_wider_than_the_screen(page: Any, width: int) -> None:
    page.set_window_size(width, 900)
    fits = "return document.documentElement.scrollWidth <= window.innerWidth"
    until(lambda: page.execute_script(fits), 10.0)


@needs_browser
def test_a_keyboard_opens_what_is_not_determined(page: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    folded = page.find_element("css selector", "details.unknown")
    assert folded.get_attribute("open") is None
    folded.find_element("css selector", "summary").send_keys(Keys.ENTER)
    assert folded.get_attribute("open") is not None
    pictures = page.find_elements("css selector", "svg[role=img]")
    assert len(pictures) == 2
    assert all(one.get_attribute("aria-label") for one in pictures)
