"""Missions, environments, maps, logs and pages that come with missionsim."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.files import atomic_write
from missionsim.inputs.tree import Document, Where, as_written

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


def robot_file(name_or_path: str | os.PathLike[str]) -> Path:
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
