"""Energies of the Pioneer 3DX's and Khepera III's missions by hand: numbers of the papers, no code of missionsim.

Every formula is an integral written out. A mission is a list of `Piece`s in order; each has a duration, the energy of
the robot battery, and the (constant) power of the laptop battery.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

# Jaiem 2021: Eqs. 7 and 8, 12, Tables 2, 3 and 4
C2, C3, C4, STANDING = 6.25, 9.79, 3.66, 2.67
KINECT, LASER = (2.82, 1.2), (2.34, 0.4)
SONAR = 4.0e-5 * 25.0**2 + 5.1e-4 * 25.0
BOARDS = 0.075 + 0.490
RELAYS = (0.087, 0.405, 0.720)
SCREEN = 2.69
IDLE = 11.37
PROCESSOR = {
    ("FM", 0, 2, 0): 11.48,
    ("GBL", 0, 2, 0): 13.90,
    ("QR", 0, 0, 1): 13.10,
    ("QR", 0, 1, 1): 13.66,
    ("QR", 1, 1, 1): 13.72,
    ("QR", 0, 2, 1): 13.21,
    ("QR", 1, 2, 1): 13.27,
    ("CM", 0, 2, 0): 12.30,
    ("CM", 0, 2, 1): 14.09,
    ("CM", 1, 2, 1): 14.15,
    # a sonar beside a scheme whose row does not know it takes the nearest row
    ("RVT", 0, 0, 1): 13.38,
    ("RVT", 1, 0, 1): 13.38,
    ("IA", 0, 0, 1): 11.74,
    ("IA", 1, 0, 1): 11.74,
}
ACCEL = 0.3  # m/s², assumed in the robot file
YAW_RATE, YAW_ACCEL = 1.0, 2.0


@dataclass(frozen=True)
class Piece:
    """Part of a mission: duration [s], energy of the robot battery [J], power of the laptop battery [W], metres."""

    duration_s: float
    robot_j: float
    laptop_w: float
    distance_m: float = 0.0


def sensors_robot_w(sonar: int, lasers: int, kinect: int) -> float:
    """Sensors on the robot battery."""
    return SONAR * sonar + LASER[0] * lasers + KINECT[0] * kinect


def laptop_w(scheme: str, sonar: int, lasers: int, kinect: int) -> float:
    """Laptop battery: Eq. 4."""
    parts = BOARDS + LASER[1] * lasers + KINECT[1] * kinect + RELAYS[lasers] + RELAYS[kinect]
    return parts + (PROCESSOR[scheme, sonar, lasers, kinect] if scheme else IDLE)


def cruise(distance: float, speed: float, scheme: str, sonar: int = 0, lasers: int = 0, kinect: int = 0) -> Piece:
    """At constant speed from the first to the last metre."""
    time = distance / speed
    power = C2 * speed**2 + C3 * speed + C4 + sensors_robot_w(sonar, lasers, kinect)
    return Piece(time, power * time, laptop_w(scheme, sonar, lasers, kinect), distance)


def trapezoid(distance: float, speed: float, scheme: str, sonar: int = 0, lasers: int = 0, kinect: int = 0) -> Piece:
    """From rest to rest; ∫v² over a ramp is v³/(3a), ∫v is the distance."""
    assert distance > speed**2 / ACCEL
    ramp = speed / ACCEL
    steady = (distance - speed**2 / ACCEL) / speed
    time = 2 * ramp + steady
    squares = 2 * speed**3 / (3 * ACCEL) + speed**2 * steady
    energy = C2 * squares + C3 * distance + (C4 + sensors_robot_w(sonar, lasers, kinect)) * time
    return Piece(time, energy, laptop_w(scheme, sonar, lasers, kinect), distance)


def turn(angle: float, scheme: str, sonar: int = 0, lasers: int = 0, kinect: int = 0) -> Piece:
    """On the spot: the boards move, the wheels' speed law has no turning term."""
    time = angle / YAW_RATE + YAW_RATE / YAW_ACCEL
    return Piece(time, (C4 + sensors_robot_w(sonar, lasers, kinect)) * time, laptop_w(scheme, sonar, lasers, kinect))


def stand(time: float, scheme: str = "", sonar: int = 0, lasers: int = 0, kinect: int = 0) -> Piece:
    """Standing still."""
    return Piece(
        time, (STANDING + sensors_robot_w(sonar, lasers, kinect)) * time, laptop_w(scheme, sonar, lasers, kinect)
    )


def bursts_on(length: float, every: float, burst: float) -> float:
    """Time on within `length` when every `every` seconds something is on for `burst` seconds."""
    whole = math.floor(length / every)
    return whole * burst + min(burst, length - whole * every)


def energies_wh(pieces: list[Piece]) -> dict[str, float]:
    """Both batteries' energy."""
    return {
        "robot": math.fsum(p.robot_j for p in pieces) / 3600.0,
        "laptop": math.fsum(p.laptop_w * p.duration_s for p in pieces) / 3600.0,
    }


