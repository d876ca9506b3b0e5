"""Messages that wait in queues are numbered by the earliest ones."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.arrays import F64
from skin2urdf.recording.bursts import burst_ends
from skin2urdf.recording.earliest import number_by_earliest
from skin2urdf.recording.regular import regular_times

PERIOD = 0.004


def sent(count: int, lost: float, rng: np.random.Generator) -> F64:
    """Times of messages of which some are lost [s], on a clock that is off by 20 ppm."""
    return np.asarray(PERIOD * (1 + 2e-5) * np.flatnonzero(rng.random(count) > lost))


def queued(time: F64, delay: float, rng: np.random.Generator) -> F64:
    """Stamps of messages that are late by an exponential delay [s], none before the one before."""
    late = time + rng.exponential(delay, len(time))
    after = 2e-5 * np.arange(len(time))
    return np.asarray(np.maximum.accumulate(late - after) + after)


@pytest.mark.parametrize(
    ("delay", "lost", "left"),
    [
        (0.5, 0.02, 0.25),
        (1.0, 0.015, 0.25),
        (1.0, 0.05, 0.5),
        (2.0, 0.015, 0.35),
        (3.0, 0.05, 0.5),
        (10.0, 0.0, 0.1),
        (10.0, 0.015, 0.25),
    ],
)
def test_times_of_messages_that_queue_are_nearer_than_their_stamps(
    delay: float, lost: float, left: float
) -> None:
    """A loss that is misplaced by some messages leaves these off by a period.

    Of those that are late by many periods hardly any shows the clock: what is lost is seen in the
    mean of whole queues.
    """
    rng = np.random.default_rng(1)
    time = sent(9000, lost, rng)
    stamp = queued(time, delay * PERIOD, rng)
    found = regular_times(stamp)
    assert found is not None
    assert np.std(found - time) < left * np.std(stamp - time)


def test_hardly_any_message_gets_a_wrong_number() -> None:
    rng = np.random.default_rng(2)
    time = sent(9000, 0.02, rng)
    numbering = number_by_earliest(queued(time, 0.5 * PERIOD, rng), 1.02 * PERIOD)
    assert numbering is not None
    true = np.rint((time - time[0]) / PERIOD / (1 + 2e-5)).astype(np.int64)
    assert np.mean(numbering.number != true) < 0.02
    assert (np.diff(numbering.number) > 0).all()


def test_where_none_is_lost_all_numbers_are_right() -> None:
    rng = np.random.default_rng(3)
    time = sent(9000, 0.0, rng)
    numbering = number_by_earliest(queued(time, PERIOD, rng), PERIOD)
    assert numbering is not None
    np.testing.assert_array_equal(numbering.number, np.arange(len(time)))


@pytest.mark.parametrize("case", ["no queue", "few", "a pause", "no clock"])
def test_what_tells_no_numbers_gets_none(case: str) -> None:
    rng = np.random.default_rng(4)
    time = sent(1000 if case == "few" else 6000, 0.02, rng)
    stamp = queued(time, PERIOD, rng)
    if case == "no queue":
        stamp = time + 0.1 * PERIOD * rng.standard_normal(len(time))
    if case == "a pause":
        stamp[3000:] += 1.0
    if case == "no clock":
        stamp = np.cumsum(rng.exponential(PERIOD, len(time)))
    assert number_by_earliest(stamp, 1.02 * PERIOD) is None


@pytest.mark.parametrize("delay", [2.0, 5.0])
@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_messages_that_queue_are_not_what_a_buffer_held(delay: float, lost: float) -> None:
    """Some queues hold more than came since the one before; no buffer does, whatever is lost."""
    rng = np.random.default_rng(5)
    time = sent(9000, lost, rng)
    assert burst_ends(queued(time, delay * PERIOD, rng)) is None
    read = 7 * PERIOD * np.ceil(time / (7 * PERIOD)) + 1e-5 * (np.arange(len(time)) % 7)
    assert burst_ends(read) is not None
