"""Base of all YAML models: frozen, unknown keys refused, with file and line of each object."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, StringConstraints
from pydantic_core import PydanticCustomError

from missionsim.errors import Fault
from missionsim.inputs.tree import Document, Node


def _text_of_int(raw: Any) -> Any:
    return str(raw) if type(raw) is int else raw


Name = Annotated[
    str,
    BeforeValidator(_text_of_int, json_schema_input_type=str | int),
    StringConstraints(strict=True, min_length=1, max_length=200),
]
"""Name of a place, segment, surface…: any text (a whole number counts as text)."""
Identifier = Annotated[str, StringConstraints(strict=True, pattern=r"^[a-z][a-z0-9_]*$", max_length=60)]
"""Name that becomes part of a log column (``power_<battery>_w``): lower case, digits, underscore."""
Text = Annotated[str, StringConstraints(strict=True, max_length=20_000)]

Count = Annotated[int, Field(strict=True, ge=0, le=1000)]
ParameterName = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=60)]
Expression = Annotated[
    str,
    BeforeValidator(lambda raw: str(raw) if type(raw) in (int, float) else raw, json_schema_input_type=str | float),
    StringConstraints(strict=True, min_length=1, max_length=2000),
]
Sensors = dict[Identifier, Count]


def wrong(message: str, got: object, allowed: str, *at: str) -> PydanticCustomError:
    """The fault of a whole object, at a key of it."""
    entry = {"message": message, "got": str(got), "allowed": allowed, "hint": "", "at": at}
    return PydanticCustomError("quantity", "{text}", {"text": message, "entries": [entry]})


class Model(BaseModel):
    """Frozen model; `line` and `path_in_file` are known for messages after the loader has sealed it."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        populate_by_name=False,
        strict=False,
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
        defer_build=True,  # only the kinds that are read are built
    )

    _line: int = PrivateAttr(default=0)
    _where: tuple[str | int, ...] = PrivateAttr(default=())

    @property
    def line(self) -> int:
        """1-based line in the file, 0 for a default."""
        return self._line

    @property
    def where(self) -> tuple[str | int, ...]:
        """Path in the file."""
        return self._where


class FileModel(Model):
    """Top object of a file."""

    _file: str = PrivateAttr(default="")
    _sha256: str = PrivateAttr(default="")
    _document: Document = PrivateAttr(default_factory=lambda: Document("", None, Node(None, 0, 0)))
    _whole: bool = PrivateAttr(default=True)
    _sound: bool = PrivateAttr(default=True)
    _warnings: tuple[Fault, ...] = PrivateAttr(default=())

    def faults(self, document: Document) -> list[Fault]:
        """Faults across parts of the file that the model itself knows to look for."""
        return []

    @property
    def path(self) -> Path:
        """Path of the file."""
        return Path(self._file)

    @property
    def whole(self) -> bool:
        """False where the file has faults and this is only what could be made of it for further checks."""
        return self._whole

    @property
    def sound(self) -> bool:
        """False where checks across the file's parts found faults."""
        return self._sound

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What the checks of this file, and of those that it names, found strange but possible."""
        return self._warnings

    @property
    def sha256(self) -> str:
        """Hash of the file's bytes (before any override)."""
        return self._sha256

    @property
    def document(self) -> Document:
        """What it was read from, for the positions in messages."""
        return self._document
