"""Base of all YAML models: frozen, unknown keys refused, with file and line of each object."""

import functools
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    StringConstraints,
    model_validator,
)
from pydantic_core import PydanticCustomError

from missionsim.errors import Fault, did_you_mean
from missionsim.glossary import COLUMNS, column_of
from missionsim.inputs.tree import Document, Node, as_written

Name = Annotated[
    str,
    BeforeValidator(lambda raw: str(raw) if type(raw) is int else raw, json_schema_input_type=str | int),
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


def told(entries: Iterable[Mapping[str, object]]) -> PydanticCustomError:
    """What is wrong, each with message, got, allowed, hint and the keys below here that it stands `at`."""
    listed = list(entries)
    return PydanticCustomError(
        "quantity", "{text}", {"text": "; ".join(str(entry["message"]) for entry in listed), "entries": listed}
    )


def wrong(message: str, got: object, allowed: str, *at: str, hint: str = "") -> PydanticCustomError:
    """The fault of a whole object, at a key of it."""
    return told([{"message": message, "got": str(got), "allowed": allowed, "hint": hint, "at": at}])


def either(one: str, other: str, message: str, allowed: str) -> object:
    """Validator of a model that has to give just one of two keys."""

    def check(model: "Model") -> "Model":
        if (getattr(model, one) is None) == (getattr(model, other) is None):
            raise wrong(message, "neither" if getattr(model, one) is None else "both", allowed)
        return model

    return model_validator(mode="after")(check)


def check_rising(values: list[float], message: str, allowed: str, *at: str) -> None:
    """Refuse values that do not increase."""
    if any(later <= earlier for earlier, later in pairwise(values)):
        raise wrong(message, values, allowed, *at)


def _ranges(origin: dict[str, JsonValue]) -> dict[str, JsonValue]:
    """What `origin` says of the logs: least and greatest values, names of floors."""
    ranges = origin.get("range", {})
    if not isinstance(ranges, dict):
        raise wrong("must be a mapping", ranges, "{speed_m_s: [0, 1.2], surface: [tiles]}", "range")
    faults: list[dict[str, object]] = []
    for name, limits in ranges.items():
        listed = limits if isinstance(limits, list) else []
        numbers = [float(x) for x in listed if isinstance(x, int | float) and not isinstance(x, bool)]
        fault: dict[str, object] = {"got": str(limits), "hint": "", "at": ("range", name)}
        if name == "surface":
            if not listed or not all(isinstance(text, str) for text in listed):
                faults.append(fault | {"message": "must be the names of floors", "allowed": "[tiles, carpet]"})
        elif column_of(name) is None:
            known = [column.name for column in COLUMNS]
            told_as = {"message": "no quantity of the glossary", "got": name, "allowed": "columns of logs, surface"}
            faults.append(fault | told_as | {"hint": did_you_mean(name, known)})
        elif len(numbers) != 2 or len(listed) != 2 or numbers[0] > numbers[1]:
            allowed = "two numbers in the unit of the name, such as [0, 1.2]"
            faults.append(fault | {"message": "must be the least and the greatest value", "allowed": allowed})
    if faults:
        raise told(faults)
    return origin


Origin = Annotated[dict[str, JsonValue], AfterValidator(_ranges)]


def alone(key: str, *kinds: type) -> Callable[[object], object]:
    """A value of these kinds that stands for a mapping with one key."""
    return lambda raw: {key: raw} if type(raw) in kinds else raw


def as_list(raw: object) -> object:
    """A value that stands for a list of one."""
    return raw if isinstance(raw, (dict, list, tuple)) else [raw]


class Model(BaseModel):
    """Frozen model; `line` and `where` are known for messages after the loader has sealed it."""

    # only the kinds that are read are built
    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True, defer_build=True
    )

    line: ClassVar[int] = 0
    """1-based line in the file, 0 for a default."""
    where: ClassVar[tuple[str | int, ...]] = ()
    """Path in the file."""

    @model_validator(mode="before")
    @classmethod
    def _mapping(cls, raw: object) -> object:
        """Refuse what is no mapping, and keys that there are not."""
        known = cls._keys()
        if isinstance(raw, Model) or (isinstance(raw, dict) and raw.keys() <= known.keys()):
            return raw
        allowed = ", ".join(key for key in known if key != "kind" or issubclass(cls, FileModel))
        if not isinstance(raw, dict):
            raise wrong("must be a mapping", as_written(raw), f"a mapping with {allowed}")
        entries: list[Mapping[str, object]] = []
        for key in [str(key) for key in raw if key not in known]:
            spelled = key.replace("-", "_").replace(" ", "_").lower()
            hint = spelled if spelled in known else did_you_mean(key, known)
            fault = {"message": f"unknown key '{key}'", "got": key, "allowed": allowed, "hint": hint, "at": (key,)}
            entries.append(fault)
        raise told(entries)

    @classmethod
    @functools.cache
    def _keys(cls) -> dict[str, None]:
        """What a file may write, in order."""
        return dict.fromkeys(field.alias or name for name, field in cls.model_fields.items())

    @model_validator(mode="after")
    def _checked(self) -> Self:
        self._check()
        return self

    def _check(self) -> None:
        """Refuse values that do not go together."""


class FileModel(Model):
    """Top object of a file. What is not read from it, the loader puts into the instance's ``vars``."""

    document: ClassVar[Document] = Document("", None, Node(None, 0, 0))
    """What it was read from, for the positions in messages."""
    whole: ClassVar[bool] = True
    """False where the file has faults and this is only what could be made of it for further checks."""
    sound: ClassVar[bool] = True
    """False where checks across the file's parts found faults."""
    warnings: ClassVar[tuple[Fault, ...]] = ()
    """What the checks of this file, and of those that it names, found strange but possible."""

    def faults(self) -> list[Fault]:
        """Faults across parts of the file that the model itself knows to look for."""
        return []

    @property
    def path(self) -> Path:
        """Path of the file."""
        return Path(self.document.file)

    @property
    def sha256(self) -> str:
        """Hash of the file's bytes (before any override)."""
        return self.document.sha256


class DescribedFile(FileModel):
    """A file with a name, and what it says to people."""

    name: Name
    title: Text = ""
    notes: Text = ""
    sources: dict[Identifier, Text] = Field(default_factory=dict)
