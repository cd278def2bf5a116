"""Tables of files against pydantic models, with this project's one-line messages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from jaxsim.errors import InputError

Model = TypeVar("Model", bound=BaseModel)


def check(model: type[Model], table: Any, where: str) -> Model:
    """The model filled from a table.

    Raises: InputError for the first key that is wrong, unknown (with the nearest) or missing.
    """
    if not isinstance(table, Mapping):
        raise InputError(where, "must be a table", repr(table), "write [" + where + "]")
    try:
        return model.model_validate(dict(table))
    except ValidationError as error:
        raise _translated(error.errors()[0], model, where) from None


def _translated(detail: Any, model: type[BaseModel], where: str) -> InputError:
    path = ".".join([where, *(str(part) for part in detail["loc"])])
    if detail["type"] == "extra_forbidden":
        return InputError.unknown(path, str(detail["loc"][-1]), model.model_fields)
    if detail["type"] == "missing":
        return InputError(path, "must be given", "nothing", "add it")
    rule = detail["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    return InputError(path, f"must be {rule}", repr(detail["input"]), "correct the value")
