"""Number the messages of a sensor by the phase of its clock, where stamps jitter and some are lost.

Samples are taken at the points of a lattice in time. A lost message leaves a point of it empty and
moves no other, so that the phase of stamps, their remainder after whole periods, tells nothing of
losses and all of the clock. Averaged as a direction over some hundred messages it is known to a
small part of a period although single stamps scatter by a third of one. The nearest points of the
lattice, with the count of messages so far taken away, are a staircase that rises by one at each
loss; the least squares of all staircases that do not fall (isotonic regression, Barlow et al.
1972), rounded, is the best one of whole numbers.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import isotonic_regression

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.numbering import LONG_PAUSE, Numbering, queue_of

# Messages over which phases are averaged: a clock off by 100 ppm moves by a twentieth of a period.
AVERAGED = 512
# How far below and above a first guess the period is looked for. Lost messages make it too long.
BELOW, ABOVE = 0.1, 0.02
# Windows that tell the period, evenly spread over the stream.
WINDOWS = 16
# Late messages in a row that raise no staircase are less than half as many.
LATE = 5


def number_on_lattice(stamp: F64, period: float) -> Numbering | None:
    """Number messages by the lattice that their stamps show.

    Args:
        stamp: (N,) stamps in the order of arrival [s].
        period: sampling period, as first guessed [s].

    Returns:
        The numbering, or None where there are too few messages or stamps show no lattice.
    """
    if stamp.size < AVERAGED:
        return None
    rate = rate_of(stamp - stamp[0], np.arange(stamp.size), 1.0 / period)
    if rate is None:
        return None
    pauses = np.flatnonzero(np.diff(stamp) * rate > LONG_PAUSE) + 1
    pieces = np.concatenate([[0], pauses])
    number = np.empty(stamp.size, dtype=np.int64)
    first = 0
    for begin, end in zip(pieces, [*pauses, stamp.size], strict=True):
        piece = _numbers((stamp[begin:end] - stamp[begin]) * rate)
        number[begin:end] = first + piece - piece[0]
        first = int(number[end - 1]) + 1
    return Numbering(number, pieces)


def rate_of(stamp: F64, message: Int, guess: float) -> float | None:
    """Rate [Hz] near a guess at which stamps are most in phase; None where they are at none.

    Args:
        stamp: (N,) stamps in the order of arrival, all of a stream or some [s].
        message: (N,) which message of the stream each is of.
        guess: rate of the sensor, as first guessed [Hz].
    """
    some = min(AVERAGED, stamp.size)
    begins = np.unique(np.linspace(0, stamp.size - some, WINDOWS).astype(np.int64))
    windows = stamp[begins[:, None] + np.arange(some)]
    windows = windows - windows.mean(axis=1, keepdims=True)
    # Half a turn between the ends of a window is what two neighbours in the grid may differ by. How
    # long it is follows from its messages: stamps may be off by years.
    longest = int((message[begins + some - 1] - message[begins]).max())
    step = 0.5 * guess / longest
    rates = np.arange(guess / (1 + ABOVE), guess / (1 - BELOW) + step, step)
    rough = np.array([_directions(windows * rate) for rate in rates])
    fine = rates[int(rough.argmax())] + step * np.linspace(-1.0, 1.0, 17)
    finest = np.array([_directions(windows * rate) for rate in fine])
    # Messages that come right behind each other are at one phase by their queue.
    alone = some / float(queue_of(windows, np.full(len(windows), 1.0 / guess)).mean())
    return float(fine[finest.argmax()]) if finest.max() > _shown(alone) else None


def phases_of(turns: F64) -> F64:
    """(N,) phase of a clock [turns], which drifts, from stamps in periods (N,) that scatter."""
    around = np.exp(2j * np.pi * turns)
    some = min(AVERAGED, turns.size)
    real, imaginary = (
        uniform_filter1d(part, some, mode="nearest") for part in (around.real, around.imag)
    )
    return np.asarray(np.unwrap(np.arctan2(imaginary, real)) / (2 * np.pi))


def _shown(count: float) -> float:
    """Mean length of so many phases as directions from which they show a lattice.

    It is 1 for stamps without noise; that of as many random phases exceeds this once in 30,000
    times.
    """
    return float(np.sqrt(10.0 / count))


def _directions(turns: F64) -> float:
    """Mean length of phases [turns] as directions: rms over windows (W, n)."""
    return float(np.sqrt(np.mean(np.abs(np.exp(2j * np.pi * turns).mean(axis=1)) ** 2)))


def _numbers(turns: F64) -> Int:
    """(N,) strictly increasing numbers of messages with stamps in periods, without a pause."""
    if turns.size < LATE:
        return np.maximum.accumulate(np.rint(turns).astype(np.int64) - np.arange(turns.size)) + (
            np.arange(turns.size)
        )
    ahead = turns - phases_of(turns) - np.arange(turns.size)
    stairs = isotonic_regression(median_filter(ahead, LATE, mode="nearest")).x
    return np.asarray(np.rint(stairs).astype(np.int64) + np.arange(turns.size))
