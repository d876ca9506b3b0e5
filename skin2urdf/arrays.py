"""Array types and the one way records make their arrays read-only."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64: TypeAlias = NDArray[np.float64]
F32: TypeAlias = NDArray[np.float32]
Complex: TypeAlias = NDArray[np.complex128]
Int: TypeAlias = NDArray[np.int64]
Bool: TypeAlias = NDArray[np.bool_]


def frozen(value: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return ``value`` as a read-only array of ``dtype``.

    An array that is already read-only is passed through, so records can share memory.

    Args:
        value: anything NumPy can turn into an array.
        dtype: element type of the result.

    Returns:
        A read-only array; a copy where ``value`` could still be written to by its owner.
    """
    array = np.asarray(value, dtype=dtype)
    if array.flags.writeable:
        array = array.copy(order="K") if array is value or array.base is not None else array
        array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Record:
    """What records are made of whose arrays are read-only.

    Values of fields that are annotated as ``F64``, ``Int`` or ``Bool``, as one of these or None, or
    as a tuple of them, become read-only arrays of that type.
    """

    def __post_init__(self) -> None:
        record: Any = type(self)  # a class has a hash, whatever its instances have
        for name, dtype, several in _array_fields(record):
            value = getattr(self, name)
            if value is not None:
                array = tuple(frozen(v, dtype) for v in value) if several else frozen(value, dtype)
                object.__setattr__(self, name, array)


_DTYPES = {"F64": np.float64, "Int": np.int64, "Bool": np.bool_}
_ARRAY = re.compile(r"(tuple\[)?(F64|Int|Bool)(, \.\.\.\]| \| None)?")


@cache
def _array_fields(record: type[Record]) -> tuple[tuple[str, type[np.generic], bool], ...]:
    """Fields of a record that hold arrays: their names, the arrays' type, whether several."""
    of_all = ((field.name, *_array_type(str(field.type))) for field in fields(record))
    return tuple((name, dtype, several) for name, dtype, several in of_all if dtype is not None)


def _array_type(annotation: str) -> tuple[type[np.generic] | None, bool]:
    """Type of the array or arrays that a field holds, None of others; whether these are several."""
    found = _ARRAY.fullmatch(annotation)
    return (_DTYPES[found[2]], found[1] is not None) if found else (None, False)


def keep_freed_memory() -> None:
    """Let the C library keep freed memory for the next arrays instead of returning it.

    An iteration frees megabytes that the next one asks for again; paging them in anew takes longer
    than computing them: of 66 s for a robot of 29 joints 12 were the system's, and 5 with it. glibc
    asks the system for every array of more than 32 MB and returns it at once, whatever its
    thresholds are, unless it is told to do without (mallopt(3), ``M_MMAP_MAX``). Elsewhere nothing
    happens.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return  # another C library
    mallopt(_M_MMAP_MAX, 0)
    mallopt(_M_TRIM_THRESHOLD, _KEPT)


def give_back_freed_memory() -> None:
    """Give freed memory to the system, where the C library has a call for it.

    Arrays of many sizes in turns leave gaps, which a heap keeps: with 1,000 SUs 440 MiB are kept
    where 390 are used once features are taken, and 970 where 330 are used once samples are fitted.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
"""Numbers of parameters in glibc's malloc.h."""
_KEPT = 256 << 20
"""Freed memory that is kept [bytes]: what an iteration on a log of 30 joints frees at once."""


def together(parts: Sequence[tuple[F64 | None, F64]]) -> F64 | None:
    """What was measured beside several batches of values, NaN where it is missing.

    Args:
        parts: what was measured beside (N, C) values, or None, and these.

    Returns:
        All of it in one piece; None where there is none.
    """
    if all(beside is None for beside, _ in parts):
        return None
    return np.concatenate(
        [np.full(values.shape, np.nan) if beside is None else beside for beside, values in parts]
    )
