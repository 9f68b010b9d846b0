"""Files to checked, frozen models, all faults of all files at once; the files that come with missionsim."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.files import PathLike, atomic_write
from missionsim.inputs import overrides as override_rules
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.tree import Document, Where, as_written, parse_document, read_document
from missionsim.inputs.validation import validate_document

if TYPE_CHECKING:
    from missionsim.inputs.base import FileModel
    from missionsim.inputs.environment import EnvironmentSpec
    from missionsim.inputs.log_map import MapSpec
    from missionsim.inputs.mission import MissionSpec, StudySpec
    from missionsim.inputs.task import TaskSpec


PARTS = ("missions", "environments", "docs", "robots")
"""Folders that `write_examples` writes; README's commands run beside them."""

_PACKAGE = Path(__file__).resolve().parents[1]
_ROBOTS = _PACKAGE / "robots"


def examples_folder() -> Path:
    """The folder that holds ``missions``, ``environments`` and ``docs``: of the wheel, or the clone. Raises InputError:
    where missionsim is installed without them."""
    for base in (_PACKAGE / "examples", _PACKAGE.parent):
        if (base / "missions" / "pioneer3dx").is_dir():
            return base
    raise InputError.single("this installation lacks its missions", allowed="a wheel built from the repository")


def example_files() -> dict[Path, Path]:
    """Every file that comes with missionsim, by its name in the folder that `write_examples` makes."""
    base = examples_folder()
    return {
        Path(part) / path.relative_to(folder): path
        for part in PARTS
        for folder in (_PACKAGE / part if part == "robots" else base / part,)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def write_examples(out: Path) -> list[Path]:
    """Copy missions, environments, docs (with example logs and maps) and the shipped robots into a folder.

    `out`: made if need be. Files of the same name and content are left alone. Gives every file, relative to `out`.
    Raises InputError: where a file of that name has another content; nothing is written then.
    """
    sources = example_files()
    there = {name: out / name for name in sources if (out / name).exists()}
    changed = [n for n, own in there.items() if not own.is_file() or own.read_bytes() != sources[n].read_bytes()]
    if changed:
        raise InputError([Fault(str(out / name), 0, 0, "there is another file of this name") for name in changed])
    for name, path in sources.items():
        if name not in there:
            with atomic_write(out / name) as temporary:
                shutil.copyfile(path, temporary)
    return list(sources)


def shipped_robots() -> dict[str, Path]:
    """Names of the robots that come with missionsim, and their files."""
    return {path.stem: path for path in sorted(_ROBOTS.glob("*.yaml"))}


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that cannot be one is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find_robot(reference: str, folder: Path | None = None) -> Path | None:
    """File of a robot named by a shipped name or a path (relative to `folder`), or None."""
    shipped = _ROBOTS / f"{reference}.yaml"
    if reference.replace("_", "").isalnum() and shipped.is_file():
        return shipped
    candidate = Path(reference) if folder is None else folder / reference
    return candidate if is_file(candidate) else None


def robot_file(name_or_path: PathLike) -> Path:
    """File of a shipped robot, or the path. Raises InputError: no such robot."""
    found = find_robot(str(name_or_path))
    if found is None:
        raise InputError(unknown_robot(str(name_or_path)))
    return found


def files_near(file: str, reference: str) -> list[str]:
    """The YAML files in the folder that a file refers to, named as it would."""
    folder = os.path.dirname(reference)
    try:
        names = sorted(os.listdir(os.path.join(os.path.dirname(file), folder) or "."))
    except OSError:
        return []
    return [os.path.join(folder, name) for name in names if name.endswith((".yaml", ".yml"))]


def unknown_robot(reference: str, document: Document | None = None, path: Where = ()) -> Fault:
    """The fault of a robot that is not there, at the place in a file that names it."""
    names = list(shipped_robots())
    told, allowed = f"no robot '{reference}'", ", ".join(names) + ", or the path of a robot file"
    if document is None:
        return Fault("", 0, 0, told, got=reference, allowed=allowed, hint=did_you_mean(reference, names))
    hint = did_you_mean(reference, [*names, *files_near(document.file, reference)])
    return document.fault(path, told, got=as_written(reference), allowed=allowed, hint=hint)


KINDS = {
    "robot": "robot.RobotSpec",
    "environment": "environment.EnvironmentSpec",
    "mission": "mission.MissionSpec",
    "study": "mission.StudySpec",
    "map": "log_map.MapSpec",
    "task": "task.TaskSpec",
}
"""Where the model of each kind of file is."""
Override = tuple[str, Any]
RobotLike = PathLike | RobotSpec
_REMEMBERED: ContextVar[dict[Any, Any] | None] = ContextVar("remembered", default=None)


@contextlib.contextmanager
def remembered() -> Iterator[None]:
    """Meanwhile, files are read once: alternatives of a mission share what none of them changes."""
    token = _REMEMBERED.set({})
    try:
        yield
    finally:
        _REMEMBERED.reset(token)


def load_robot(name_or_path: PathLike, overrides: Sequence[Override] = ()) -> RobotSpec:
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
    return cast("RobotSpec", _finished(robot_file(name_or_path), "robot", overrides))


def robot_from_text(text: str, name: str = "robot") -> RobotSpec:
    """A robot from the text of its file; `name` is what messages call it."""
    return cast("RobotSpec", _finished(name, "robot", document=parse_document(text, name=name)))


def mission_from_text(text: str, robot: RobotSpec) -> MissionSpec:
    """A mission of a loaded robot from the text of its file; see `robot_from_text`."""
    return cast("MissionSpec", _finished("mission", "mission", (), robot, parse_document(text, name="mission")))


def load_environment(path: PathLike, overrides: Sequence[Override] = ()) -> EnvironmentSpec:
    """Load an environment file; see `load_robot`."""
    return cast("EnvironmentSpec", _finished(path, "environment", overrides))


def load_mission(path: PathLike, overrides: Sequence[Override] = (), robot: RobotLike | None = None) -> MissionSpec:
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
    return cast("MissionSpec", _finished(path, "mission", overrides, robot))


def load_study(path: PathLike) -> StudySpec:
    """Load a study file; its `mission` stays a path relative to it (`mission_path`)."""
    return cast("StudySpec", _finished(path, "study"))


def load_map(path: PathLike) -> MapSpec:
    """Load a map for ``missionsim import``; faults in its formulas are told too."""
    return cast("MapSpec", _finished(path, "map"))


def load_task(path: PathLike, overrides: Sequence[Override] = (), robot: PathLike | None = None) -> TaskSpec:
    """Load a task with its robot and environment; see `load_mission`."""
    return cast("TaskSpec", _finished(path, "task", overrides, robot))


def model_of(kind: str) -> type[FileModel]:
    """Model of a kind of file, one of `KINDS`; loaded when it is asked for, since no command needs all."""
    module, _, name = KINDS[kind].partition(".")
    return cast("type[FileModel]", getattr(importlib.import_module(f"missionsim.inputs.{module}"), name))


def check_files(paths: Iterable[PathLike]) -> list[Fault]:
    """All faults and warnings of all YAML files, sorted, each once (a shared robot is told once)."""
    faults: list[Fault] = []
    for path in map(Path, paths):
        document = _read(path, faults)
        if document is None:
            continue
        kind = document.data.get("kind") if isinstance(document.data, dict) else None
        if not isinstance(kind, str) or kind not in KINDS:
            faults.append(_kind_fault(document, tuple(KINDS)))
            continue
        made = _load(path, kind, faults, document=document)
        if kind == "study" and made is not None and made.whole:
            _check_study(made, faults)
    return sorted(set(faults))


def _check_study(study: StudySpec, faults: list[Fault]) -> None:
    """Each alternative must lead to a valid mission."""
    target = study.path.parent / study.mission
    if not is_file(target):
        faults.append(study.document.fault(("mission",), "no such mission file", got=as_written(study.mission)))
        return
    common = list(study.baseline.items())
    known: list[Fault] = []
    made = _load(target, "mission", known, common, study.robot)
    if made is None or any(fault.severity == "error" for fault in known):
        faults.extend(known)
        return
    cases: list[tuple[Where, Iterable[Override], str | None]] = [
        (("alternatives", name), item.set.items(), item.robot) for name, item in study.alternatives.items()
    ]
    cases += [
        (("vary", key, index), [(key, value)], None)
        for key, values in study.vary.items()
        for index, value in enumerate(values)
    ]
    for where, extra, robot in cases:
        found: list[Fault] = []
        _load(target, "mission", found, [*common, *extra], robot or study.robot)
        line, column = study.document.position(where)
        for fault in set(found) - set(known):
            here = dataclasses.replace(fault, file=study.document.file, line=line, column=column)
            faults.append(fault if fault.file else here)


def _finished(
    path: PathLike,
    kind: str,
    overrides: Sequence[Override] = (),
    robot: RobotLike | None = None,
    document: Document | None = None,
) -> Any:
    """What `_load` makes of a file; InputError with all faults of all files where there are any."""
    faults: list[Fault] = []
    made = _load(Path(path), kind, faults, overrides, robot, document)
    errors = [fault for fault in faults if fault.severity == "error"]
    if errors or made is None:
        raise InputError(errors)
    vars(made).update(warnings=tuple(sorted(set(faults))))
    return made


def _load(
    path: Path,
    kind: str,
    faults: list[Fault],
    overrides: Sequence[Override] = (),
    robot: RobotLike | None = None,
    document: Document | None = None,
    prefix: str = "",
) -> Any:
    """Read, set overrides, validate, run the checks; None where the file is too broken to say more. A mission or a task
    comes with the robot (`robot`, or its own) and the environment that it names."""
    at_site = kind in ("mission", "task")
    known = None if document is not None or overrides or at_site else _REMEMBERED.get()
    key = (path, kind, prefix)
    if known is not None and key in known:
        made, found = known[key]
        faults.extend(found)
        return made
    found, made = [], None
    document = document or _read(path, found)
    if document is not None:
        document.prefix = prefix
        by_file = override_rules.route(overrides) if at_site else {"": list(overrides)}
        found += override_rules.apply(document, by_file[""])
        if isinstance(document.data, dict) and document.data.get("kind") == kind:
            made = validate_document(document, model_of(kind), found)
        else:
            found.append(_kind_fault(document, (kind,)))
        if at_site:
            joined = _companions(path, document, found, by_file, robot)
            if made is not None:
                given = tuple((k, value if isinstance(value, str) else repr(value)) for k, value in overrides)
                vars(made).update(robot=joined[0], environment=joined[1], overrides=given)
    if made is not None:
        checked = made.faults()
        vars(made).update(sound=not any(fault.severity == "error" for fault in checked))
        found += checked
    if known is not None:
        known[key] = made, found
    faults.extend(found)
    return made


def _companions(
    path: Path, document: Document, faults: list[Fault], by_file: dict[str, list[Override]], given: RobotLike | None
) -> tuple[RobotSpec | None, EnvironmentSpec | None]:
    """The robot, `given` or named, and the environment that a mission or a task names."""
    data = document.data if isinstance(document.data, dict) else {}
    robot: RobotSpec | None = None
    environment = None
    if isinstance(given, RobotSpec):
        robot = given
        if by_file["robot"]:
            robot = _load(given.path, "robot", faults, by_file["robot"], prefix="robot.")
    elif given is not None or (isinstance(data.get("robot"), str) and data["robot"]):
        reference = str(data["robot"] if given is None else given)
        found = find_robot(reference, path.parent if given is None else None) if reference else None
        if found is None:
            faults.append(unknown_robot(reference, document if given is None else None, ("robot",)))
        else:
            robot = _load(found, "robot", faults, by_file["robot"], prefix="robot.")
    named = data.get("environment")
    if isinstance(named, str) and named:
        target = path.parent / named
        if is_file(target):
            environment = _load(target, "environment", faults, by_file["environment"], prefix="environment.")
        else:
            message, allowed = "no such environment file", "a path relative to this file"
            got, hint = as_written(named), did_you_mean(named, files_near(document.file, named))
            faults.append(document.fault(("environment",), message, got=got, allowed=allowed, hint=hint))
    return robot, environment


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
