"""What one sensor alone reads for a sample is a spike, what pushes several SUs at once is none."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.pulses import Read, lonely_spikes

N, RATE, LATE = 12_000, 100.0, 8
"""Samples, and by how many of them clocks of SUs differ."""


def skins(seed: int, shakes: Int) -> list[F64]:
    """Readings of four SUs that swing, and are shaken for a sample at some moments.

    The first feels most of it, and so alone that it may be a spike; another feels as much.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(N)[:, None] / RATE
    out = []
    for push in (3.0, 2.5, 0.35, 0.3):
        swing = rng.uniform(1.0, 4.0, 3) * np.sin(2 * np.pi * rng.uniform(0.1, 0.4, 3) * t)
        values = swing + [3.0, 2.0, 9.0] + 0.03 * rng.standard_normal((N, 3))
        values[shakes] += push * rng.choice([-1.0, 1.0], (len(shakes), 1)) * [0.6, 0.6, -0.5]
        out.append(values)
    return out


def moments(seed: int, n: int) -> Int:
    """Moments apart from each other."""
    rng = np.random.default_rng(seed)
    return 40 * rng.choice(np.arange(2, N // 40 - 2), n, replace=False) + rng.integers(0, 8, n)


def read(skins: list[F64]) -> list[Read]:
    """On clocks that differ, of which each SU's samples are its own."""
    return [Read((np.arange(N) + 0.3 * u + LATE * (u % 2)) / RATE, x) for u, x in enumerate(skins)]


@pytest.mark.parametrize("n", [12, 100])
def test_what_pushes_several_sus_is_kept(n: int) -> None:
    found = lonely_spikes(read(skins(0, moments(1, n))))
    assert not any(alone.any() for alone in found)


@pytest.mark.parametrize("n", [1, 12, 100])
def test_spikes_of_one_sensor_are_found(n: int) -> None:
    at, values = moments(2, n), skins(0, np.zeros(0, dtype=np.int64))
    values[0][at] += 5.0
    first, *others = lonely_spikes(read(values))
    assert np.array_equal(np.flatnonzero(first), np.sort(at))
    assert not any(alone.any() for alone in others)


def test_messages_that_a_bus_spoils_are_no_push() -> None:
    """All SUs on it have them at once."""
    at, values = moments(2, 60), skins(0, np.zeros(0, dtype=np.int64))
    for each in values:
        each[at] = 0.0
    for alone in lonely_spikes(read(values)):
        assert np.array_equal(np.flatnonzero(alone), np.sort(at))


def test_of_spikes_between_pushes_most_are_found() -> None:
    both = moments(3, 120)
    pushed, spiked = both[:80], both[80:]
    values = skins(0, pushed)
    values[0][spiked] += 5.0
    first = lonely_spikes(read(values))[0]
    assert not first[pushed].any()
    assert first[spiked].mean() > 0.4


def test_a_single_su_has_no_other_to_ask() -> None:
    at = moments(1, 100)
    (alone,) = lonely_spikes(read(skins(0, at)[:1]))
    assert np.array_equal(np.flatnonzero(alone), np.sort(at))
