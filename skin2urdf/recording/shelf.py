"""Arrays that the system may put out of memory: those of a log that is longer than memory is large.

They lie in files without a name, mapped into memory. Pages of such files can be written out and
come back when they are used, and nothing of them is left once no array needs them.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import tempfile
import threading
import weakref
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

# What each shelf keeps in ordinary memory before [byte]: a few SUs for some minutes. A calibration
# has half a dozen of them, of readings as they come, on the grid, filtered and as splines.
ORDINARY = 1 << 26
# Arrays that share a file [byte].
FILE = 1 << 26
# Streams whose values are in memory while many are gone through.
STREAMS_IN_MEMORY = 64
PAGE = mmap.PAGESIZE


class Shelf:
    """Makes room for arrays: in memory at first, in files once there are many.

    Where no file can be made, as without room for it, all of them are in memory. Several threads
    may ask for room.
    """

    def __init__(self) -> None:
        self._given = 0
        self._free = memoryview(b"")
        self._files: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self._lock = threading.Lock()

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """An array that is to be filled.

        Args:
            shape: as of any array.
            dtype: element type.
        """
        kind = np.dtype(dtype)
        place = self._place(int(np.prod(shape)) * kind.itemsize)
        return np.empty(shape, kind) if place is None else np.frombuffer(place, kind).reshape(shape)

    def put(self, array: NDArray[Any]) -> NDArray[Any]:
        """An array with the same content; itself as long as there are few."""
        place = None if _file_of(array) is not None else self._place(array.nbytes)
        if place is None:
            return array
        out = np.frombuffer(place, array.dtype).reshape(array.shape)
        out[...] = array
        return out

    def put_away(self) -> None:
        """Tell the system that no array is needed soon."""
        for file in self._files:
            _let_go(file)

    def _place(self, size: int) -> memoryview | None:
        """So many bytes of a file; None where none is needed, or none can be had."""
        with self._lock:
            self._given += size
            if not size or self._given <= ORDINARY:
                return None
            whole = -(-size // PAGE) * PAGE
            if len(self._free) < whole:
                file = _new_file(max(whole, FILE))
                if file is None:
                    return None
                self._files.add(file)
                self._free = memoryview(file)
            place, self._free = self._free[:size], self._free[whole:]
            return place


def room_for_streams(samples: int, streams: int, axes: int = 3) -> NDArray[Any]:
    """An array (N, U, C) that is to be filled with the values of U streams at N common times.

    What belongs to a stream lies in one piece, and in a file where there is much of it, so that
    work on a stream asks for the memory of that stream.

    Args:
        samples: N.
        streams: U.
        axes: C.
    """
    return Shelf().empty((streams, samples, axes)).swapaxes(0, 1)


def copy_of_streams(values: NDArray[Any]) -> NDArray[Any]:
    """The same values (N, U, C) to be written to, as `room_for_streams` places them."""
    copy = room_for_streams(*values.shape)
    for u in range(values.shape[1]):
        copy[:, u] = values[:, u]
        if u % STREAMS_IN_MEMORY == 0:
            put_away(values, copy)
    put_away(values, copy)
    return copy


def put_away(*arrays: NDArray[Any] | None) -> None:
    """Tell the system that arrays, and those in the same files, are not needed soon."""
    for file in {_file_of(array) for array in arrays if array is not None}:
        if file is not None:
            _let_go(file)


def _let_go(file: mmap.mmap) -> None:
    """Give the memory of a file back; what was written stays in it."""
    if hasattr(mmap, "MADV_DONTNEED"):
        file.madvise(mmap.MADV_DONTNEED)


def _file_of(array: NDArray[Any]) -> mmap.mmap | None:
    """The file that an array lies in, None for one in memory."""
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, memoryview):
        base = base.obj
    return base if isinstance(base, mmap.mmap) else None


def _new_file(size: int) -> mmap.mmap | None:
    """A file of so many bytes, None where there is no room for it."""
    # Folders for what is temporary may lie in memory; that for what lasts longer does not. Files
    # there have no name that others could foresee.
    lasting = "/var/tmp"  # noqa: S108
    folders = (None,) if "TMPDIR" in os.environ else (lasting, None)
    for folder in folders:
        with (
            contextlib.suppress(OSError, AttributeError),
            tempfile.TemporaryFile(dir=folder) as stream,
        ):
            # A page that has no place on the disk would end the program once it is written.
            os.posix_fallocate(stream.fileno(), 0, size)
            return mmap.mmap(stream.fileno(), size)
    return None
