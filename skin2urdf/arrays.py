"""Array types and the one way records make their arrays read-only."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64: TypeAlias = NDArray[np.float64]
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
        array = array.copy() if array is value or array.base is not None else array
        array.flags.writeable = False
    return array


def keep_freed_memory() -> None:
    """Let the C library keep freed memory for the next arrays instead of returning it.

    An iteration frees megabytes that the next one asks for again; paging them in anew takes longer
    than computing them. glibc returns memory above a threshold that follows the largest block
    freed so far (mallopt(3), ``M_MMAP_THRESHOLD``, at most 32 MB). Elsewhere nothing happens.
    """
    np.empty(30 << 20, dtype=np.uint8)
