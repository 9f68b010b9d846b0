"""The Mecanum robot's and the rover's missions by hand: polynomials of the speed, integrated over each phase, to 1e-9.

Numbers are those of the robot files (fitted or assumed there); the formulas are the papers' and written out here.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest

from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission
from tests.engine.making import robot, run

EXACT = 1e-9
G = 9.80665


def energy(root: Path, name: str) -> tuple[float, float]:
    """Energy [J] and duration [s] of a shipped mission."""
    result = simulate(load_mission(root / "missions" / f"{name}.yaml"))
    assert result.batteries["robot"].audit_relative_error < 1e-9
    return result.batteries["robot"].energy_wh * 3600.0, result.duration_s


def over(coefficients: list[float], begin: float, end: float, rate: float) -> float:
    """∫ Σ c_k v^k dt while v goes from `begin` to `end` at `rate`."""
    return sum(c * (end ** (k + 1) - begin ** (k + 1)) / ((k + 1) * rate) for k, c in enumerate(coefficients))


# Mecanum robot (after Hou et al. 2019): friction of wheels and rollers, copper loss, kinetic power, pulses
MASS, WHEEL, ROLLER, COPPER, PULSE, ELECTRONICS = 9.536089, 21.058036, 2.1058036, 0.001085402, 1.627174, 1.220652
MECANUM_ACCEL = 3.3333333333333335
SIDES = (-1.0, 1.0, 1.0, -1.0)


def mecanum_run(
    distance: float,
    speed: float,
    direction: float = 0.0,
    payload: float = 0.0,
    slope: float = 0.0,
    entry: float = 0.0,
    leave: float = 0.0,
) -> tuple[float, float]:
    """Joules and seconds of a move in a direction, from and to given speeds."""
    mass = MASS + payload
    load = mass / MASS
    ahead, aside = math.cos(direction), math.sin(direction)
    if abs(aside) < 1e-12:
        aside = 0.0
    if abs(ahead) < 1e-12:
        ahead = 0.0
    wheels = [ahead + s * aside for s in SIDES]
    wheels = [0.0 if abs(u) < 1e-9 else u for u in wheels]
    friction = WHEEL * load / 4.0 * sum(abs(u) for u in wheels) + ROLLER * load * math.sqrt(2.0) * abs(aside)
    lift = mass * G * math.sin(slope)
    left = math.copysign(1.0, aside) if aside else 0.0

    def constant(accel: float) -> float:
        forces = [
            WHEEL * load / 4.0 * ((u > 0) - (u < 0))
            + s * math.sqrt(2.0) * ROLLER * load / 4.0 * left
            + ((mass * accel * ahead + lift) + s * mass * accel * aside) / 4.0
            for u, s in zip(wheels, SIDES, strict=True)
        ]
        return 4.0 * COPPER * sum(g * g for g in forces) + ELECTRONICS + (PULSE if accel else 0.0)

    def per_speed(accel: float) -> float:
        # friction, inertia and weight add up at the wheels; nothing is given back
        return max(friction + mass * accel + lift, 0.0)

    a = MECANUM_ACCEL
    up, down = (speed - entry) / a, (speed - leave) / a
    steady = (distance - (speed**2 - entry**2) / (2 * a) - (speed**2 - leave**2) / (2 * a)) / speed
    joules = (
        over([constant(a), per_speed(a)], entry, speed, a)
        + over([constant(-a), per_speed(-a)], speed, leave, -a)
        + (constant(0.0) + per_speed(0.0) * speed) * steady
    )
    return joules, up + steady + down


def mecanum_turn(angle: float, payload: float = 0.0) -> tuple[float, float]:
    """On the spot at 1.5 rad/s: wheels 0.4 m and rollers 0.2 m from the centre."""
    load = (MASS + payload) / MASS
    power = WHEEL * load * 0.4 * 1.5 + ROLLER * load * math.sqrt(2.0) * 0.2 * 1.5 + ELECTRONICS
    return power * angle / 1.5, angle / 1.5


def mecanum_stand(time: float) -> tuple[float, float]:
    """Electronics only."""
    return ELECTRONICS * time, time


def test_mecanum_start_straight(root: Path) -> None:
    assert energy(root, "mecanum4/start_straight") == pytest.approx(mecanum_run(10.0, 1.0), rel=EXACT)


def test_mecanum_directions(root: Path) -> None:
    parts = [mecanum_run(5.0, 1.0, math.radians(angle)) for angle in (0, 45, 90, 135, 180)]
    expected = tuple(math.fsum(column) for column in zip(*parts, strict=True))
    assert energy(root, "mecanum4/directions") == pytest.approx(expected, rel=EXACT)


def test_mecanum_pallet_transfer(root: Path) -> None:
    quarter, half = math.pi / 2, math.pi
    one = [
        mecanum_run(12.0, 0.8),
        mecanum_run(2.0, 0.4, quarter),
        mecanum_stand(20.0),
        mecanum_run(2.0, 0.4, -quarter, 6.0),
        mecanum_turn(half, 6.0),
        mecanum_run(12.0, 0.8, 0.0, 6.0),
        mecanum_stand(15.0),
        mecanum_turn(half),
    ]
    expected = tuple(10.0 * math.fsum(column) for column in zip(*one, strict=True))
    assert energy(root, "mecanum4/pallet_transfer") == pytest.approx(expected, rel=EXACT)


def test_mecanum_ramp(root: Path) -> None:
    slope = math.atan(0.05)
    parts = [
        mecanum_run(10.0, 0.6, payload=5.0, leave=0.6),
        mecanum_run(6.0, 0.6, payload=5.0, slope=slope, entry=0.6),
        mecanum_stand(30.0),
        mecanum_run(6.0, 0.6, slope=-slope, leave=0.6),
        mecanum_run(10.0, 0.6, entry=0.6),
    ]
    expected = tuple(math.fsum(column) for column in zip(*parts, strict=True))
    assert energy(root, "mecanum4/ramp") == pytest.approx(expected, rel=EXACT)


# Rover: Eqs. 1–5 with Table 1, constant powers of the robot file, Eq. 6 for the computer
ROVER_MASS, C_R, C_V, DRAG = 3.7, 0.031, 0.023, 0.5 * 1.2 * 0.68 * 0.1
BOARDS, STANDING, CAMERA, ROVER_ACCEL = 3.990984, 1.5, 0.9, 2.0


def computer(frequency_ghz: float, load: float) -> float:
    """Six cores, four busy; dynamic power with f V², V linear from 0.70 V (0.3456 GHz) to 1.10 V (2.0352 GHz)."""
    volts = 0.70 + 0.40 * (frequency_ghz - 0.3456) / (2.0352 - 0.3456)
    scale = frequency_ghz / 2.0352 * (volts / 1.10) ** 2
    idle = 0.02 + (0.06 - 0.02) * scale
    return 3.1 + 4 * (idle + load * 1.2 * scale) + 2 * idle


def computer_law(frequency_ghz: float, complexity: float) -> list[float]:
    """Power as a polynomial of the speed: the load is the loop time times 30 batches a second (below 1)."""
    at_rest = 30.0 * (0.003 + complexity * 30867200.0 / (frequency_ghz * 1e9))
    per_speed = 30.0 * complexity * 4115626.6666666665 / (frequency_ghz * 1e9)
    base = computer(frequency_ghz, 0.0)
    work = computer(frequency_ghz, 1.0) - base
    return [base + work * at_rest, work * per_speed]


def rover_run(
    distance: float,
    speed: float,
    other: list[float],
    slope: float = 0.0,
    payload: float = 0.0,
    starts: bool = True,
    stops: bool = True,
) -> tuple[float, float]:
    """Joules and seconds of a run, from and to rest or not; `other`: power of all electronics as a polynomial of v."""
    mass = ROVER_MASS + payload
    # the paper's Eq. 4 has the weight on level ground, without cos θ
    normal = mass * G
    force = [C_R * normal, C_V * normal, DRAG]
    lift = mass * G * math.sin(slope)

    def phase(begin: float, end: float, rate: float) -> float:
        """Forces at the wheels over a ramp, weight and inertia together, where they do not drive the robot."""
        drive = [force[0] + mass * rate + lift, force[1], force[2]]
        roots = (
            sorted(
                (-drive[1] + sign * math.sqrt(drive[1] ** 2 - 4 * drive[0] * drive[2])) / (2 * drive[2])
                for sign in (-1.0, 1.0)
            )
            if drive[1] ** 2 > 4 * drive[0] * drive[2]
            else []
        )
        low, high = min(begin, end), max(begin, end)
        borders = [low, *(r for r in roots if low < r < high), high]
        if rate < 0:
            borders.reverse()
        total = 0.0
        for a, b in itertools.pairwise(borders):
            middle = 0.5 * (a + b)
            if drive[0] + drive[1] * middle + drive[2] * middle**2 > 0.0:  # else braked away: nothing is given back
                total += over([0.0, *drive], a, b, rate)
        return total

    a = ROVER_ACCEL
    joules = seconds = 0.0
    steady_m = distance
    for happens, begin, end, rate in ((starts, 0.0, speed, a), (stops, speed, 0.0, -a)):
        if happens:
            joules += phase(begin, end, rate) + over(other, begin, end, rate)
            seconds += speed / a
            steady_m -= speed**2 / (2 * a)
    drag = sum(c * speed**k for k, c in enumerate(force)) + lift
    joules += (drag * speed + sum(c * speed**k for k, c in enumerate(other))) * steady_m / speed
    seconds += steady_m / speed
    return joules + BOARDS * seconds, seconds


def test_rover_mechanical_optimum(root: Path) -> None:
    assert energy(root, "rover_tx2/mechanical_optimum") == pytest.approx(rover_run(1000.0, 2.0, [0.0]), rel=EXACT)


def test_rover_high_complexity(root: Path) -> None:
    law = computer_law(2.0352, 1.0)
    expected = rover_run(300.0, 7.5, [law[0] + CAMERA, law[1]])
    assert energy(root, "rover_tx2/high_complexity") == pytest.approx(expected, rel=EXACT)


def test_rover_mixed_survey(root: Path) -> None:
    # it passes the start without stopping on its way from one track to the next, and stops where it turns back
    tracks = [
        (0.4992, 0.3, True, True),
        (0.4992, 0.3, True, False),
        (0.96, 0.6, False, True),
        (0.96, 0.6, True, False),
        (1.4208, 1.0, False, True),
    ]
    parts = [((computer(0.4992, 0.3) + STANDING) * 60.0, 60.0)]
    for frequency, complexity, starts, stops in tracks:
        law = computer_law(frequency, complexity)
        parts.append(rover_run(300.0, 2.75, [law[0] + CAMERA, law[1]], starts=starts, stops=stops))
    expected = tuple(math.fsum(column) for column in zip(*parts, strict=True))
    assert energy(root, "rover_tx2/mixed_survey") == pytest.approx(expected, rel=EXACT)


def test_rover_hill(root: Path) -> None:
    slope = math.atan(0.08)
    law = computer_law(0.96, 0.6)
    parts = [
        rover_run(200.0, 3.0, [law[0] + CAMERA, law[1]], slope, payload=1.0),
        ((computer(0.4992, 0.1) + STANDING) * 20.0, 20.0),
        rover_run(200.0, 3.0, [law[0] + CAMERA, law[1]], -slope),
    ]
    expected = tuple(math.fsum(column) for column in zip(*parts, strict=True))
    assert energy(root, "rover_tx2/hill") == pytest.approx(expected, rel=EXACT)


# Khepera III on a slope: Eq. 15 plus the weight along the slope; 0.69 kg, 0.5 m/s²
SENSORS, KOREBOT, WIFI, BLUETOOTH, CONTROLLER = 11 * 0.010 + 5 * 0.050, 0.5, 0.948587, 0.139208, 0.248556


def khepera_run(pieces: list[tuple[float, float]], speed: float, payload: float = 0.0) -> tuple[float, float]:
    """Motion over (length, slope) pieces from rest to rest [J, s]; the ramps are shorter than the outer pieces."""
    ramp_m = speed**2 / (2 * 0.5)
    metres = sum(length for length, _ in pieces)
    seconds = 2 * speed / 0.5 + (metres - 2 * ramp_m) / speed
    lift = sum((0.69 + payload) * G * math.sin(slope) * length for length, slope in pieces)
    # ∫ 2.4 v dt is 2.4 times the way, whatever the speed
    return 2.4 * metres + (0.22 * payload + 0.36) * seconds + lift, seconds


def test_khepera_tunnel(root: Path) -> None:
    slope = math.atan(0.02)
    rest = SENSORS + KOREBOT + CONTROLLER
    one = []
    for pieces, payload in (
        ([(8.2, 0.0), (6.4, slope)], 0.0),
        ([(12.0, 0.0)], 0.1),
        ([(12.0, 0.0), (6.4, -slope), (8.2, 0.0)], 0.0),
    ):
        joules, seconds = khepera_run(pieces, 0.1, payload)
        one.append((joules + (rest + WIFI) * seconds, seconds))
    one += [((rest + WIFI) * 300.0, 300.0), ((rest + BLUETOOTH) * 300.0, 300.0)]
    expected = tuple(3.0 * math.fsum(column) for column in zip(*one, strict=True))
    assert energy(root, "khepera3/tunnel_inspection") == pytest.approx(expected, rel=EXACT)


def test_khepera_components_one_by_one(root: Path) -> None:
    infrared, ultrasonic = 11 * 0.010, 5 * 0.050
    steps = [0.0, KOREBOT, KOREBOT + infrared, KOREBOT + infrared + ultrasonic]
    steps += [steps[-1] + BLUETOOTH, steps[-1] + WIFI]
    joules = sum((CONTROLLER + step) * 30.0 for step in steps)
    seconds = 180.0
    for metres, speed, payload in ((1.0, 0.028, 0.0), (2.0, 0.138, 0.0), (2.0, 0.138, 0.25)):
        time = metres / speed
        joules += (CONTROLLER + steps[3] + 2.4 * speed + 0.22 * payload + 0.36) * time
        seconds += time
    assert energy(root, "khepera3/identify_components") == pytest.approx((joules, seconds), rel=EXACT)


def test_no_shipped_mission_is_left_out(root: Path) -> None:
    text = "".join(
        (root / "tests" / "engine" / name).read_text() for name in ("test_closed_form.py", "test_closed_form_others.py")
    )
    for path in sorted((root / "missions").glob("*/*.yaml")):
        if "kind: mission" in path.read_text().split("segments:")[0] and not path.stem.startswith("corridor_"):
            assert f'{path.parent.name}/{path.stem}"' in text or f'"{path.stem}"' in text, path


@pytest.mark.parametrize(("degrees", "speed"), [(90, 0.5), (45, 0.5 * math.sqrt(2.0)), (0, 1.0), (180, 1.0)])
def test_a_speed_of_the_defaults_is_cut_to_what_the_robot_does_sideways(degrees: int, speed: float) -> None:
    """The limit sideways was read only where it is above `max_speed`."""
    machine = robot(body__max_lateral_speed=0.5)
    move = {"move": {"distance": 5.0, "direction": f"{degrees} deg"}}
    result = run([move], machine, defaults={"speed": 1.0, "profile": "constant_speed"})
    assert result.duration_s == pytest.approx(5.0 / speed)
