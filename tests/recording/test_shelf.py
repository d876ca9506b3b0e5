"""Samples that need not stay in memory."""

from __future__ import annotations

import os
import tracemalloc
from typing import Any

import numpy as np
import pytest

from skin2urdf.recording import shelf, sorting
from skin2urdf.recording.reading import read
from skin2urdf.recording.shelf import Shelf, copy_of_streams, put_away, room_for_streams
from skin2urdf.recording.sorting import Part, SortedSamples


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """No array is kept in ordinary memory."""
    monkeypatch.setattr(shelf, "ORDINARY", 0)


@pytest.mark.usefixtures("at_once")
def test_what_is_put_away_comes_back() -> None:
    place, rng = Shelf(), np.random.default_rng(0)
    arrays = [rng.standard_normal((n, 3)) for n in (0, 1, 700, 5000)]
    kept = [place.put(array) for array in arrays]
    filled = place.empty((300,), np.int64)
    filled[:] = np.arange(300)
    put_away(*kept, filled, None)
    place.put_away()
    del place
    for array, other in zip(arrays, kept, strict=True):
        np.testing.assert_array_equal(array, other)
    np.testing.assert_array_equal(filled, np.arange(300))


@pytest.mark.usefixtures("at_once")
def test_without_room_on_the_disk_all_is_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError

    monkeypatch.setattr(os, "posix_fallocate", full)
    array = np.arange(100)
    assert Shelf().put(array) is array
    assert Shelf().empty((5, 3)).shape == (5, 3)


@pytest.mark.usefixtures("at_once")
def test_memory_is_bounded_by_what_is_sorted_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sorting, "GROUP", 1 << 12)
    store, n, groups, sources = SortedSamples(), 1 << 12, 60, 16
    source = np.arange(n, dtype=np.uint32) % sources
    tracemalloc.start()
    for group in range(groups):
        stamp = np.arange(n) + n * group
        store.add(Part(source, stamp, stamp, np.repeat(stamp[:, None] * 0.5, 3, axis=1)))
    found = store.take(sources)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Stamps, log times and accelerations of a sample take 40 bytes.
    assert peak < 0.25 * groups * n * 40
    for k, columns in enumerate(found):
        np.testing.assert_array_equal(columns.stamp, np.arange(k, n * groups, sources))
        np.testing.assert_array_equal(columns.vector[:, 1], 0.5 * columns.stamp)


def test_a_log_reads_alike(ros_log: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(300):
        at = 10**18 + k * 10**7
        ros_log.joints(at, {"j": 0.01 * k})
        for late, frame in enumerate("ab"):
            ros_log.imu(at, (np.sin(0.1 * k - late), 0.0, 9.8), frame, f"/{frame}")
    path = ros_log.close()
    whole = read(path)
    monkeypatch.setattr(shelf, "ORDINARY", 0)
    again = read(path)
    assert len(whole.sus) == 2
    for one, other in zip(whole.sus, again.sus, strict=True):
        other.put_away()
        np.testing.assert_array_equal(one.time, other.time)
        np.testing.assert_array_equal(one.specific_force, other.specific_force)
        assert not other.specific_force.flags.writeable


@pytest.mark.parametrize("ordinary", [0, 1 << 28])
def test_streams_at_common_times_lie_in_one_piece_each(
    ordinary: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shelf, "ORDINARY", ordinary)
    room = room_for_streams(500, 7)
    values = np.random.default_rng(1).standard_normal((500, 7, 3))
    tracemalloc.start()
    for u in range(7):
        room[:, u] = values[:, u]
        put_away(room)
    copy = copy_of_streams(room)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (peak < values.nbytes) == (ordinary == 0)
    assert all(room[:, u].flags.c_contiguous for u in range(7))
    np.testing.assert_array_equal(room, values)
    copy[3] = 0.0
    np.testing.assert_array_equal(room, values)
    assert not copy[3].any()
