"""What becomes a line: a case, what came of it, and the code that did it.

A script describes its cases and figures as frozen dataclasses; how they become JSON and come back
follows from their annotations, so that no script writes a format of its own.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from typing import Any, Generic, Literal, Protocol, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as _get_type_hints

import numpy as np


class Case(Protocol):
    """One thing to do, a frozen dataclass; equal cases have equal keys on every machine."""

    @property
    def key(self) -> str:
        """Names it."""


@dataclass(frozen=True)
class Failure:
    """Why there are no figures.

    Attributes:
        kind: name of the exception.
        message: its words.
        where: the innermost place in the code, or where the worker ran.
    """

    kind: str
    message: str
    where: str = ""

    def __str__(self) -> str:
        return f"{self.kind} in {self.where}: {self.message}"


C = TypeVar("C", bound=Case)
F = TypeVar("F")


@dataclass(frozen=True)
class Record(Generic[C, F]):
    """One line of an output.

    Attributes:
        case: what was done.
        outcome: the figures, or why there are none.
        code: the state of the code that did it, see :mod:`batch.provenance`.
    """

    case: C
    outcome: F | Failure
    code: str = ""

    @property
    def failure(self) -> Failure | None:
        """Why there are no figures; None where there are."""
        return self.outcome if isinstance(self.outcome, Failure) else None

    @property
    def figures(self) -> F:
        """What came of it.

        Raises:
            ValueError: there are no figures.
        """
        if isinstance(self.outcome, Failure):
            raise ValueError(f"{self.case.key}: {self.outcome}")  # noqa: TRY004 - of the right type
        return self.outcome

    def to_json(self) -> str:
        """One line; numbers that are not finite become null."""
        kind = "figures" if self.failure is None else "failure"
        content = {
            "key": self.case.key, "code": self.code, "case": self.case, kind: self.outcome
        }  # fmt: skip
        return json.dumps(_plain(content), allow_nan=False)


def parsed(line: str, case: type[C], figures: type[F]) -> Record[C, F]:
    """A record from its line.

    Args:
        line: JSON.
        case: type of the script's cases.
        figures: type of its figures.

    Raises:
        ValueError: the line is no whole record of these types.
    """
    content = json.loads(line)
    if not isinstance(content, dict) or not {"case", "code"} <= content.keys():
        raise ValueError("not a record")
    outcome: F | Failure
    if "figures" in content:
        outcome = _restored(figures, content["figures"])
    else:
        outcome = _restored(Failure, content.get("failure"))
    return Record(_restored(case, content["case"]), outcome, str(content["code"]))


def _plain(value: Any) -> Any:
    """The same in what JSON knows."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value


@cache
def _hints(kind: type) -> dict[str, Any]:
    return _get_type_hints(kind)


def _restored(kind: Any, value: Any) -> Any:
    """A value of an annotated type from what JSON knows.

    A float that was not finite is NaN, or None where None is allowed.

    Raises:
        ValueError: it is none.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin in (Union, types.UnionType):
        return _of_union(arguments, value)
    if origin is Literal:
        return _checked(value in arguments, kind, value)
    if origin is tuple and isinstance(value, list):
        parts = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        _checked(len(parts) == len(value), kind, value)
        return tuple(_restored(part, entry) for part, entry in zip(parts, value, strict=True))
    if isinstance(origin, type) and issubclass(origin, Mapping) and isinstance(value, dict):
        return {key: _restored(arguments[1], entry) for key, entry in value.items()}
    if is_dataclass(kind) and isinstance(value, dict):
        return _of_class(kind, value)
    if kind is float:
        value = math.nan if value is None else value
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return float(_checked(number, kind, value))
    fits = isinstance(kind, type) and not is_dataclass(kind) and type(value) is kind
    return _checked(fits, kind, value)


def _of_union(kinds: tuple[Any, ...], value: Any) -> Any:
    if value is None and type(None) in kinds:
        return None
    for kind in kinds:
        try:
            return _restored(kind, value)
        except ValueError:
            continue
    return _checked(False, kinds, value)


def _of_class(kind: Any, content: dict[str, Any]) -> Any:
    """A dataclass from its fields; those that have a default may be missing."""
    hints = _hints(kind)
    known = {field.name: field for field in fields(kind) if field.init}
    needed = {
        name
        for name, field in known.items()
        if field.default is MISSING and field.default_factory is MISSING
    }
    _checked(needed <= content.keys() <= known.keys(), kind, sorted(content))
    return kind(**{name: _restored(hints[name], entry) for name, entry in content.items()})


def _checked(fits: bool, kind: Any, value: Any) -> Any:
    if not fits:
        raise ValueError(f"{value!r} is not of {kind}")
    return value
