"""Start-ups of components and stops of fixed length at docks as arrays: the numbers of SimPy, run by run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from missionsim.uncertainty.batch import Prepared, Task, prepare
from missionsim.uncertainty.draws import simulate_block
from tests.uncertainty.test_montecarlo import assert_agree

ROBOT = """kind: robot
name: starter
body: {{mass: 20 kg, drive: differential, max_speed: 2 m/s, max_acceleration: 0.4 m/s^2, max_yaw_rate: 1 rad/s}}
batteries:
  main: {{capacity: {{value: 40 Wh, sd: 2 %}}, reserve: 5 %, max_charge_power: 80 W{taper}}}
  brain: {{capacity: {{value: 30 Wh, sd: 2 %}}, reserve: 5 %, max_charge_power: 50 W}}
motion:
  battery: main
  model: polynomial
  parameters: {{c2: {{value: 30, sd: 5 %}}, c3: {{value: 20, sd: 5 %}}, c4: 4, standing: {{value: 6, sd: 3 %}}}}
components:
  computer: {{always_on: true, {boot}loads: [{{battery: brain, power: {{value: 12 W, sd: 3 %}}}}]}}
  lidar: {{startup: {{duration: {{value: 8 s, sd: {sd}}}, power: 15 W}},
          loads: [{{battery: brain, power: {{value: 9 W, sd: 4 %}}}}]}}
  arm: {{requires: [lidar], startup: {{duration: 3 s}}, loads: [{{battery: main, power: {{value: 20 W, sd: 2 %}}}}]}}
  eye: {{loads: [{{battery: brain, power: 3 W}}]}}
schemes:
  follow: {{sensors: {{required: {{lidar: 1}}}}}}
  creep: {{sensors: {{required: {{eye: 1}}}}, max_speed: 0.6 m/s}}
  look: {{motion: false, image_analysis: true, sensors: {{required: {{arm: 1}}}}}}
