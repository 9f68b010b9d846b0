"""A drive `along` names the edges that are driven: none other, and each of two parallel ones."""

from __future__ import annotations

import math

import pytest

from missionsim.errors import InputError
from missionsim.plan.build import make_plan
from tests.engine.making import load, robot, run

# from gate to parking: directly 50 m, over the yard 20 m, and a service road of 80 m beside the direct way
SITE = {
    "places": {"gate": {}, "yard": {}, "parking": {"charger": {"power": "60 W"}}},
    "edges": [
        {"name": "avenue", "from": "gate", "to": "parking", "length": "50 m"},
        {"name": "service road", "from": "gate", "to": "parking", "length": "80 m", "slope": "2 %"},
        {"from": "gate", "to": "yard", "length": "8 m"},
        {"from": "yard", "to": "parking", "length": "12 m"},
        {"name": "exit", "from": "parking", "to": "yard", "length": "30 m", "both_ways": False},
    ],
}


def distances(drive: dict[str, object]) -> list[float]:
    mission = load({"segments": [{"drive": drive}], "start": "gate"}, None, SITE)
    return [leg.distance_m for leg in make_plan(mission).legs if leg.kind == "roll"]


@pytest.mark.parametrize(
    ("along", "driven"),
    [
        (["parking"], [50.0]),
        (["avenue"], [50.0]),
        (["service road"], [80.0]),
        (["service road", "avenue"], [80.0, 50.0]),
        (["parking", "exit", "gate"], [50.0, 30.0, 8.0]),
        (["yard", "parking", "yard"], [8.0, 12.0, 12.0]),
    ],
)
def test_along_drives_what_it_names(along: list[str], driven: list[float]) -> None:
    assert distances({"along": along, "speed": 1.0}) == driven


def test_a_drive_to_a_place_still_takes_the_shortest_way() -> None:
    assert distances({"to": "parking", "speed": 1.0}) == [8.0, 12.0]


def test_slope_of_a_named_edge_has_the_sign_of_travel() -> None:
    mission = load({"segments": [{"drive": {"along": ["service road", "service road"]}}], "start": "gate"}, None, SITE)
    up, back = [leg.settings.slope_rad for leg in make_plan(mission).legs if leg.kind == "roll"]
    assert up == -back > 0.0


@pytest.mark.parametrize(
    ("along", "told"),
    [
        (["yard", "avenue"], "no edge from 'yard' to 'avenue'"),
        (["yard", "exit"], "no edge from 'yard' to 'exit'"),  # one way only
        (["avenu"], "did you mean: avenue"),
    ],
)
def test_an_edge_that_does_not_leave_here_is_refused(along: list[str], told: str) -> None:
    with pytest.raises(InputError) as error:
        distances({"along": along})
    assert told in str(error.value)


def test_turning_back_on_a_named_edge_stays_on_it() -> None:
    """The reserve is reached early on the sloping service road: the way back is that road, not the level avenue."""
    result = run(
        [{"drive": {"along": ["service road"], "speed": 1.0}}],
        robot(batteries__main__capacity="1 Wh", batteries__main__reserve=0.9),
        SITE,
        start="parking",
        policy={"on_empty": "return_to_dock", "dock": "parking"},
    )
    assert result.segments[-1].name == "return to dock"
    line = result.timeline
    back = (line.segment == len(result.segments) - 1) & (line.columns["speed_m_s"] > 0.0)
    assert set(line.columns["slope_rad"][back].tolist()) == {math.atan(0.02)}
    assert result.distance_m < 80.0


@pytest.mark.parametrize(
    ("spots", "square_m2"),
    [
        ({"near": {"x": 0, "y": 3}}, 40.0**2 / 3.0 + 9.0),
        ({"near": {"x": 0, "y": 0}, "far": {"x": 40, "y": 0}}, 20.0**2 / 3.0),  # the nearer one counts
    ],
)
def test_a_radio_pays_for_the_way_to_the_nearest_access_point(spots: dict[str, object], square_m2: float) -> None:
    """k d² over 40 m at 0.5 m/s, from where the map has its places and access points."""
    site = {
        "places": {"a": {"x": 0, "y": 0}, "b": {"x": 40, "y": 0}},
        "edges": [{"from": "a", "to": "b"}],
        "access_points": spots,
    }
    radio = [{"effect": "radio_range", "battery": "aux", "parameters": {"k": 0.002}}]
    drive = {"to": "b", "speed": 0.5, "profile": "constant_speed"}
    made = run([{"drive": drive}], robot(effects=radio), site, start="a")
    assert 3600.0 * made.by_term_wh("aux")["radio_range"] == pytest.approx(0.002 * square_m2 * 80.0)
