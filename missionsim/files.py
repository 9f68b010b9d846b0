"""Files written whole or not at all, and their hashes."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import importlib
import json
import math
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from missionsim.errors import InputError

T = TypeVar("T")
K = TypeVar("K")
Json = dict[str, Any]
"""A JSON object."""
PathLike = str | os.PathLike[str]


def is_device(path: Path) -> bool:
    """Whether a path is a device or a pipe, which is written to and never replaced."""
    return "/dev" in map(str, path.absolute().parents) or (path.exists() and not path.is_file() and not path.is_dir())


@contextlib.contextmanager
def atomic_write(path: PathLike) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it is renamed to `path`, on failure removed.

    A link stays a link, and a device or pipe (``/dev/null``, ``/dev/stdout``) is written to, never replaced. `path`:
    the final name; its folder is made. Yields an empty temporary file with the same suffix, to be written by the
    caller.
    """
    final, special, temporary = _begin(path)
    try:
        yield temporary
        if special:
            with final.open("r+b" if final.exists() else "xb", buffering=0) as device:
                device.write(temporary.read_bytes())
        else:
            mask = os.umask(0)
            os.umask(mask)
            temporary.chmod(0o666 & ~mask)
            temporary.replace(final)
    except OSError as error:
        if error.filename not in (None, str(temporary), str(final)):
            raise
        # Arrow tells the number in words of its own
        raise OSError(error.errno, os.strerror(error.errno) if error.errno else str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def _begin(path: PathLike) -> tuple[Path, bool, Path]:
    """What a path leads to, whether that is a device, and an empty temporary file beside it."""
    final = Path(path)
    special = is_device(final)
    if final.is_dir():
        raise IsADirectoryError(errno.EISDIR, "this is a folder, a file is to be written", str(path))
    if final.is_symlink() and not special:
        final = final.resolve()
    try:
        if not special:
            final.parent.mkdir(parents=True, exist_ok=True)
        folder = None if special else final.parent.absolute()  # Arrow takes a path that begins with ~ for a home
        handle, name = tempfile.mkstemp(prefix=f".{final.stem}.", suffix=final.suffix, dir=folder)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    os.close(handle)
    return final, special, Path(name)


def fields_of(item: object, names: str) -> Json:
    """Attributes of an object, named with blanks between, as part of a JSON object: ``name``, or ``name=attribute``
    where JSON calls it otherwise. What has a `to_json` is told by it, also inside tuples and mappings."""
    pairs = (name.partition("=") for name in names.split())
    return {name: _told(attrgetter(attribute or name)(item)) for name, _, attribute in pairs}


def _told(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _told(inner) for key, inner in value.items()}
    if isinstance(value, (tuple, list)):
        return [_told(inner) for inner in value]
    return value.to_json() if hasattr(value, "to_json") else value


def grouped(items: Iterable[T], key: Callable[[T], K]) -> dict[K, list[T]]:
    """Items by a key, keys and items in their order."""
    found: dict[K, list[T]] = {}
    for item in items:
        found.setdefault(key(item), []).append(item)
    return found


def write_text(path: PathLike, text: str) -> None:
    """Write `text` to `path` as UTF-8, whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def to_json(data: object, ascii: bool = False) -> str:
    """JSON text of a result, ending with a line feed: NumPy values as numbers and lists, nan and inf as null."""
    return json.dumps(plain(data), indent=2, ensure_ascii=ascii, allow_nan=False) + "\n"


def plain(value: object, digits: int | None = None) -> object:
    """NumPy values as JSON has them: floats at so many significant digits, those that are not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item, digits) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist(), digits)
    if isinstance(value, float):
        return None if not math.isfinite(value) else value if digits is None else float(f"{value:.{digits}g}")
    return value


def sha256(path: PathLike) -> str:
    """SHA-256 of a file's bytes, as 64 hexadecimal digits."""
    with open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def csv_cell(value: T) -> T | str:
    """A value for a CSV table; a text that a spreadsheet would compute (``=``, ``@`` …) begins with an apostrophe."""
    if not isinstance(value, str) or value[:1] not in ("=", "+", "-", "@", "\t", "\r"):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def needed(package: str, doing: str, file: str = "") -> ModuleType:
    """A module of an optional package. Raises InputError: it is not installed; with the command that installs it."""
    try:
        return importlib.import_module(package)
    except ImportError:
        told = f"{doing} needs the package {package.partition('.')[0]}"
        raise InputError.single(told, file=file, allowed=install_hint("logs")) from None


@contextlib.contextmanager
def unreadable(told: str, file: str, allowed: str) -> Iterator[None]:
    """Whatever another package raises on a broken file becomes an InputError with what it said."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError.single(told, file=file, got=first_line(error), allowed=allowed) from None


def first_line(error: Exception, most: int = 200) -> str:
    """What an error of another package says in its first line, or its name."""
    return (str(error) or type(error).__name__).splitlines()[0][:most]


def install_hint(extra: str) -> str:
    """The command that adds an extra to this installation: from its folder where it is one, else from the registry."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        origin = json.loads(distribution("missionsim").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        origin = {}
    url = str(origin.get("url", ""))
    if url.startswith("file://"):
        editable = "-e " if origin.get("dir_info", {}).get("editable") else ""
        return f"pip install {editable}'{url.removeprefix('file://')}[{extra}]'"
    return f"pip install 'missionsim[{extra}]'" + (f" (it came from {url})" if url else "")
