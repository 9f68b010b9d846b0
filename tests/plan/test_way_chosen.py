"""Which way a drive `to` a place takes, what is closed, and that results tell the way."""

from __future__ import annotations

import copy
import json
from typing import Any

import pytest

from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.results.write import edges_table, segments_table
from tests.engine.making import load, run

# over the hill 60 m, around it 80 m level, on a fast road of 100 m
SITE: dict[str, Any] = {
    "places": {"a": {}, "hill": {}, "side": {}, "road": {}, "b": {}},
    "edges": [
        {"name": "up", "from": "a", "to": "hill", "length": "30 m", "slope": "25 %", "max_speed": 0.5},
        {"name": "down", "from": "hill", "to": "b", "length": "30 m", "slope": "-25 %", "max_speed": 0.5},
        {"name": "level", "from": "a", "to": "side", "length": "40 m", "max_speed": 0.7},
        {"name": "on", "from": "side", "to": "b", "length": "40 m", "max_speed": 0.7},
        {"name": "fast", "from": "a", "to": "road", "length": "50 m", "surface": "mud"},
        {"name": "faster", "from": "road", "to": "b", "length": "50 m", "surface": "mud"},
    ],
}
THERE = [{"drive": {"to": "b"}}]


def edges(site: dict[str, Any], **mission: Any) -> list[str]:
    """Names of the edges driven from a to b."""
    return [edge.name for edge in run(THERE, environment=site, start="a", **mission).edges_driven()]


def test_each_way_is_least_in_what_is_asked_of_all_ways() -> None:
    ways = {name: run([{"drive": {"along": name}}], environment=SITE, start="a")
            for name in (("up", "down"), ("level", "on"), ("fast", "faster"))}  # fmt: skip
    cost = {
        "length": lambda made: made.distance_m,
        "time": lambda made: made.duration_s,
        "energy": lambda made: sum(battery.energy_wh for battery in made.batteries.values()),
    }
    chosen = set()
    for least, measure in cost.items():
        best = min(ways, key=lambda way: measure(ways[way]))
        assert edges(SITE, defaults={"route": least}) == list(best)
        chosen.add(best)
    assert edges(SITE) == ["up", "down"]
    assert len(chosen) > 1


@pytest.mark.parametrize("what", ["place", "edge"])
def test_what_is_closed_is_not_driven(what: str) -> None:
    site = copy.deepcopy(SITE)
    if what == "place":
        site["places"]["hill"]["closed"] = True
    else:
        site["edges"][1]["closed"] = True
    assert edges(site) == ["level", "on"]
    with pytest.raises(InputError) as told:
        load({"segments": [{"drive": {"along": ["up", "down"]}}], "start": "a"}, None, site)
    assert "closed" in told.value.faults[0].message
    assert told.value.faults[0].line


def test_a_mission_may_start_at_a_closed_place_but_not_come_back() -> None:
    site = copy.deepcopy(SITE)
    site["places"]["a"]["closed"] = True
    assert edges(site) == ["up", "down"]
    with pytest.raises(InputError, match="closed: a"):
        load({"segments": [*THERE, {"drive": {"to": "a"}}], "start": "a"}, None, site)


def test_results_tell_the_way_with_energies_that_add_up() -> None:
    mission = load({"segments": [*THERE, {"drive": {"to": "a"}}], "start": "a"}, None, SITE)
    result = simulate(mission)
    assert [item["edges"] for item in result.summary()["ways"]] == [["up", "down"], ["down", "up"]]
    assert segments_table(result)["way"] == ["a → hill → b", "b → hill → a"]
    table = edges_table(result)
    assert sum(table["energy_main_wh"]) == pytest.approx(result.batteries["main"].energy_wh, rel=1e-12)
    assert table["charge_main_wh"][-1] == pytest.approx(result.batteries["main"].charge_left_wh, rel=1e-12)
    assert sum(table["length_m"]) == pytest.approx(result.distance_m, rel=1e-12)
    assert json.dumps(result.summary()["ways"])
