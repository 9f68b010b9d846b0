"""Checks across the parts of a robot file, and of what a mission asks for and no term of its robot reads."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from missionsim.effects.base import ParameterSpec
from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.inputs.checker import Checker
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.robot import ComponentSpec, EffectSpec, LawSpec, RobotSpec, SchemeSpec
from missionsim.inputs.segments import flat_segments
from missionsim.inputs.tree import Where
from missionsim.inputs.units import same_dimension
from missionsim.inputs.values import Parameter


def check_robot(robot: RobotSpec) -> list[Fault]:
    """Batteries, links, relays, requirements, sensors of schemes, formulas, motion model and effects."""
    check = Checker(robot.document)
    batteries = check.document.names("batteries") or list(robot.batteries)
    components = check.document.names("components")
    for name, battery in robot.batteries.items():
        if battery.initial_charge.value <= battery.reserve.value and battery.reserve.value > 0:
            got, allowed = f"{battery.initial_charge.value:g}", f"more than {battery.reserve.value:g}"
            check.add(
                ("batteries", name, "initial_charge"), "starts at or below its reserve", got, allowed, warning=True
            )
    for name, link in robot.links.items():
        check.known(("links", name, "battery"), link.battery, batteries, "battery")
    for name, board in robot.switchboards.items():
        check.known(("switchboards", name, "battery"), board.battery, batteries, "battery")
    for name, component in robot.components.items():
        _component(check, robot, name, component, batteries, components)
    _circles(check, robot)
    _relays(check, robot)
    if robot.processor is not None:
        check.known(("processor", "battery"), robot.processor.battery, batteries, "battery")
    for name, scheme in robot.schemes.items():
        _scheme(check, robot, name, scheme)
    if robot.idle_scheme is not None:
        check.known(("idle_scheme",), robot.idle_scheme, check.document.names("schemes"), "control scheme")
    _motion(check, robot, batteries)
    _effects(check, robot, batteries, components)
    return check.faults


def _component(
    check: Checker, robot: RobotSpec, name: str, component: ComponentSpec, batteries: list[str], components: list[str]
) -> None:
    where: Where = ("components", name)
    for index, load in enumerate(component.loads):
        at = (*where, "loads", index)
        check.known((*at, "battery"), load.battery, batteries, "battery")
        links = check.document.names("links")
        if load.through is not None and check.known((*at, "through"), load.through, links, "link"):
            link = robot.links.get(load.through)
            if link is not None and link.battery != load.battery and link.battery in batteries:
                message = f"link '{load.through}' is fed by another battery"
                check.add((*at, "battery"), message, load.battery, link.battery)
        if load.law is not None:
            _law(check, (*at, "law"), load.law)
    if component.relay is not None:
        check.known((*where, "relay"), component.relay, check.document.names("switchboards"), "switchboard")
    for index, other in enumerate(component.requires):
        check.known((*where, "requires", index), other, components, "component")


def _law(check: Checker, where: Where, law: LawSpec) -> None:
    if law.power is not None:
        own = [*law.parameters, *(["rate"] if law.rate is not None else [])]
        check.formulas({(*where, "power"): law.power}, own)
        return
    from missionsim.effects.named_models import law_models

    laws = law_models()
    if law.model is not None and check.known((*where, "model"), law.model, laws, "law"):
        _parameters(check, where, law.parameters, laws[law.model].parameters, f"law '{law.model}'")


def _circles(check: Checker, robot: RobotSpec) -> None:
    """Requirements that lead back to their component."""
    trail: list[str] = []
    done: set[str] = set()
    waiting: list[Iterator[tuple[int, str]]] = [iter(enumerate(robot.components))]
    while waiting:
        index, name = next(waiting[-1], (0, ""))
        if not name:
            waiting.pop()
            done |= {trail.pop()} if trail else set()
        elif name in trail:
            circle = " → ".join([*trail[trail.index(name) :], name])
            where = ("components", trail[-1], "requires", index)
            message = "components require each other in a circle"
            check.add(where, message, circle, "requirements without a circle")
        elif name in robot.components and name not in done:
            trail.append(name)
            waiting.append(iter(enumerate(robot.components[name].requires)))


def _relays(check: Checker, robot: RobotSpec) -> None:
    for name, board in robot.switchboards.items():
        fed = [key for key, component in robot.components.items() if component.relay == name]
        count = sum(robot.components[key].units for key in fed)
        if count > len(board.power) - 1:
            message = f"switchboard has power for {len(board.power) - 1} relays only"
            allowed = f"{count + 1} powers, for 0 to {count} relays"
            check.add(("switchboards", name, "power"), message, f"{count} units: {', '.join(fed)}", allowed)


def _scheme(check: Checker, robot: RobotSpec, name: str, scheme: SchemeSpec) -> None:
    where: Where = ("schemes", name)

    def sensors(at: Where, given: Mapping[str, int], missing: str = "") -> None:
        for sensor, count in given.items():
            check.units((*at, sensor), sensor, count, robot, message=missing.format(sensor) if missing else "")

    for at, rules in [
        ((*where, "sensors"), scheme.sensors),
        *(((*where, "navigation", key), rules) for key, rules in scheme.navigation.items()),
    ]:
        missing = "the scheme requires '{}', which the robot does not have"
        sensors((*at, "required"), rules.required, missing)
        sensors((*at, "optional"), rules.optional)
    sensors((*where, "default_sensors"), scheme.default_sensors)
    if scheme.default_navigation is not None:
        check.known((*where, "default_navigation"), scheme.default_navigation, scheme.navigation, "navigation")
    if scheme.processor and robot.processor is None and "processor" not in check.document.names():
        message = "the robot has no processor that this table could be for"
        check.add((*where, "processor"), message, "", "processor: {battery: …} in the robot", key=True)
    if scheme.motion and scheme.image_analysis:
        message = "image analysis is done standing"
        check.add((*where, "image_analysis"), message, "motion: true", "motion: false", key=True)
    seen: dict[tuple[str | None, tuple[tuple[str, int], ...]], int] = {}
    for index, row in enumerate(scheme.processor):
        at = (*where, "processor", index)
        sensors((*at, "sensors"), row.sensors)
        if row.navigation is not None:
            check.known((*at, "navigation"), row.navigation, scheme.navigation, "navigation of this scheme")
        label = (row.navigation, tuple(sorted((key, count) for key, count in row.sensors.items() if count)))
        if label in seen:
            check.add(at, f"same configuration as row {seen[label]}", allowed="one power per configuration")
        seen.setdefault(label, index)


def _motion(check: Checker, robot: RobotSpec, batteries: list[str]) -> None:
    motion = robot.motion
    if motion is None:
        return
    check.known(("motion", "battery"), motion.battery, batteries, "battery")
    if motion.model == "none":
        return
    if motion.model == "expression":
        texts: dict[Where, str] = {("motion", "power"): str(motion.power)}
        if motion.standing is not None:
            texts["motion", "standing"] = str(motion.standing)
        check.formulas(texts, motion.parameters)
        return
    from missionsim.effects.named_models import get_motion_model, motion_model_ids

    # the commonest first: listing all asks every installed package for models of its own
    if motion.model != "polynomial":
        names = (*motion_model_ids(), "expression", "none")
        if not check.known(("motion", "model"), motion.model, names, "motion model"):
            return
    model = get_motion_model(motion.model)
    _parameters(check, ("motion",), motion.parameters, model.parameters, f"motion model '{motion.model}'")


def _parameters(
    check: Checker, where: Where, given: Mapping[str, Parameter], specs: tuple[ParameterSpec, ...], what: str
) -> None:
    """Known names, all that are needed, values inside the bounds that physics sets."""
    known = {spec.name: spec for spec in specs}
    for name, parameter in given.items():
        at = (*where, "parameters", name)
        if not check.known(at, name, known, "parameter", key=True, message=f"{what} has no parameter '{name}'"):
            continue
        spec = known[name]
        # a plain number ("1") is in the parameter's own unit
        if parameter.unit not in ("", "1", spec.unit) and not same_dimension(parameter.unit, spec.unit):
            allowed = "a plain number" if spec.unit == "1" else f"a number in {spec.unit}"
            check.add(at, f"wrong unit of {name}", f"a number in {parameter.unit}", allowed)
        elif not spec.low <= parameter.value <= spec.high:
            allowed = f"{spec.low:g} to {spec.high:g}" if spec.high < float("inf") else f"at least {spec.low:g}"
            check.add(at, f"impossible value of {name}", f"{parameter.value:g} {spec.unit}", allowed)
    present = check.document.names(*where, "parameters")
    for name, spec in known.items():
        if name not in given and name not in present and spec.required:
            message, allowed = f"parameter '{name}' of {what} is missing", f"{name}: {spec.meaning}, {spec.unit}"
            check.add((*where, "parameters"), message, "", allowed, key=True)


def _effects(check: Checker, robot: RobotSpec, batteries: list[str], components: list[str]) -> None:
    seen: dict[str, int] = {}
    for index, effect in enumerate(robot.effects):
        where: Where = ("effects", index)
        check.known((*where, "battery"), effect.battery, batteries, "battery")
        label = f"{effect.battery}/{effect.name or effect.effect}"
        if label in seen:
            twice = f"effect '{effect.name or effect.effect}' given twice on this battery"
            check.add(where, f"{twice}; the first is item {seen[label]}", "", "a 'name' of its own for each")
        seen.setdefault(label, index)
        of_mass = effect.effect in ("grade", "acceleration", "copper_loss")
        if of_mass and robot.body.mass is None and not effect.candidate:
            message = f"'{effect.effect}' needs the robot's mass, which counts as 1 kg here"
            allowed = "body: {mass: …}, unless k was fitted without it"
            check.add((*where, "effect"), message, "no body.mass", allowed, warning=True)
        if effect.power is not None:
            check.formulas({(*where, "power"): effect.power}, effect.parameters, effect.parameters)
        else:
            _library_effect(check, where, effect, components)


def _library_effect(check: Checker, where: Where, effect: EffectSpec, components: list[str]) -> None:
    from missionsim.effects.library import effect_ids, get_effect

    identifier = str(effect.effect)
    family, colon, of = identifier.partition(":")
    try:
        surfaces = tuple(name[2:] for name in effect.parameters if name.startswith("k_"))
        found = get_effect(identifier, surfaces)
    except InputError:
        ids = effect_ids()
        hint = did_you_mean(family, [item.partition(":")[0] for item in ids])
        message = f"no effect '{identifier}' in the library"
        check.add((*where, "effect"), message, f"'{identifier}'", ", ".join(ids), hint)
        return
    if colon and family.startswith("component_"):
        check.known((*where, "effect"), of, components, "component")
    if effect.candidate:
        return
    _parameters(check, where, effect.parameters, found.parameters, f"effect '{identifier}'")


_READERS = {"slope": {"grade"}, "payload": {"payload", "grade", "acceleration"}}
"""Effects of the library that read the setting; lifting and speeding up read the load as part of the mass."""
_WORDS = {"slope": re.compile(r"\b(slope_rad|theta)\b"), "payload": re.compile(r"\b(payload_kg|mass_kg|m)\b")}


def unread(mission: MissionSpec) -> list[Fault]:
    """Warnings for slopes and payloads that the robot's model does not know, each once, at its first place. `mission`:
    with its robot; without one, or with a faulty one, nothing is said."""
    robot = mission.robot
    if robot is None or not (mission.whole and robot.whole and robot.sound):
        return []
    found: list[Fault] = []
    for setting, advice in (
        ("slope", "effects: [{effect: grade, battery: …, parameters: {k: …}}], or the motion model traction"),
        ("payload", "effects: [{effect: payload, battery: …, parameters: {k: …}}], or the motion model traction"),
    ):
        if _reads(robot, setting):
            continue
        for document, where, value in _given(mission, setting):
            message = f"this {setting} costs nothing: no term of robot '{robot.name}' depends on it"
            found.append(document.fault(where, message, got=value, allowed=advice, severity="warning"))
            break
    return found


def _reads(robot: RobotSpec, setting: str) -> bool:
    if robot.motion is not None and robot.motion.model not in ("polynomial", "expression", "none"):
        # models of other packages count as reading all
        return True
    if any(effect.effect in _READERS[setting] for effect in robot.effects if not effect.candidate):
        return True
    formulas = [effect.power for effect in robot.effects if not effect.candidate]
    if robot.motion is not None:
        formulas += [robot.motion.power, robot.motion.standing]
    formulas += [load.law.power for part in robot.components.values() for load in part.loads if load.law is not None]
    return any(_WORDS[setting].search(text) for text in formulas if text)


def _given(mission: MissionSpec, setting: str) -> Iterator[tuple[Any, Where, str]]:
    """Document, path and text of each value that is not zero."""
    document = mission.document
    if setting == "payload" and mission.defaults.payload is not None and mission.defaults.payload.value:
        yield document, ("defaults", "payload"), f"{mission.defaults.payload.value:g} kg"
    by_place = False
    for segment in flat_segments(mission.segments):
        by_place |= bool(getattr(segment, "to", None) or getattr(segment, "along", None))
        value = getattr(segment, setting, None)
        if value is not None and value.value:
            text = f"{value.value:.4g} rad" if setting == "slope" else f"{value.value:g} kg"
            yield document, (*segment.where, setting), text
    if setting == "slope" and by_place and mission.environment is not None:
        for index, edge in enumerate(mission.environment.edges):
            if edge.slope.value:
                yield mission.environment.document, ("edges", index, "slope"), f"{edge.slope.value:.4g} rad"
