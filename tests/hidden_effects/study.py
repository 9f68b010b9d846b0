"""The cases of the study: nothing, each effect at four shares, pairs, outside, confounded, other robots and rates."""

from __future__ import annotations

from .motion import ROBOTS
from .planned import EXECUTION
from .plant import INSIDE, OUTSIDE
from .world import Case

SHARES = (0.01, 0.02, 0.05, 0.10)
TUNING_SEEDS = range(0, 100)
UNTOUCHED_SEEDS = range(1000, 2000)

CONFOUNDED = (  # design, truth, names that cannot be told apart by construction
    ("carpet_payload", "payload", ("payload", "surface_rolling_resistance")),
    ("carpet_payload", "surface_rolling_resistance", ("payload", "surface_rolling_resistance")),
    ("one_speed", "aerodynamic_drag", ("aerodynamic_drag", "viscous_friction", "rolling_friction")),
    ("one_speed", "rolling_friction", ("aerodynamic_drag", "viscous_friction", "rolling_friction")),
    ("cold_payload", "payload", ("payload", "temperature_friction")),
    ("cold_payload", "temperature_friction", ("payload", "temperature_friction")),
    ("slope_payload", "grade", ("grade", "payload")),
    ("slope_payload", "payload", ("grade", "payload")),
    ("mostly_on_always", "standby_load", ("standby_load", "component_power:laser")),
    ("mostly_on_always", "component_power:laser", ("standby_load", "component_power:laser")),
    ("switching_cold", "component_power:kinect", ("component_power:kinect",)),
    ("switching_cold", "temperature_friction", ("temperature_friction",)),
)
PAIRS = (
    ("grade", "payload"), ("turning_scrub", "surface_rolling_resistance"), ("cpu_load", "payload"),
    ("acceleration", "grade"), ("temperature_friction", "turning_scrub"), ("component_warmup:kinect", "grade"),
    ("cold_friction", "component_power:kinect"), ("radio_range", "grade"), ("cpu_frequency", "turning_scrub"),
    ("start_surge", "payload"), ("aerodynamic_drag", "grade"), ("rolling_friction", "turning_scrub"),
    ("standby_load", "acceleration"), ("conversion_loss", "grade"), ("cold_friction", "temperature_friction"),
    ("surface_rolling_resistance", "payload"), ("viscous_friction", "acceleration"), ("cpu_load", "cpu_frequency"),
)  # fmt: skip
MIXED = (  # an effect of the library beside one that no library names
    ("grade", "fan"),
    ("payload", "fan"),
    ("turning_scrub", "skid"),
    ("cpu_load", "skid"),
    ("payload", "highspeed"),
    ("cold_friction", "highspeed"),
    ("cpu_load", "voltage_load"),
    ("standby_load", "voltage_load"),
    ("cold_friction", "random_onset"),
    ("grade", "random_onset"),
    ("standby_load", "hysteresis"),
    ("turning_scrub", "hysteresis"),
)


def _qualified(effect: str, robot: str) -> str:
    """Give component effects the robot's switching component."""
    return f"{effect}:{ROBOTS[robot].switching}" if effect.startswith("component_") else effect


def _percent(share: float) -> str:
    return f"{round(100 * share)}pct"


def _build() -> dict[str, Case]:
    cases: list[Case] = []
    for robot in ROBOTS:
        for level in (1, 2, 3):
            cases.append(Case(f"nothing-{robot}-level{level}", robot=robot, noise_level=level))
    cases.append(Case("nothing-10hz", rate_hz=10.0))
    cases.append(Case("nothing-energy", power_format="energy"))
    cases.append(Case("nothing-voltage-current", power_format="voltage_current"))
    cases.append(Case("nothing-half-hz", rate_hz=0.5))
    cases.append(Case("nothing-bare", columns=frozenset()))
    cases.append(Case("nothing-two-runs", runs=2))
    cases.append(Case("nothing-one-run", runs=1))
    cases.append(Case("nothing-twelve-runs-10hz", runs=12, rate_hz=10.0))
    for effect in INSIDE:
        hidden = _qualified(effect, "pioneer3dx")
        stem = hidden.replace(":", "-")
        cases += [Case(f"{stem}-{_percent(s)}", (hidden,), s) for s in SHARES]
        if effect in ("grade", "payload", "turning_scrub", "acceleration", "cpu_load", "surface_rolling_resistance"):
            cases.append(Case(f"{stem}-5pct-10hz", (hidden,), 0.05, rate_hz=10.0))
            cases.append(Case(f"{stem}-5pct-energy", (hidden,), 0.05, power_format="energy"))
            cases.append(Case(f"{stem}-5pct-half-hz", (hidden,), 0.05, rate_hz=0.5))
            cases.append(Case(f"{stem}-5pct-bare", (hidden,), 0.05, columns=frozenset()))
            cases.append(Case(f"{stem}-5pct-two-runs", (hidden,), 0.05, runs=2))
            cases.append(Case(f"{stem}-5pct-one-run", (hidden,), 0.05, runs=1))
            cases.append(Case(f"{stem}-5pct-level3", (hidden,), 0.05, noise_level=3))
            for robot in ("husky_like", "small_rover"):
                cases.append(Case(f"{stem}-5pct-{robot}", (hidden,), 0.05, robot=robot))
    cases += [Case(f"two-{a.split(':')[0]}-{b.split(':')[0]}", (a, b), 0.04) for a, b in PAIRS]
    cases += [Case(f"outside-{name}", (name,), 0.05) for name in OUTSIDE]
    cases += [Case(f"mixed-{a}-{b}", (a, b), 0.05) for a, b in MIXED]
    for design, truth, same in CONFOUNDED:
        share = 0.08 if truth in ("standby_load", "rolling_friction") else 0.05
        cases.append(
            Case(f"confounded-{design}-{truth.replace(':', '-')}", (truth,), share, design=design, equivalent=same)
        )
    cases.append(Case("nothing-planned", robot="husky_like", design="planned"))
    for name in EXECUTION:
        for share in (0.03, 0.08):
            stem = f"execution-{name}-{_percent(share)}"
            cases.append(Case(stem, (name,), share, robot="husky_like", design="planned"))
    return {case.name: case for case in cases}


ALL_CASES = _build()