effects:
  - {{effect: acceleration, battery: main, parameters: {{k: {{value: 1, sd: 5 %}}}}}}
{more}"""
SITE = """kind: environment
name: yard
places: {home: {x: 0, y: 0, charger: {power: 70 W}}, far: {x: 60, y: 0}, side: {x: 60, y: 40}}
edges: [{from: home, to: far}, {from: far, to: side}, {from: side, to: home}]
"""
TAPER = ", charge_taper: {from: 70 %, end_power: 20 %}"


def _prepared(
    folder: Path,
    segments: list[str],
    *,
    taper: str = "",
    boot: str = "",
    sd: str = "5 %",
    fast: bool = False,
    more: str = "",
) -> Prepared:
    (folder / "robot.yaml").write_text(ROBOT.format(taper=taper, boot=boot, sd=sd, more=more))
    (folder / "site.yaml").write_text(SITE)
    head = "kind: mission\nname: events\nrobot: robot.yaml\nenvironment: site.yaml\nstart: home\n"
    head += "initial_charge: {main: 60 %, brain: 55 %}\ndefaults: {speed: 0.5 m/s, scheme: creep}\nsegments:\n"
    head = head if fast else head.replace("0.5 m/s, scheme: creep", "0.8 m/s, scheme: follow")
    path = folder / "mission.yaml"
    path.write_text(head + "\n".join(f"  - {segment}" for segment in [*segments, "drive: {to: home}"]) + "\n")
    return prepare(Task(str(path), (), None, 5, "auto"))


def _agree(made: Prepared, runs: int) -> np.ndarray:
    """Compares both ways of running; tells which runs arrays did themselves."""
    assert made.arrays is not None, made.why_not_arrays
    whole = simulate_block(made.mission, made.model, made.sampler, 5, 0, runs)
    assert_agree(made.arrays.block(5, 0, runs), whole)
    return np.asarray(~made.arrays.evaluate(made.sampler.draw(5, 0, runs), runs)[1])


DOCK = "dock: {recharge: {duration: {value: 400 s, sd: 10 %}}}"
LOOK = "inspect: {duration: {value: 30 s, sd: 5 %}, scheme: look}"
DRIVES = ["drive: {to: far}", "drive: {to: side, scheme: creep, speed: 0.5 m/s}"]


@pytest.mark.parametrize(
    ("segments", "options"),
    [
        ([*DRIVES, LOOK], {}),
        ([DRIVES[0], LOOK, DRIVES[1], LOOK], {"boot": "startup: {duration: 20 s, power: 40 W}, "}),
        ([*DRIVES, "drive: {to: home}", DOCK, *DRIVES], {}),
        ([*DRIVES, LOOK, "drive: {to: home}", DOCK, *DRIVES, "drive: {to: home}", DOCK], {"taper": TAPER}),
        (["drive: {to: far}", "drive: {to: home}", DOCK, "drive: {to: side}"], {"fast": True, "taper": TAPER}),
        ([DOCK, "wait: {duration: 5 s, scheme: creep}", DOCK], {"taper": TAPER, "boot": "startup: {duration: 9 s}, "}),
    ],
)
def test_start_ups_and_docks_as_arrays_are_those_of_simpy(tmp_path: Path, segments: list[str], options: dict) -> None:
    own = _agree(_prepared(tmp_path, segments, **options), 60)
    assert own.mean() > 0.9


@pytest.mark.parametrize(
    "effect",
    [
        "effect: cold_friction, battery: main, parameters: {k: {value: 9 N, sd: 5 %}, tau: 60 s}",
        "effect: 'component_warmup:lidar', battery: brain, parameters: {k: {value: 8 W, sd: 5 %}, tau: 30 s}",
        'name: drift, battery: brain, power: "k * time_s", parameters: {k: {value: 0.01 W/s, sd: 5 %}}',
    ],
)
def test_what_goes_by_a_clock_as_arrays_is_that_of_simpy(tmp_path: Path, effect: str) -> None:
    """Time driven, time since a sensor was switched on, which happens twice here, and time itself."""
    segments = [
        DRIVES[0],
        "drive: {to: side, scheme: follow}",
        LOOK,
        "drive: {to: far}",
        "drive: {to: side, scheme: follow}",
    ]
    own = _agree(_prepared(tmp_path, segments, more=f"  - {{{effect}}}\n"), 40)
    assert own.mean() > 0.9


def test_a_run_in_which_events_change_their_order_goes_to_simpy(tmp_path: Path) -> None:
    drive = "drive: {to: far, speed: {value: 0.5 m/s, sd: 3 %}, scheme: creep}"
    # the computer is ready in the cruise of most runs, and in a later phase of some
    own = _agree(
        _prepared(tmp_path, [drive, "wait: {duration: 9 s}"], boot="startup: {duration: 117 s, power: 40 W}, "), 80
    )
    assert 0.0 < own.mean() < 1.0


PIECES = st.sampled_from([*DRIVES, "drive: {to: home}", "wait: {duration: 12 s, scheme: creep}", LOOK])


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(PIECES, min_size=1, max_size=5),
    st.booleans(),
    st.sampled_from(["", TAPER]),
    st.sampled_from(["", "startup: {duration: {value: 25 s, sd: 20 %}, power: 40 W}, "]),
)
def test_random_missions_agree(tmp_path: Path, pieces: list[str], docked: bool, taper: str, boot: str) -> None:
    segments = [*pieces, *(["drive: {to: home}", DOCK] if docked else []), *pieces[:2]]
    made = _prepared(tmp_path, segments, taper=taper, boot=boot, sd="20 %")
    if made.arrays is None:
        assert "very instant" in made.why_not_arrays or "%" in made.why_not_arrays
    else:
        _agree(made, 12)


@pytest.mark.parametrize(
    ("segment", "told"),
    [
        ("dock: {recharge: {until: 90 %}}", "depends on the charge"),
        ("dock: {recharge: {duration: 60 s}, if_below: 40 %}", "depends on the charge"),
    ],
)
def test_what_arrays_cannot_do_is_told(tmp_path: Path, segment: str, told: str) -> None:
    made = _prepared(tmp_path, [segment])
    assert made.arrays is None
    assert told in made.why_not_arrays
