"""Checks across the parts of a robot file."""

from __future__ import annotations

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from missionsim.effects.base import ParameterSpec
from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.expressions import compile_expression
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.robot import LawSpec, RobotSpec, SchemeSpec
from missionsim.inputs.tree import Where
from missionsim.inputs.units import same_dimension
from missionsim.inputs.validation import Checker


def law_parameters(law: LawSpec) -> dict[str, Parameter]:
    """Numbers of a law, its rate among them."""
    return law.parameters if law.rate is None else {**law.parameters, "rate": law.rate}


def check_robot(robot: RobotSpec) -> list[Fault]:
    """Batteries, links, relays, requirements, sensors of schemes, formulas, motion model and effects."""
    check = Checker(robot.document)
    boards, processor = robot.switchboards, robot.processor
    fed: list[tuple[Where, str]] = [(("links", name), link.battery) for name, link in robot.links.items()]
    fed += [(("switchboards", name), board.battery) for name, board in boards.items()]
    fed += [(("processor",), processor.battery)] if processor is not None else []
    fed += [(("motion",), robot.motion.battery)] if robot.motion is not None else []
    fed += [(("effects", index), effect.battery) for index, effect in enumerate(robot.effects)]
    for where, battery in fed:
        check.named((*where, "battery"), battery, "batteries", "battery")
    for name, spec in robot.batteries.items():
        if spec.initial_charge.value <= spec.reserve.value and spec.reserve.value > 0:
            got, allowed = f"{spec.initial_charge.value:g}", f"more than {spec.reserve.value:g}"
            message = "starts at or below its reserve"
            check.add(("batteries", name, "initial_charge"), message, got, allowed, warning=True)
    _components(check, robot)
    for name, board in boards.items():
        hung = [key for key, component in robot.components.items() if component.relay == name]
        count = sum(robot.components[key].units for key in hung)
        if count > len(board.power) - 1:
            message = f"switchboard has power for {len(board.power) - 1} relays only"
            allowed = f"{count + 1} powers, for 0 to {count} relays"
            check.add(("switchboards", name, "power"), message, f"{count} units: {', '.join(hung)}", allowed)
    for name, scheme in robot.schemes.items():
        _scheme(check, robot, ("schemes", name), scheme)
    if robot.idle_scheme is not None:
        check.named(("idle_scheme",), robot.idle_scheme, "schemes", "control scheme")
    _motion(check, robot)
    _effects(check, robot)
    return check.faults


def _components(check: Checker, robot: RobotSpec) -> None:
    for name, component in robot.components.items():
        where: Where = ("components", name)
        for index, load in enumerate(component.loads):
            at, law = (*where, "loads", index), load.law
            fed = check.named((*at, "battery"), load.battery, "batteries", "battery")
            if load.through is not None and check.named((*at, "through"), load.through, "links", "link"):
                link = robot.links.get(load.through)
                if link is not None and link.battery != load.battery and fed:
                    message = f"link '{load.through}' is fed by another battery"
                    check.add((*at, "battery"), message, load.battery, link.battery)
            own = {} if law is None else law_parameters(law)
            if law is not None and law.rate is not None and "rate" in law.parameters:
                check.add((*at, "law", "rate"), "a rate beside a parameter 'rate'", "both", "one of them", key=True)
            if law is not None and law.power is not None:
                check.formulas({(*at, "law", "power"): law.power}, own)
            elif law is not None and law.model is not None:
                from missionsim.effects.named_models import law_models

                laws = law_models()
                if check.known((*at, "law", "model"), law.model, laws, "law"):
                    specs = laws[law.model].parameters
                    _parameters(check, (*at, "law"), own, specs, f"law '{law.model}'")
        if component.relay is not None:
            check.named((*where, "relay"), component.relay, "switchboards", "switchboard")
        for index, other in enumerate(component.requires):
            check.named((*where, "requires", index), other, "components", "component")
    needs = {name: list(component.requires) for name, component in robot.components.items()}
    while circle := _circle(needs):
        at = ("components", circle[-2], "requires", robot.components[circle[-2]].requires.index(circle[-1]))
        message = "components require each other in a circle"
        check.add(at, message, " → ".join(circle), "requirements without a circle")
        for name in (knot := circle[1:]):  # with all that they lead to, where each further circle is the same mistake
            knot += needs.pop(name, ())


