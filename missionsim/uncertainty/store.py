"""Blocks of runs in Parquet files, written as they finish, read back one column at a time."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import InputError
from missionsim.files import atomic_write, write_text
from missionsim.physics import Array

BATCH_FILE = "batch.json"
LOCK_FILE = ".lock"


@dataclass(frozen=True)
class BlockStore:
    """A folder with one Parquet file a block."""

    folder: Path

    def path(self, first: int) -> Path:
        """File of the block that begins with run `first`."""
        return self.folder.absolute() / "blocks" / f"runs_{first:09d}.parquet"  # Arrow takes ~ for a home

    def has(self, first: int) -> bool:
        """Whether that block is there, whole."""
        return self.path(first).is_file()

    def drop_damaged(self, blocks: Mapping[int, int]) -> list[int]:
        """Delete blocks that cannot be read or have not as many runs as they should; their first runs. `blocks`: first
        run of each → its number of runs."""
        damaged = []
        for first in self.firsts():
            try:
                sound = self._read(first, None).num_rows == blocks.get(first)
            except (OSError, ValueError):
                sound = False
            if not sound:
                self.path(first).unlink()
                damaged.append(first)
        return damaged

    def _read(self, first: int, names: Sequence[str] | None) -> Any:
        import pyarrow.parquet as pq

        with pq.ParquetFile(self.path(first), page_checksum_verification=True) as file:
            return file.read(columns=None if names is None else [*names], use_threads=False)

    def write(self, first: int, columns: Mapping[str, NDArray[np.generic]]) -> None:
        """Write a block, whole or not at all; the same columns give the same bytes."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        arrays = {}
        for name, values in columns.items():
            if values.ndim == 2:
                arrays[name] = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
            else:
                arrays[name] = pa.array(values.tolist() if values.dtype == object else values)
        texts = [name for name, values in columns.items() if values.dtype == object]
        with atomic_write(self.path(first)) as temporary:
            # numbers that are all different gain nothing from a dictionary
            pq.write_table(
                pa.table(arrays), temporary, compression="zstd", use_dictionary=texts, write_page_checksum=True
            )

    def firsts(self) -> list[int]:
        """First runs of the blocks that are there, in order."""
        names = (path.stem.removeprefix("runs_") for path in (self.folder / "blocks").glob("runs_*.parquet"))
        # what else lies there, such as copies, is none of ours
        return sorted(int(name) for name in names if name.isdecimal() and f"{int(name):09d}" == name)

    def names(self) -> list[str]:
        """Columns of the blocks."""
        import pyarrow.parquet as pq

        firsts = self.firsts()
        return list(pq.read_schema(self.path(firsts[0])).names) if firsts else []

    def column(self, name: str, firsts: list[int] | None = None) -> NDArray[np.generic]:
        """One column of all blocks, in order of runs; shape (runs,) or (runs, points)."""
        parts = [table[name] for table in self.tables((name,), firsts)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def tables(self, names: Sequence[str], firsts: list[int] | None = None) -> Iterator[dict[str, NDArray[np.generic]]]:
        """Some columns, block by block."""
        for first in self.firsts() if firsts is None else firsts:
            try:
                table = self._read(first, names)
            except (OSError, ValueError) as error:
                told, allowed = "this block of runs is damaged", "--resume computes it again"
                raise InputError.single(
                    told, file=str(self.path(first)), got=str(error).splitlines()[0], allowed=allowed
                ) from error
            found: dict[str, NDArray[np.generic]] = {}
            for name in names:
                chunk = table.column(name).combine_chunks()
                if hasattr(chunk.type, "list_size"):
                    found[name] = np.asarray(chunk.flatten()).reshape(-1, chunk.type.list_size)
                else:
                    found[name] = np.asarray(chunk.to_numpy(zero_copy_only=False))
            yield found

    def beginning(self, names: Sequence[str], firsts: list[int] | None, count: int) -> dict[str, Array]:
        """The first `count` numbers of some columns."""
        found: dict[str, list[Array]] = {name: [] for name in names}
        length = 0
        for table in self.tables(names, firsts) if names else ():
            for name, part in table.items():
                found[name].append(np.asarray(part[: count - length], dtype=float))
            length += len(table[names[0]])
            if length >= count:
                break
        return {name: np.concatenate(parts) if parts else np.zeros(0) for name, parts in found.items()}

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep the folder for this process alone; a lock that a killed process held is free. Raises InputError: where
        another process writes a batch here."""
        try:
            import fcntl
        except ImportError:  # no such locks here
            yield
            return
        new = not self.folder.exists()
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / LOCK_FILE
        with path.open("w") as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                told = "another process is writing a batch into this folder"
                allowed = "another --out, or to wait for it"
                raise InputError.single(told, file=str(self.folder), allowed=allowed) from None
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
                if new and not any(self.folder.iterdir()):
                    self.folder.rmdir()

    def begin(self, identity: Mapping[str, object], *, resume: bool) -> None:
        """Make the folder for a batch, or take up an interrupted one. Raises InputError: where the folder holds a batch
        and `resume` was not asked, or a different batch."""
        path = self.folder / BATCH_FILE
        if path.is_file():
            if not resume:
                raise InputError.single(
                    "this folder holds a batch already", file=str(self.folder), allowed="another --out, or --resume"
                )
            try:
                old = _flat(json.loads(path.read_text(encoding="utf-8")))
            except (ValueError, AttributeError) as error:
                raise InputError.single(
                    "this file does not tell which batch is in the folder",
                    file=str(path),
                    got=str(error) if isinstance(error, ValueError) else "no JSON object",
                    allowed="another --out, or the file as it was written",
                ) from error
            new = _flat(identity)
            differing = sorted(key for key in {*old, *new} if old.get(key) != new.get(key))
            if differing:
                told = f"the batch in this folder is another one, by its {', '.join(differing)}"
                got = ", ".join(f"{key}={_short(new.get(key))}" for key in differing)
                allowed = ", ".join(f"{key}={_short(old.get(key))}" for key in differing) + "; or another --out"
                raise InputError.single(told, file=str(path), got=got, allowed=allowed)
            return
        if self.folder.exists() and any(item.name != LOCK_FILE for item in self.folder.iterdir()):
            raise InputError.single("this folder is not empty and holds no batch", file=str(self.folder))
        write_text(path, json.dumps(identity, indent=2, sort_keys=True) + "\n")


def _flat(identity: Mapping[str, Any]) -> dict[str, Any]:
    """What identifies a batch, each file by itself."""
    files = identity.get("files")
    named = {f"{name} file": value for name, value in files.items()} if isinstance(files, dict) else {}
    return {key: value for key, value in identity.items() if key != "files"} | named


def _short(value: Any) -> str:
    text = str(value)
    return f"{text[:8]}…" if len(text) == 64 else text
