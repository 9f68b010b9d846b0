"""Power of the little world: the base robot at wheel level, and the effects that can be hidden in it.

The forms differ on purpose from the ones of the library under test: Coulomb friction saturates as tanh, mechanical
power passes an efficiency map and a copper-loss cross term, heat is a state with a lag of its own, radios saturate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .motion import Array, Motion, Robot, smooth, wander

GRAVITY = 9.81

INSIDE = (
    *("grade", "payload", "acceleration", "turning_scrub", "rolling_friction", "viscous_friction"),
    *("aerodynamic_drag", "surface_rolling_resistance", "cold_friction", "temperature_friction", "start_surge"),
    *("conversion_loss", "standby_load", "component_power", "component_warmup", "cpu_load"),
    *("cpu_frequency", "radio_range"),
)
OUTSIDE = ("fan", "skid", "highspeed", "voltage_load", "random_onset", "hysteresis")
TWINS = {"rolling_friction": "c3", "viscous_friction": "c2", "standby_load": "c4", "component_power": "component"}


@dataclass(frozen=True)
class Draw:
    """Values that the user cannot know: true base, smooth discrepancy, constants of the hidden forms."""

    c2: float
    c3: float
    c4: float
    rest_w: float
    components: dict[str, float]
    ripple: float
    ripple_phase: float
    tau_s: float
    warm_s: float
    pulse_s: float
    period_s: float
    duty: float
    knee: float
    dead: float
    surface: int
    reference_c: float


def draw_world(robot: Robot, noise_level: int, rng: np.random.Generator) -> Draw:
    """Draw the world's secrets: base coefficients 3 % off (one sigma), ripple of the efficiency map 0.2 or 1 %."""
    off = lambda x: x * (1.0 + 0.03 * rng.standard_normal())  # noqa: E731
    return Draw(
        c2=off(robot.c2),
        c3=off(robot.c3),
        c4=off(robot.c4),
        rest_w=off(robot.rest_w),
        components={name: off(power) for name, power in robot.components.items()},
        ripple={1: 0.0, 2: 0.002, 3: 0.01}[noise_level],
        ripple_phase=float(rng.uniform(0, 2 * np.pi)),
        tau_s=float(rng.uniform(60.0, 120.0)),
        warm_s=float(rng.uniform(15.0, 40.0)),
        pulse_s=float(rng.uniform(0.2, 0.5)),
        period_s=float(rng.uniform(60.0, 130.0)),
        duty=float(rng.uniform(0.35, 0.6)),
        knee=float(rng.uniform(0.6, 0.75)),
        dead=float(rng.uniform(0.45, 0.65)),
        surface=1,
        reference_c=float(rng.uniform(25.0, 32.0)),
    )


def base_columns(motion: Motion, robot: Robot) -> dict[str, Array]:
    """Regressors of the base model on the true motion: unit power of c2, c3, c4, rest, components; shape (n,) each."""
    v = motion.speed
    moving = smooth(((np.abs(v) > 0.005) | (np.abs(motion.yaw) > 0.02)).astype(float), 0.1)
    columns = {"c2": v * v, "c3": np.abs(v) * np.tanh(np.abs(v) / 0.01), "c4": moving, "rest": 1.0 - moving}
    for name in robot.components:
        columns[f"on_{name}"] = smooth(motion.on[name], 0.2)
    return columns


def base_power(motion: Motion, robot: Robot, world: Draw) -> Array:
    """True base power [W]: the published law with the world's coefficients, times the ripple of the efficiency map."""
    columns = base_columns(motion, robot)
    drive = world.c2 * columns["c2"] + world.c3 * columns["c3"] + world.c4 * columns["c4"]
    ripple = 1.0 + world.ripple * np.sin(2 * np.pi * motion.speed / robot.speed_m_s[1] + world.ripple_phase)
    rest = world.rest_w * columns["rest"]
    parts = sum(world.components[name] * columns[f"on_{name}"] for name in robot.components)
    return np.asarray(drive * ripple + rest + parts)


def voltage(motion: Motion, robot: Robot, power_w: Array, start: float) -> Array:
    """Terminal voltage [V] of a sagging battery: open circuit falls with charge, minus R·I."""
    used = np.cumsum(power_w) * 0.1 / 3600.0 / robot.capacity_wh
    charge = np.clip(start - used, 0.02, 1.0)
    open_circuit = robot.voltage_v * (0.94 + 0.08 * charge + 0.02 * np.tanh(8.0 * (charge - 0.85)))
    current = power_w / open_circuit
    return np.asarray(open_circuit - robot.resistance_ohm * smooth(current, 0.5))


def _mechanical(motion: Motion, robot: Robot, world: Draw) -> Callable[[Array, float], Array]:
    """Extra traction force (electrical W per m/s) to electrical power: efficiency map and copper cross term."""
    v = np.abs(motion.speed)
    efficiency = 1.0 - 0.10 * np.exp(-v / (0.2 * robot.speed_m_s[1]))
    copper = 0.03 * world.c4 / world.c3**2 * np.tanh(v / 0.05)

    def power(force: Array, k: float) -> Array:
        extra = k * force
        return np.asarray(extra * v / efficiency + copper * ((world.c3 + extra) ** 2 - world.c3**2))

    return power


