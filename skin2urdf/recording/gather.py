"""Collect unaligned pieces of a byte buffer, many at a time."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from skin2urdf.arrays import Int

U8: TypeAlias = NDArray[np.uint8]


def gather(buffer: U8, offset: Int, dtype: DTypeLike) -> NDArray[Any]:
    """Read one item of ``dtype`` at each offset.

    Args:
        buffer: contiguous bytes.
        offset: (N,) positions [byte]; every item must lie within the buffer.
        dtype: a packed element type of known size.

    Returns:
        (N,) array of ``dtype``, a copy.
    """
    item = np.dtype(dtype)
    if offset.size == 0:
        return np.empty(0, item)
    # A view with one item per byte lets NumPy copy unaligned items in one indexing. Indexing
    # opaque items is a plain copy of memory and several times faster than copying fields.
    opaque = np.dtype((np.void, item.itemsize))
    at_every_byte: NDArray[Any] = np.ndarray(
        (max(0, buffer.size - item.itemsize + 1),), opaque, buffer, strides=(1,)
    )
    return at_every_byte[offset].view(item)


def gather_rows(buffer: U8, offset: Int, count: int, dtype: DTypeLike) -> NDArray[Any]:
    """Read ``count`` consecutive items of ``dtype`` at each offset.

    Args:
        buffer: contiguous bytes.
        offset: (N,) positions [byte]; every row must lie within the buffer.
        count: items per row.
        dtype: element type.

    Returns:
        (N, count) array of ``dtype``, a copy.
    """
    item = np.dtype(dtype)
    if offset.size == 0 or count == 0:
        return np.empty((offset.size, count), item)
    rows = gather(buffer, offset, np.dtype((np.void, item.itemsize * count)))
    return rows.view(item).reshape(offset.size, count)


def distinct(buffer: U8, offset: Int, length: Int) -> tuple[Int, Int]:
    """Group byte strings by their content.

    Args:
        buffer: contiguous bytes.
        offset: (N,) where each string starts [byte].
        length: (N,) length of each string [byte]; strings must lie within the buffer.

    Returns:
        (G,) index of one representative per distinct string, and (N,) the group of each string.
    """
    representative: list[int] = []
    group = np.empty(offset.size, np.int64)
    for size in np.unique(length):
        rows = np.flatnonzero(length == size)
        text = gather_rows(buffer, offset[rows], int(size), np.uint8)
        if (text == text[0]).all():
            group[rows] = len(representative)
            representative.append(int(rows[0]))
            continue
        # Strings of one length that differ only in trailing zeros do not exist, so NumPy's
        # zero-stripping strings compare right, and sort faster than opaque items.
        _, first, inverse = np.unique(
            text.view(np.dtype((np.bytes_, int(size)))).reshape(-1),
            return_index=True,
            return_inverse=True,
        )
        group[rows] = len(representative) + inverse
        representative.extend(rows[first].tolist())
    return np.array(representative, np.int64), group
