"""Several robots in one recording: whose topics are whose, and which of them a suggested map is for."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping

from missionsim.importer.roles import Field, guess_all

_MOVES = ("nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", "geometry_msgs/msg/TwistStamped")
"""Types of messages of which each robot has one of its own."""


def of_one_robot(fields: Mapping[str, Field]) -> tuple[dict[str, Field], str]:
    """The fields of one robot and those of none, and what is said of it; all fields where there are no several.

    Robots are namespaces of topics that move, and have two topics or more of the same names, or the same name but for a
    number. The first that has a meter is taken.
    """
    spaces: dict[str, dict[str, str]] = defaultdict(dict)
    for name, one in fields.items():
        topic = name.partition(".")[0].partition("[")[0]
        space, _, tail = topic.strip("/").partition("/")
        if tail and topic.startswith("/"):
            spaces[space][tail] = one.title
    moving = [space for space, tails in spaces.items() if any(title in _MOVES for title in tails.values())]
    robots: set[str] = set()
    for space in moving:
        for other in spaces.keys() - {space}:
            numbered = re.sub(r"\d+", "#", space) == re.sub(r"\d+", "#", other)
            if numbered or (other in moving and len(spaces[space].keys() & spaces[other].keys()) > 1):
                robots |= {space, other}
    if not robots:
        return dict(fields), ""
    meters: list[str] = []
    for space in sorted(robots):
        inside = [one for name, one in fields.items() if name.startswith(f"/{space}/")]
        roles = {guess.role for guess in guess_all(inside).values() if guess.score > 0.7}
        if "power" in roles or {"voltage", "current"} <= roles:
            meters.append(space)
    chosen = (meters or sorted(robots))[0]
    others = robots - {chosen}
    kept = {name: one for name, one in fields.items() if name.strip("/").partition("/")[0] not in others}
    told = f"several robots in it: {', '.join(sorted(robots))}; this map is of {chosen}"
    told += ", which has a meter" if meters and len(meters) < len(robots) else ""
    return kept, f"{told}; for another one, put its name in the place of /{chosen}/ in `signals`"