def _circle(needs: Mapping[str, list[str]]) -> list[str]:
    """Names of which each needs the next, back to the first; empty where no needs lead back."""
    try:
        TopologicalSorter(needs).prepare()
    except CycleError as error:
        return list(error.args[1][::-1])
    return []


def _scheme(check: Checker, robot: RobotSpec, where: Where, scheme: SchemeSpec) -> None:
    missing = "the scheme requires '{}', which the robot does not have"
    given: list[tuple[Where, Mapping[str, int], str]] = []
    for at, rules in [
        ((*where, "sensors"), scheme.sensors),
        *(((*where, "navigation", key), rules) for key, rules in scheme.navigation.items()),
    ]:
        given += [((*at, "required"), rules.required, missing), ((*at, "optional"), rules.optional, "")]
    given.append(((*where, "default_sensors"), scheme.default_sensors, ""))
    given += [((*where, "processor", i, "sensors"), row.sensors, "") for i, row in enumerate(scheme.processor)]
    for at, sensors, message in given:
        for sensor, count in sensors.items():
            check.units((*at, sensor), sensor, count, robot, message=message.format(sensor))
    if scheme.default_navigation is not None:
        check.known((*where, "default_navigation"), scheme.default_navigation, scheme.navigation, "navigation")
    if scheme.processor and "processor" not in robot.document.names():
        message = "the robot has no processor that this table could be for"
        check.add((*where, "processor"), message, "", "processor: {battery: …} in the robot", key=True)
    if scheme.motion and scheme.image_analysis:
        message = "image analysis is done standing"
        check.add((*where, "image_analysis"), message, "motion: true", "motion: false", key=True)
    seen: dict[tuple[str | None, tuple[tuple[str, int], ...]], int] = {}
    for index, row in enumerate(scheme.processor):
        at = (*where, "processor", index)
        if row.navigation is not None:
            check.known((*at, "navigation"), row.navigation, scheme.navigation, "navigation of this scheme")
        label = (row.navigation, tuple(sorted((key, count) for key, count in row.sensors.items() if count)))
        if label in seen:
            check.add(at, f"same configuration as row {seen[label]}", allowed="one power per configuration")
        seen.setdefault(label, index)


def _motion(check: Checker, robot: RobotSpec) -> None:
    motion = robot.motion
    if motion is None or motion.model == "none":
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
    present = {*given, *check.document.names(*where, "parameters")}
    for name, spec in known.items():
        if name not in present and spec.required:
            message, allowed = f"parameter '{name}' of {what} is missing", f"{name}: {spec.meaning}, {spec.unit}"
            check.add((*where, "parameters"), message, "", allowed, key=True)


def _effects(check: Checker, robot: RobotSpec) -> None:
    seen: dict[str, int] = {}
    for index, effect in enumerate(robot.effects):
        where: Where = ("effects", index)
        label = f"{effect.battery}/{effect.name or effect.effect}"
        if label in seen:
            twice = f"effect '{effect.name or effect.effect}' given twice on this battery"
            check.add(where, f"{twice}; the first is item {seen[label]}", "", "a 'name' of its own for each")
        seen.setdefault(label, index)
        of_mass = effect.effect in ("grade", "acceleration", "copper_loss")
        massless = robot.body.mass is None and not check.document.is_faulty(("body", "mass"))
        if of_mass and massless and not effect.candidate:
            message = f"'{effect.effect}' needs the robot's mass, which counts as 1 kg here"
            allowed = "body: {mass: …}, unless k was fitted without it"
            check.add((*where, "effect"), message, "no body.mass", allowed, warning=True)
        if effect.power is not None:
            before = len(check.faults)
            check.formulas({(*where, "power"): effect.power}, effect.parameters, effect.parameters)
            first = next(iter(effect.parameters), "")
            alone = effect.candidate and first and len(check.faults) == before
            if alone and not compile_expression(effect.power).proportional_to(first):
                message = f"the power is not proportional to '{first}', the first parameter, which is fitted"
                check.add((*where, "power"), message, effect.power[:80], f"{first} * …")
            continue
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
            continue
        if colon and family.startswith("component_"):
            check.known((*where, "effect"), of, robot.document.names("components"), "component")
        if not effect.candidate:
            _parameters(check, where, effect.parameters, found.parameters, f"effect '{identifier}'")
