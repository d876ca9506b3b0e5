from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from skin2urdf.recording import sorting
from skin2urdf.recording.sorting import Part, SortedSamples


@pytest.mark.parametrize("group", [1, 50, 10_000])
def test_samples_of_each_source_come_back_in_their_order(
    group: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sorting, "GROUP", group)
    rng = np.random.default_rng(0)
    store, sources, stamps = SortedSamples(), [], []
    for block in range(20):
        source = rng.integers(0, 1 + block // 4, 30).astype(np.uint32)
        stamp = 1000 * block + np.arange(30)
        rates = None if block % 2 else np.column_stack([stamp] * 3).astype(float)
        store.add(Part(source, stamp, stamp + 1, np.column_stack([stamp] * 3).astype(float), rates))
        sources.append(source)
        stamps.append(stamp)
    whole = np.concatenate(sources)
    for k, found in enumerate(store.take(5)):
        expected = np.concatenate(stamps)[whole == k]
        assert np.array_equal(found.stamp, expected)
        assert np.array_equal(found.log_time, expected + 1)
        assert np.array_equal(found.vector[:, 2], expected)
        assert found.rates is not None
        there = expected // 1000 % 2 == 0
        assert np.array_equal(found.rates[there, 0], expected[there])
        assert np.isnan(found.rates[~there]).all()


def test_sorting_takes_little_more_memory_than_the_samples() -> None:
    count, blocks = 8192, 100
    stamp = np.arange(count)
    tracemalloc.start()
    store = SortedSamples()
    for _ in range(blocks):
        source = (stamp % 100).astype(np.uint32)
        store.add(Part(source, stamp + 1, stamp + 2, np.ones((count, 3)), np.zeros((count, 3))))
    found = store.take(100)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Two stamps and a vector of each sample, the vector twice for a moment, and a group in work;
    # rates of zeros, which many drivers send, cost nothing before they are looked at.
    each = peak / (count * blocks)
    assert sum(column.stamp.size for column in found) == count * blocks
    assert each < 40 + 24 + 24 + 120 * sorting.GROUP / (count * blocks)
