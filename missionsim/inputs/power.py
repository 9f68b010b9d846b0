"""From a robot file to its power model: every load, table, law and effect becomes a term with named parameters; floors
that the model does not know."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, cast

from missionsim.effects import base_terms
from missionsim.effects.base import Effect, ParameterSpec
from missionsim.effects.library import FLOORS, get_effect
from missionsim.effects.model import ModelParameter, PowerModel, Term, TermKey
from missionsim.effects.named_models import get_motion_model, law_models
from missionsim.errors import Fault, did_you_mean
from missionsim.expressions import Place, compile_expression
from missionsim.inputs.check_robot import law_parameters
from missionsim.inputs.mission import RobotAtSite
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.robot import ComponentSpec, EffectSpec, LoadSpec, RobotSpec
from missionsim.inputs.segments import SegmentSpec
from missionsim.inputs.tree import Document, Where
from missionsim.physics.lag import Meter
from missionsim.runs.covariates import MOTION


def build_power_model(robot: RobotSpec) -> PowerModel:
    """The power model of a robot.

    `robot`: a checked robot file. Gives base terms (motion, components, switchboards, processor) and the robot's added
    effects. Raises InputError: for a motion model or effect that is not known, or parameters that it lacks.
    """
    constants = {"regeneration": robot.body.regeneration.value}
    if robot.body.mass is not None:
        constants["body_mass_kg"] = robot.body.mass.value
    terms: list[Term] = []
    counts: Counter[TermKey] = Counter()
    for term in itertools.chain(_motion(robot), _components(robot), _boards(robot), _effects(robot)):
        counts[term.key] += 1
        count, key = counts[term.key], term.key
        if count > 1:  # a second one of the same name on a battery gets a number
            names = {p: f"{term.name_of(p)} {count}" for p in term.parameters}
            term = replace(term, key=key._replace(name=f"{key.name} {count}"), names=names)
        terms.append(term)
    for name, battery in robot.batteries.items():
        voltage = f"voltage_{name}_v"
        if battery.nominal_voltage is not None and any(voltage in term.effect.needs for term in terms):
            constants[voltage] = battery.nominal_voltage.value  # a mission knows no other
    # ranges and floors that the runs behind the base and the added effects covered together
    known: dict[str, tuple[float, float]] = {}
    floors: set[str] = set()
    for origin in [robot.origin, *(spec.origin for spec in robot.effects if not spec.candidate)]:
        ranges = cast("dict[str, list[Any]]", origin.get("range", {}))  # checked as the file was read
        floors |= set(ranges.get("surface", ()))
        for name, limits in ranges.items():
            if name != "surface":
                low, high = map(float, limits)
                before = known.get(name, (low, high))
                known[name] = (min(low, before[0]), max(high, before[1]))
    # units of components that each scheme requires; not a number where it may use them
    switching = {}
    for name, scheme in robot.schemes.items():
        required, allowed = scheme.sensor_rules()
        switching[name] = {component: float(required.get(component, "nan")) for component in allowed}
    back = model_parameter(robot.body.regeneration) if robot.body.regeneration.value > 0.0 else None
    meters = {n: Meter(b.meter.delay.value, b.meter.lag.value) for n, b in robot.batteries.items() if b.meter}
    return PowerModel(
        tuple(terms),
        tuple(robot.batteries),
        constants,
        back,
        switching,
        known=known,
        # where something is by floor, the check of the mission has told of others
        floors=frozenset() if floors_priced(robot) else frozenset(floors),
        meters=meters,
    )


_COMPARED = re.compile(r"""\bsurface\s*[=!]=\s*(["'])(.*?)\1|(["'])((?:(?!\3).)*)\3\s*[=!]=\s*surface\b""")


def floors_priced(robot: RobotSpec) -> set[str]:
    """Floors that a parameter or a formula of the robot's model names."""
    effects = [effect for effect in robot.effects if not effect.candidate]
    found: set[str] = set()
    for effect in effects:
        family, _, floor = (effect.effect or "").partition(":")
        if family in FLOORS:
            found |= {floor} if floor else {name[2:] for name in effect.parameters if name.startswith("k_")}
    motion = robot.motion
    formulas = [effect.power for effect in effects] + ([motion.power, motion.standing] if motion is not None else [])
    formulas += [load.law.power for part in robot.components.values() for load in part.loads if load.law is not None]
    for text in formulas:
        found |= {one[2] or one[4] for one in _COMPARED.finditer(text or "")}
    return found - {"", None}


def model_parameter(parameter: Parameter, unit: str = "") -> ModelParameter:
    """A number of a file as a parameter of the model."""
    p, low, high = parameter, parameter.low, parameter.high
    limits = (-float("inf") if low is None else low, float("inf") if high is None else high)
    told = (p.status, p.source, p.path)
    return ModelParameter(p.value, unit or p.unit, p.sd, *limits, *told, distribution=p.distribution)


def build_effect(spec: EffectSpec, robot: RobotSpec | None = None) -> Effect:
    """The effect that one entry of a robot's ``effects:`` names or writes out; messages tell its place in `robot`."""
    path = (*spec.where, "power" if spec.effect is None else "effect")
    place = Place() if robot is None else robot.document.place(path)
    if spec.effect is not None:
        surfaces = tuple(name[2:] for name in spec.parameters if name.startswith("k_"))
        effect = get_effect(spec.effect, surfaces, spec.battery)
    else:
        formula = compile_expression(spec.power or "", **place._asdict())
        given = {name: model_parameter(p) for name, p in spec.parameters.items()}
        specs = tuple(ParameterSpec(name, p.unit, low=p.low, high=p.high, default=p.value) for name, p in given.items())
        drive = not formula.names.isdisjoint(MOTION | {"v", "a", "w", "u"})
        effect = base_terms.expression_term(spec.name or "", formula, specs, drive=drive)
    return replace(effect, component=spec.component or effect.component, place=place)


def _converted(parameters: Mapping[str, Parameter], specs: tuple[ParameterSpec, ...]) -> dict[str, ModelParameter]:
    units = {spec.name: spec.unit for spec in specs}
    return {
        name: model_parameter(p, units.get(name, "") if p.unit in ("", "1") else p.unit)
        for name, p in parameters.items()
    }


def _complete(parameters: Mapping[str, Parameter], specs: tuple[ParameterSpec, ...]) -> dict[str, ModelParameter]:
    """Parameters, which were checked as the file was read, with the defaults of those that are left out."""
    given = _converted(parameters, specs)
    defaults = {
        spec.name: ModelParameter(spec.default, spec.unit, 0.0, spec.low, spec.high, "assumed", "default")
        for spec in specs
        if spec.name not in given and not spec.optional
    }
    return {**given, **defaults}


def _motion(robot: RobotSpec) -> Iterator[Term]:
    motion = robot.motion
    if motion is None or motion.model == "none":
        return
    if motion.model != "expression":
        model = get_motion_model(motion.model)
        yield from model.build(motion.battery, _converted(motion.parameters, model.parameters))
        return
    parameters = {name: model_parameter(p) for name, p in motion.parameters.items()}
    place, at_rest = (robot.document.place(("motion", key)) for key in ("power", "standing"))
    formula = compile_expression(motion.power or "", **place._asdict())
    standing = None if motion.standing is None else compile_expression(motion.standing, **at_rest._asdict())
    for effect in base_terms.motion_expression_terms(formula, standing, tuple(parameters)):
        used = {spec.name: parameters[spec.name] for spec in effect.parameters}
        key = TermKey(motion.battery, effect.component, effect.id)
        yield Term(key, replace(effect, place=place), used, {name: name for name in used})


def _components(robot: RobotSpec) -> Iterator[Term]:
    for name, component in robot.components.items():
        # path and value of the efficiency of the converter that a load hangs on
        through = [robot.links[load.through].efficiency if load.through else None for load in component.loads]
        links = [("", 1.0) if efficiency is None else (efficiency.path, efficiency.value) for efficiency in through]
        for load, link in zip(component.loads, links, strict=True):
            effect, parameters = _load(name, component, load, robot.document.place((*load.where, "law", "power")))
            names = {p: f"{name}.{p}" for p in parameters}
            yield Term(TermKey(load.battery, name, name), effect, parameters, names, scale=1.0 / link[1], link=link)
        if component.startup is not None and component.startup.power is not None:
            effect = base_terms.component_term(name, starting=True)
            parameters, names = {"power": model_parameter(component.startup.power)}, {"power": f"{name}.startup_power"}
            key = TermKey(component.loads[0].battery, name, f"{name} start-up")
            yield Term(key, effect, parameters, names, scale=1.0 / links[0][1], link=links[0])


def _load(
    name: str, component: ComponentSpec, load: LoadSpec, place: Place
) -> tuple[Effect, dict[str, ModelParameter]]:
    if load.power is not None:
        effect = base_terms.component_term(name, always_on=component.always_on)
        # an always-on component counts all its units
        power = load.power.scaled(component.units, load.power.unit) if component.always_on else load.power
        return effect, {"power": replace(model_parameter(power), times=component.units if component.always_on else 1.0)}
    law = load.law
    assert law is not None  # the file was checked: a load has either
    if law.model is not None:
        model = law_models()[law.model]
        given = _complete(law_parameters(law), model.parameters)
        column = "" if component.always_on else f"on_{name}"
        effect = base_terms.load_term(
            "law", name, model.equation, "robot file", "by its law", model.parameters, model.power, column, model.needs
        )
        return replace(effect, place=place), given
    formula = compile_expression(law.power or "", **place._asdict())
    given = {key: model_parameter(p) for key, p in law_parameters(law).items()}
    specs = tuple(ParameterSpec(key, p.unit, low=p.low, high=p.high) for key, p in given.items())
    return replace(base_terms.law_term(name, formula, specs, component.always_on), place=place), given


def _boards(robot: RobotSpec) -> Iterator[Term]:
    """Switchboards, and the processor."""
    for name, board in robot.switchboards.items():
        relays = tuple(key for key, component in robot.components.items() if component.relay == name)
        effect = base_terms.switchboard_term(name, len(board.power), relays)
        parameters = {f"relays_{i}": model_parameter(p) for i, p in enumerate(board.power)}
        yield Term(TermKey(board.battery, name, name), effect, parameters, {p: f"{name}.{p}" for p in parameters})
    if robot.processor is None:
        return
    entries: list[tuple[str, str, Mapping[str, int], str]] = []
    given: dict[str, ModelParameter] = {}
    for scheme, spec in robot.schemes.items():
        # among rows that are equally near, the larger power is the careful choice: it is met first
        for row in sorted(spec.processor, key=lambda row: -row.power.value):
            sensors = {key: count for key, count in row.sensors.items() if count}
            label = "+".join(f"{count}{key}" for key, count in sorted(sensors.items())) or "none"
            name = ".".join(("processor", scheme, row.navigation or "any", label))
            entries.append((scheme, row.navigation or "", sensors, name))
            given[name] = model_parameter(row.power)
    columns = tuple(sorted({f"on_{key}" for entry in entries for key in entry[2]}))
    idle = None if robot.processor.idle is None else "processor.idle"
    if robot.processor.idle is not None:
        given["processor.idle"] = model_parameter(robot.processor.idle)
    if given:
        effect = base_terms.processor_term(tuple(entries), columns, idle, robot.processor.fallback == "refuse")
        yield Term(TermKey(robot.processor.battery, "processor", "processor"), effect, given, {n: n for n in given})


def _effects(robot: RobotSpec) -> Iterator[Term]:
    for spec in robot.effects:
        if spec.candidate:
            continue
        effect = build_effect(spec, robot)
        if effect.execution:
            continue
        label = spec.name or effect.id
        parameters = _complete(spec.parameters, effect.parameters)
        names = {name: f"{label}.{name}" for name in parameters}
        yield Term(TermKey(spec.battery, effect.component, label), effect, parameters, names, base=False)


def strange_floors(site: RobotAtSite, segments: Iterable[SegmentSpec] = ()) -> Iterator[Fault]:
    """Warnings for floors that neither the model nor the logs behind it name, each once: they cost what the base does.

    `site`: a mission or a task. `segments`: those of the mission, blocks written out. Nothing is said where nothing in
    the robot's file is by floor.
    """
    robot, environment = site.robot, site.environment
    if robot is None or not (site.whole and robot.whole and robot.sound) or not (priced := floors_priced(robot)):
        return
    origins = [robot.origin, *(effect.origin for effect in robot.effects if not effect.candidate)]
    ranges = [cast("dict[str, list[Any]]", origin.get("range", {})) for origin in origins]
    known = sorted(priced.union(*(one.get("surface", ()) for one in ranges)))
    places: list[tuple[Document, Where, str | None]]
    places = [(site.document, (*segment.where, "surface"), segment.surface) for segment in segments]
    places.insert(0, (site.document, ("defaults", "surface"), site.defaults.surface))
    if environment is not None:
        places.append((environment.document, ("ambient", "surface"), environment.ambient.surface))
        edges = enumerate(environment.edges)
        places += [(environment.document, ("edges", index, "surface"), edge.surface) for index, edge in edges]
    told = set(known)
    for document, where, floor in places:
        if floor is None or floor in told:
            continue
        told.add(floor)
        message = f"floor '{floor}' costs no more than the base: nothing of robot '{robot.name}' names it"
        base = "floors on which the base holds stand in the robot's origin: {range: {surface: […]}}"
        allowed, hint = f"{', '.join(known)}; {base}", did_you_mean(floor, known)
        yield document.fault(where, message, got=floor, allowed=allowed, hint=hint, warning=True)