def planted(
    effect: str, motion: Motion, robot: Robot, world: Draw, base_w: Array, volt: Array, rng: np.random.Generator
) -> Callable[[float], Array]:
    """Power of a hidden effect [W], shape (n,), as a function of its strength k (monotone in k)."""
    v, t = np.abs(motion.speed), motion.time_s
    mech = _mechanical(motion, robot, world)
    mass = robot.mass_kg + motion.payload
    name, _, part = effect.partition(":")
    if name == "grade":
        floor = 0.8 * world.c3 * v

        def grade(k: float) -> Array:
            raw = mech(mass * GRAVITY * np.sin(motion.slope), k)
            soft = 0.1 * floor + 1e-9
            return np.asarray(np.logaddexp(raw / soft, -floor / soft) * soft)  # smooth max(raw, -floor)

        return grade
    if name == "payload":
        return lambda k: mech(motion.payload / (1.0 + 0.01 * motion.payload / max(robot.payload_kg)), k)
    if name == "acceleration":
        a = smooth(motion.accel, 0.05)
        up = 0.5 * (a + np.sqrt(a * a + 0.02**2)) - 0.01
        return lambda k: mech(mass * np.clip(up, 0.0, None), k)
    if name == "turning_scrub":
        slide = np.abs(motion.wheel_right - motion.wheel_left) / robot.track_m
        return lambda k: k * slide * np.tanh(slide / 0.08) * (1.0 + 0.05 * slide)
    if name == "rolling_friction":
        return lambda k: mech(np.tanh(v / 0.03), k)
    if name == "viscous_friction":
        return lambda k: k * v**2 / (1.0 + 0.08 * v)
    if name == "aerodynamic_drag":
        return lambda k: k * v**2.9
    if name == "surface_rolling_resistance":
        patch = smooth((motion.surface == world.surface).astype(float), 0.4)
        return lambda k: mech(patch * np.tanh(v / 0.03), k)
    if name == "cold_friction":
        warm = _heat(v > 0.005, world.tau_s)
        return lambda k: mech((1.0 - warm) * np.tanh(v / 0.03), k)
    if name == "temperature_friction":
        oil = np.exp((world.reference_c - motion.temp) / 60.0) - 1.0
        return lambda k: mech(oil * np.tanh(v / 0.03), k)
    if name == "start_surge":
        moving = (v > 0.01) | (np.abs(motion.yaw) > 0.03)  # turning on the spot is moving: no surge when it drives on
        from_rest = moving & np.concatenate([[False], ~moving[:-1]])
        from_rest[1] |= bool(moving[0])  # a run that starts at once surges too
        return lambda k: smooth(np.where(from_rest, k / 0.1, 0.0), world.pulse_s)
    if name == "conversion_loss":
        return lambda k: k * (base_w / volt * robot.voltage_v) ** 2
    if name == "standby_load":
        drift = 1.0 + 0.003 * wander(len(t), 100.0, rng)
        return lambda k: k * drift
    if name == "component_power":
        on = smooth(motion.on[part], 0.4)
        return lambda k: k * on
    if name == "component_warmup":
        fading = _since_on(motion.on[part], world.warm_s)
        return lambda k: k * fading
    if name == "cpu_load":
        busy = smooth(motion.cpu, 0.3) ** 0.95
        return lambda k: k * busy
    if name == "cpu_frequency":
        f = motion.freq_hz / 2e9
        return lambda k: k * motion.cpu * f * (0.25 + 0.75 * f) ** 2.4
    if name == "radio_range":
        d = motion.distance_ap_m
        return lambda k: k * d**2 / (1.0 + (d / (3.0 * np.max(d))) ** 2)
    return _outside(name, motion, robot, world, volt, rng)


def _outside(
    name: str, motion: Motion, robot: Robot, world: Draw, volt: Array, rng: np.random.Generator
) -> Callable[[float], Array]:
    """Effects that no library holds."""
    v, t, w = np.abs(motion.speed), motion.time_s, np.abs(motion.yaw)
    top = robot.speed_m_s[1]
    if name == "fan":
        phase = rng.uniform(0.0, world.period_s)
        running = ((t + phase) % world.period_s < world.duty * world.period_s).astype(float)
        return lambda k: k * smooth(running, 1.0)
    if name == "skid":
        return lambda k: k * np.clip(w - world.dead, 0.0, None)
    if name == "highspeed":
        return lambda k: k * np.exp(-(((v - world.knee * top) / (0.08 * top)) ** 2))
    if name == "voltage_load":
        return lambda k: k * np.clip(volt - 0.97 * robot.voltage_v, 0.0, None) * (np.arange(len(t)) % 300 < 150)
    if name == "random_onset":
        start = rng.uniform(0.15, 0.85) * t[-1]
        return lambda k: k / (1.0 + np.exp(-(t - start) / 2.0))
    if name == "hysteresis":
        peak = np.zeros_like(v)  # a clutch that drags for a while after fast driving, only once it slows down
        held = 0.0
        for i, speed in enumerate(v):
            held = max(float(speed), held * 0.9985)
            peak[i] = held
        return lambda k: k * np.clip(peak - v, 0.0, None) ** 2
    raise ValueError(f"no such effect: {name}")


def _heat(driving: Array, tau_s: float) -> Array:
    """Warmth 0..1: rises with driving time, cools six times slower at rest."""
    out = np.zeros(len(driving))
    warm, up, down = 0.0, 0.1 / tau_s, 0.1 / (30.0 * tau_s)
    for i, on in enumerate(np.asarray(driving, dtype=bool).tolist()):
        warm += up * (1.0 - warm) if on else -down * warm
        out[i] = warm
    return out


def _since_on(on: Array, tau_s: float) -> Array:
    """exp(-(time since switched on)/tau) while on, reached through a 0.3 s lag."""
    out = np.zeros(len(on))
    left, before, fade = 0.0, 0.0, float(np.exp(-0.1 / tau_s))
    for i, units in enumerate(on.tolist()):
        left = 0.0 if units == 0 else (1.0 if before == 0 else left * fade)
        out[i], before = left * units, units
    return smooth(out, 0.3)
