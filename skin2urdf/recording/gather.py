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
    return _at_every_byte(buffer, item.itemsize)[offset].view(item)


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


def put_rows(buffer: U8, offset: Int, rows: NDArray[Any]) -> None:
    """Write consecutive items over what stands at each offset.

    Args:
        buffer: contiguous bytes.
        offset: (N,) positions [byte]; every row must lie within the buffer, and none overlap.
        rows: (N, M) items.
    """
    if rows.size == 0:
        return
    size = rows.dtype.itemsize * rows.shape[1]
    opaque = np.ascontiguousarray(rows).view(np.dtype((np.void, size)))
    _at_every_byte(buffer, size)[offset] = opaque[:, 0]


def _at_every_byte(buffer: U8, size: int) -> NDArray[Any]:
    """A view of opaque items of some bytes, one that begins at every byte.

    It lets NumPy copy unaligned items in one indexing. Indexing opaque items is a plain copy of
    memory and several times faster than copying fields.
    """
    opaque = np.dtype((np.void, size))
    return np.ndarray((max(0, buffer.size - size + 1),), opaque, buffer, strides=(1,))


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
        first, inverse = _distinct_rows(text)
        group[rows] = len(representative) + inverse
        representative.extend(rows[first].tolist())
    return np.array(representative, np.int64), group


def grouped(key: Int) -> list[Int]:
    """Sort items by a key: the numbers of each group's items in their order.

    Args:
        key: (N,) whole numbers.

    Returns:
        One array per key that occurs, in the order of the keys.
    """
    if not key.size or (key == key[0]).all():
        return [np.arange(key.size)] if key.size else []
    order = np.argsort(key, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(key[order])) + 1)


def _distinct_rows(text: U8) -> tuple[Int, Int]:
    """Group the rows of a matrix of bytes: (G,) one row of each group, (N,) groups of rows.

    Numbers sort several times faster than strings, so rows are compared by a hash, and each with
    its group's first row; should two texts have one hash, strings are sorted.
    """
    count, size = text.shape
    words = np.zeros((count, -(-size // 8) * 8), np.uint8)
    words[:, :size] = text
    mixed = np.zeros(count, np.uint64)
    for column in words.view(np.uint64).T:
        mixed = (mixed ^ column) * HASH_FACTOR
        mixed ^= mixed >> np.uint64(29)
    _, first, inverse = np.unique(mixed, return_index=True, return_inverse=True)
    inverse = inverse.reshape(-1)
    if not np.array_equal(text[first][inverse], text):
        # Strings of one length that differ only in trailing zeros do not exist, so NumPy's
        # zero-stripping strings compare right, and sort faster than opaque items.
        strings = text.view(np.dtype((np.bytes_, size))).reshape(-1)
        _, first, inverse = np.unique(strings, return_index=True, return_inverse=True)
    return first.astype(np.int64), inverse.astype(np.int64).reshape(-1)


# An odd number with bits all over: multiplying by it spreads every bit of a word upwards.
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)
