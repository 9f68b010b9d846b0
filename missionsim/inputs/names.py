"""Names, counts and formulas as pydantic types, and the fault of a whole object."""

from typing import Annotated

from pydantic import BeforeValidator, Field, StringConstraints
from pydantic_core import PydanticCustomError

from missionsim.inputs.base import Identifier

Count = Annotated[int, Field(strict=True, ge=0, le=1000)]
ParameterName = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=60)]
Expression = Annotated[
    str,
    BeforeValidator(lambda raw: str(raw) if type(raw) in (int, float) else raw, json_schema_input_type=str | float),
    StringConstraints(strict=True, min_length=1, max_length=2000),
]
Sensors = dict[Identifier, Count]


def wrong(message: str, got: object, allowed: str, *at: str) -> PydanticCustomError:
    entry = {"message": message, "got": str(got), "allowed": allowed, "hint": "", "at": at}
    return PydanticCustomError("quantity", "{text}", {"text": message, "entries": [entry]})
