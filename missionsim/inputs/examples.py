"""Missions, environments, maps, logs and pages that come with missionsim."""

from __future__ import annotations

import shutil
from pathlib import Path

from missionsim.errors import Fault, InputError
from missionsim.files import atomic_write

PARTS = ("missions", "environments", "docs", "robots")
"""Folders that `write_examples` writes; README's commands run beside them."""

_PACKAGE = Path(__file__).resolve().parents[1]


def examples_folder() -> Path:
    """The folder that holds ``missions``, ``environments`` and ``docs``: of the wheel, or the clone.

    Raises
    ------
    missionsim.errors.InputError
        Where missionsim is installed without them.
    """
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

    Parameters
    ----------
    out : pathlib.Path
        Made if need be. Files of the same name and content are left alone.

    Returns
    -------
    list of pathlib.Path
        Every file, relative to `out`.

    Raises
    ------
    missionsim.errors.InputError
        Where a file of that name has another content; nothing is written then.
    """
    sources = example_files()
    changed = [name for name, path in sources.items() if (out / name).exists() and not _same(out / name, path)]
    if changed:
        raise InputError([Fault(str(out / name), 0, 0, "there is another file of this name") for name in changed])
    for name, path in sources.items():
        if not (out / name).exists():
            with atomic_write(out / name) as temporary:
                shutil.copyfile(path, temporary)
    return list(sources)


def _same(one: Path, other: Path) -> bool:
    return one.is_file() and one.read_bytes() == other.read_bytes()
