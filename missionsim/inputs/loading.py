"""Files to checked, frozen models; all faults of all files at once."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.inputs import overrides as override_rules
from missionsim.inputs.base import FileModel
from missionsim.inputs.check_mission import check_mission
from missionsim.inputs.check_robot import unread
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.examples import files_near, find_robot, unknown_robot
from missionsim.inputs.mission import MissionSpec, StudySpec
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.tree import Document, as_written, parse_document, read_document
from missionsim.inputs.validation import validate_document

if TYPE_CHECKING:
    from missionsim.inputs.log_map import MapSpec
    from missionsim.inputs.task import TaskSpec

KINDS = ("robot", "environment", "mission", "study", "map", "task")
Override = tuple[str, Any]
Loaded = TypeVar("Loaded", bound=FileModel)
Joined = TypeVar("Joined", MissionSpec, "TaskSpec")
_REMEMBERED: ContextVar[dict[Any, Any] | None] = ContextVar("remembered", default=None)


@contextlib.contextmanager
def remembered() -> Iterator[None]:
    """Meanwhile, files are read once: alternatives of a mission share what none of them changes."""
    token = _REMEMBERED.set({})
    try:
        yield
    finally:
        _REMEMBERED.reset(token)


def load_robot(name_or_path: str | os.PathLike[str], overrides: Sequence[Override] = ()) -> RobotSpec:
    """Load a shipped robot by name, or a robot file.

    Parameters
    ----------
    name_or_path : str or path-like
        ``pioneer3dx`` or a path.
    overrides : sequence of (path, value)
        Values to set first, such as ``("batteries.robot.capacity", "100 Wh")``.

    Raises
    ------
    InputError
        All faults of the file.
    """
    path = find_robot(str(name_or_path), None)
    if path is None:
        raise InputError(unknown_robot(str(name_or_path), None, ()))
    return _finished(path, RobotSpec, overrides)


def robot_from_text(text: str, name: str = "robot") -> RobotSpec:
    """A robot from the text of its file; `name` is what messages call it."""
    return _finished(Path(name), RobotSpec, (), parse_document(text, name=name))


def mission_from_text(text: str, robot: RobotSpec, name: str = "mission") -> MissionSpec:
    """A mission of a loaded robot from the text of its file; see `robot_from_text`."""
    faults: list[Fault] = []
    return _finish(_load_joined(Path(name), MissionSpec, faults, (), robot, parse_document(text, name=name)), faults)


def load_environment(path: str | os.PathLike[str], overrides: Sequence[Override] = ()) -> EnvironmentSpec:
    """Load an environment file; see `load_robot`."""
    return _finished(Path(path), EnvironmentSpec, overrides)


def load_mission(
    path: str | os.PathLike[str],
    overrides: Sequence[Override] = (),
    robot: str | os.PathLike[str] | RobotSpec | None = None,
) -> MissionSpec:
    """Load a mission with its robot and environment.

    Parameters
    ----------
    path : path-like
        Mission file.
    overrides : sequence of (path, value)
        What to set first; ``robot.…`` and ``environment.…`` lead into those files.
    robot : str, path-like or RobotSpec, optional
        Robot in place of the mission's own.

    Raises
    ------
    InputError
        All faults of all files.
    """
    faults: list[Fault] = []
    return _finish(_load_joined(Path(path), MissionSpec, faults, overrides, robot), faults)


def load_study(path: str | os.PathLike[str]) -> StudySpec:
    """Load a study file; its `mission` stays a path relative to it (`mission_path`)."""
    return _finished(Path(path), StudySpec)


def load_map(path: str | os.PathLike[str]) -> MapSpec:
    """Load a map for ``missionsim import``; faults in its formulas are told too."""
    from missionsim.inputs.log_map import MapSpec

    return _finished(Path(path), MapSpec)


def load_task(
    path: str | os.PathLike[str], overrides: Sequence[Override] = (), robot: str | os.PathLike[str] | None = None
) -> TaskSpec:
    """Load a task with its robot and environment; see `load_mission`."""
    from missionsim.inputs.task import TaskSpec

    faults: list[Fault] = []
    return _finish(_load_joined(Path(path), TaskSpec, faults, overrides, robot), faults)


def model_of(kind: str) -> type[FileModel]:
    """Model of a kind of file, one of `KINDS`."""
    if kind in ("map", "task"):
        # only few commands need them; every run would pay for them
        from missionsim.inputs.log_map import MapSpec
        from missionsim.inputs.task import TaskSpec

        return MapSpec if kind == "map" else TaskSpec
    known: dict[str, type[FileModel]] = {
        "robot": RobotSpec,
        "environment": EnvironmentSpec,
        "mission": MissionSpec,
        "study": StudySpec,
    }
    return known[kind]


def check_files(paths: Iterable[str | os.PathLike[str]]) -> list[Fault]:
    """All faults and warnings of all YAML files, sorted, each once (a shared robot is told once)."""
    faults: list[Fault] = []
    for path in paths:
        document = _read(Path(path), faults)
        if document is None:
            continue
        kind = document.data.get("kind") if isinstance(document.data, dict) else None
        if kind == "mission":
            _load_joined(Path(path), MissionSpec, faults, document=document)
        elif kind == "task":
            from missionsim.inputs.task import TaskSpec

            _load_joined(Path(path), TaskSpec, faults, document=document)
        elif kind == "study":
            study = _load(Path(path), StudySpec, faults, document=document)
            if study is not None and study.whole:
                target = Path(path).parent / study.mission
                if _is_file(target):
                    _check_study(study, target, faults)
                else:
                    faults.append(document.fault(("mission",), "no such mission file", got=as_written(study.mission)))
        elif isinstance(kind, str) and kind in KINDS:
            _load(Path(path), model_of(kind), faults, document=document)
        else:
            faults.append(_kind_fault(document, KINDS))
    return sorted(set(faults))


def _finished(
    path: Path, model: type[Loaded], overrides: Sequence[Override] = (), document: Document | None = None
) -> Loaded:
    faults: list[Fault] = []
    return _finish(_load(path, model, faults, overrides, document), faults)


def _finish(model: Loaded | None, faults: list[Fault]) -> Loaded:
    errors = [fault for fault in faults if fault.severity == "error"]
    if errors or model is None:
        raise InputError(sorted(set(errors)))
    model._warnings = tuple(sorted(set(faults)))
    return model


def _read(path: Path, faults: list[Fault]) -> Document | None:
    known = _REMEMBERED.get()
    try:
        shared = read_document(path) if known is None or path not in known else known[path]
    except InputError as problem:
        faults.extend(problem.faults)
        return None
    if known is not None:
        known[path] = shared
    return dataclasses.replace(shared, overrides={})


def _kind_fault(document: Document, kinds: Sequence[str]) -> Fault:
    data, allowed = document.data, "kind: " + " | ".join(kinds)
    if not isinstance(data, dict):
        # not what the file holds: a mission of somebody else may name any file as its robot
        sort = "a list" if isinstance(data, list) else "nothing" if data is None else "one value"
        return document.fault((), "the file must hold a mapping", got=sort, allowed=allowed)
    if "kind" not in data:
        return document.fault((), "'kind' is missing", allowed=allowed)
    kind, message = data["kind"], "not the kind of file that is needed here"
    hint = did_you_mean(kind, kinds) if isinstance(kind, str) else ""
    return document.fault(("kind",), message, got=as_written(kind), allowed=", ".join(kinds), hint=hint)


def _load(
    path: Path,
    model: type[Loaded],
    faults: list[Fault],
    overrides: Sequence[Override] = (),
    document: Document | None = None,
    prefix: str = "",
) -> Loaded | None:
    """Read, set overrides, validate, run the checks; None where the file is too broken to say more."""
    known = None if document is not None or overrides else _REMEMBERED.get()
    key = (path, model, prefix)
    if known is not None and key in known:
        loaded: Loaded | None
        loaded, told = known[key]
        faults.extend(told)
        return loaded
    found: list[Fault] = []
    result = None
    document = document or _read(path, found)
    if document is not None:
        document.prefix = prefix
        found += override_rules.apply(document, overrides)
        kind = get_args(model.model_fields["kind"].annotation)[0]
        if isinstance(document.data, dict) and document.data.get("kind") == kind:
            result = validate_document(document, model, found)
        else:
            found.append(_kind_fault(document, (kind,)))
    if result is not None:
        checked = result.faults(result.document)
        result._sound = not any(fault.severity == "error" for fault in checked)
        found += checked
    if known is not None:
        known[key] = result, found
    faults.extend(found)
    return result


def _companions(
    path: Path,
    document: Document,
    faults: list[Fault],
    by_file: dict[str, list[Override]],
    robot: str | os.PathLike[str] | RobotSpec | None,
) -> tuple[RobotSpec | None, EnvironmentSpec | None]:
    """The robot and the environment that a mission or a task names."""
    data = document.data if isinstance(document.data, dict) else {}
    robot_spec = robot if isinstance(robot, RobotSpec) and not by_file["robot"] else None
    reference = data.get("robot") if robot is None else "" if isinstance(robot, RobotSpec) else str(robot)
    if isinstance(robot, RobotSpec) and robot_spec is None:
        robot_spec = _load(robot.path, RobotSpec, faults, by_file["robot"], prefix="robot.")
    elif robot_spec is None and isinstance(reference, str) and (reference or robot is not None):
        found = find_robot(reference, None if robot is not None else path.parent) if reference else None
        if found is None:
            faults.append(unknown_robot(reference, None if robot is not None else document, ("robot",)))
        else:
            robot_spec = _load(found, RobotSpec, faults, by_file["robot"], prefix="robot.")
    environment = None
    reference = data.get("environment")
    if isinstance(reference, str) and reference:
        target = path.parent / reference
        if _is_file(target):
            environment = _load(target, EnvironmentSpec, faults, by_file["environment"], prefix="environment.")
        else:
            message, allowed = "no such environment file", "a path relative to this file"
            hint = did_you_mean(reference, files_near(document.file, reference))
            faults.append(
                document.fault(("environment",), message, got=as_written(reference), allowed=allowed, hint=hint)
            )
    return robot_spec, environment


def _load_joined(
    path: Path,
    model: type[Joined],
    faults: list[Fault],
    overrides: Sequence[Override] = (),
    robot: str | os.PathLike[str] | RobotSpec | None = None,
    document: Document | None = None,
) -> Joined | None:
    """A mission or a task with the robot and the environment that it names, and what the checks of them all find."""
    document = document or _read(path, faults)
    if document is None:
        return None
    by_file = override_rules.route(overrides, document.data)
    made = _load(path, model, faults, by_file[""], document=document)
    companions = _companions(path, document, faults, by_file, robot)
    if made is None:
        return None
    made._robot, made._environment = companions
    spec: Any = made
    if model is MissionSpec:
        spec._overrides = _shown(overrides)
        faults += [*check_mission(spec, spec.document), *unread(spec)]
    else:
        from missionsim.inputs.check_task import check_task

        spec._elsewhere = _shown(
            [(f"{part}.{k}", value) for part in override_rules.ROOTS for k, value in by_file[part]]
        )
        faults += check_task(spec, spec.document)
    return made


def _shown(overrides: Sequence[Override]) -> tuple[tuple[str, str], ...]:
    return tuple((key, value if isinstance(value, str) else repr(value)) for key, value in overrides)


def _check_study(study: StudySpec, target: Path, faults: list[Fault]) -> None:
    """Each alternative must lead to a valid mission."""
    common = list(study.baseline.items())
    first: list[Fault] = []
    made = _load_joined(target, MissionSpec, first, common, study.robot)
    if made is None or any(fault.severity == "error" for fault in first):
        faults.extend(first)
        return
    known = set(first)
    cases: list[tuple[tuple[str | int, ...], list[Override], str | None]] = [
        (("alternatives", name), list(item.set.items()), item.robot) for name, item in study.alternatives.items()
    ]
    cases += [
        (("vary", key, index), [(key, value)], None)
        for key, values in study.vary.items()
        for index, value in enumerate(values)
    ]
    for where, extra, robot in cases:
        found: list[Fault] = []
        _load_joined(target, MissionSpec, found, [*common, *extra], robot or study.robot)
        line, column = study.document.position(where)
        for fault in [fault for fault in found if fault not in known]:
            here = dataclasses.replace(fault, file=study.document.file, line=line, column=column)
            faults.append(fault if fault.file else here)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