def valve_patrol(stretch: tuple[float, ...] = (1.0,) * 8, tracking: tuple[float, ...] = (1.0,) * 8) -> list[Piece]:
    """Section 3.4.2 with the fitted lengths; stretch and speed tracking of the eight drives."""
    drives = [
        (7.0, 0.46, "GBL", 0, 2, 0),
        (24.0, 0.56, "QR", 0, 0, 1),
        (16.0, 0.75, "QR", 0, 2, 1),
        (38.0, 0.56, "CM", 0, 2, 1),
        (5.0, 0.56, "QR", 0, 0, 1),
        (43.0, 0.56, "CM", 0, 2, 1),
        (40.0, 0.75, "QR", 0, 2, 1),
        (7.0, 0.46, "GBL", 0, 2, 0),
    ]
    made = [cruise(d * k, v * g, *rest) for (d, v, *rest), k, g in zip(drives, stretch, tracking, strict=True)]
    stop = stand(38.0, "IA", 0, 0, 1)
    return [*made[:2], stop, *made[2:5], stop, *made[5:]]


def hour_inspection() -> list[Piece]:
    """Five rounds; the sonar is on from the drive to V2 until the drive home ends."""
    one = [
        trapezoid(31.0, 0.5, "QR", 0, 1, 1),
        stand(180.0, "IA", 0, 0, 1),
        trapezoid(59.0, 0.5, "CM", 1, 2, 1),
        turn(math.pi / 2, "RVT", 1, 0, 1),
        stand(180.0, "IA", 1, 0, 1),
        trapezoid(90.0, 0.5, "QR", 1, 1, 1),
    ]
    return one * 5


def guard_round() -> list[Piece]:
    """The infeasible mission, driven to its end as if the batteries were bottomless."""
    return [
        trapezoid(31.0, 0.46, "QR", 1, 2, 1),
        stand(5400.0, "IA", 0, 0, 1),
        trapezoid(59.0, 0.46, "QR", 1, 2, 1),
        stand(3600.0, "IA", 0, 0, 1),
        trapezoid(90.0, 0.46, "QR", 1, 2, 1),
    ]


def recharging_patrol() -> tuple[dict[str, float], dict[str, float], float]:
    """Energies used [Wh], charge left [Wh] and duration [s] of four rounds with a recharge of the laptop to 60 %."""
    full = {"robot": 259.2, "laptop": 62.0}
    charge = {"robot": 0.8 * full["robot"], "laptop": 0.4 * full["laptop"]}
    used = {"robot": 0.0, "laptop": 0.0}
    duration = 0.0
    charger_w = 60.0
    for _ in range(4):
        out, look, back = (
            trapezoid(90.0, 0.56, "QR", 0, 2, 1),
            stand(600.0, "IA", 0, 0, 1),
            trapezoid(90.0, 0.56, "QR", 0, 2, 1),
        )
        round_trip = [out, look, back]
        energy = energies_wh(round_trip)
        energy["laptop"] += SCREEN * bursts_on(look.duration_s + back.duration_s, 120.0, 10.0) / 3600.0
        for name in used:
            used[name] += energy[name]
            charge[name] -= energy[name]
        idle = laptop_w("", 0, 0, 0)
        time = (0.6 * full["laptop"] - charge["laptop"]) * 3600.0 / (charger_w - idle)
        # the robot battery is above 60 %: the charger holds it where it is
        used["robot"] += STANDING * time / 3600.0
        used["laptop"] += idle * time / 3600.0
        charge["laptop"] = 0.6 * full["laptop"]
        pause = energies_wh([stand(120.0)])
        for name in used:
            used[name] += pause[name]
            charge[name] -= pause[name]
        duration += sum(p.duration_s for p in round_trip) + time + 120.0
    return used, charge, duration


# Parasuraman 2012: Eq. 15, and the static powers of the robot file (fitted there)
KHEPERA_SENSORS, KOREBOT, WIFI, BLUETOOTH, CONTROLLER = 11 * 0.010 + 5 * 0.050, 0.5, 0.948587, 0.139208, 0.248556


def khepera_static(radio: float) -> float:
    """Everything on at full rate."""
    return KHEPERA_SENSORS + KOREBOT + CONTROLLER + radio


def khepera_motion(distance: float, speed: float, payload: float = 0.0) -> float:
    """Joules of motion at constant speed, Eq. 15 times d/v."""
    return (2.4 * speed + 0.22 * payload + 0.36) * distance / speed


def khepera_task_a(radio: float) -> float:
    """Task A [J]: 125 s static, 100 s of them driving at 56 mm/s."""
    return khepera_static(radio) * 125.0 + khepera_motion(5.6, 0.056)


def khepera_task_b() -> float:
    """Five laps of 4 m [J]."""
    speeds = (0.028, 0.056, 0.083, 0.110, 0.138)
    return sum(khepera_static(WIFI) * 4.0 / v + khepera_motion(4.0, v) for v in speeds)
