"""Number the messages of a sensor by those that came earliest, where the way makes most late.

Messages that wait in queues come late by periods, and right behind each other: neither jumps of
stamps nor their phase tell how many were lost. No message comes before it was sent, though. The
earliest of some that follow each other are late by little, and lie on the lattice of the sensor's
clock whatever the others do (the lower envelope of delays, by which clocks are compared over
networks: Paxson 1998). With that clock, the likeliest numbers of all messages follow (Viterbi 1967)
from how late messages come, and how often one is lost: of delays that are exponential, which is
what is known of those of which the mean is.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import minimum_filter1d
from scipy.optimize import isotonic_regression

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.recording.lattice import phases_of, rate_of
from skin2urdf.recording.numbering import BEHIND, LONG_PAUSE, Numbering

# Messages of which the earliest counts: of delays of a period in the mean the least of so many is a
# sixteenth of one, and of losses of 3 per cent every second such group is free.
AMONG = 16
# Part of a period by which a message may come before the earliest ones say that it was sent.
EARLY = 1.0 / AMONG
# Share of messages that do where delays are a third of a period in the mean; below that jumps and
# phases tell as much.
WAITING = 0.02
# Losses at once, and numbers beside those of the earliest, that are compared.
LOSSES, BESIDE = 4, 7
# Of the earliest ones, the fewest that tell a clock.
FEWEST = 128
# Messages that are numbered together, and those before and after that only lead there.
TOGETHER, LEAD = 512, 64


def number_by_earliest(stamp: F64, period: float) -> Numbering | None:
    """Number messages by the earliest ones.

    Args:
        stamp: (N,) stamps in the order of arrival [s].
        period: sampling period, as first guessed, which losses make too long [s].

    Returns:
        The numbering, or None where messages do not queue, where the earliest are too few or show
        no lattice, and where the stream pauses.
    """
    step = np.diff(stamp)
    if (step < BEHIND * period).mean() < WAITING or step.max() > LONG_PAUSE * period:
        return None
    ahead = stamp - period * np.arange(stamp.size)
    early = np.flatnonzero(ahead == minimum_filter1d(ahead, AMONG, mode="nearest"))
    if early.size < FEWEST:
        return None
    turns = stamp - stamp[0]
    rate = rate_of(turns[early], early, 1.0 / period)
    if rate is None:
        return None
    turns *= rate
    turns -= np.interp(turns, turns[early], phases_of(turns[early]))
    stairs = np.rint(isotonic_regression(turns[early] - early).x)
    rough = np.interp(np.arange(stamp.size), early, stairs).astype(np.int64)
    number = np.maximum.accumulate(_likeliest(turns, rough)) + np.arange(stamp.size)
    return Numbering(number - number[0], np.zeros(1, dtype=np.int64))


def _likeliest(turns: F64, rough: Int) -> Int:
    """(N,) likeliest number of messages that were lost before each one.

    Args:
        turns: (N,) stamps on the sensor's clock [periods], at whole numbers where nothing is late.
        rough: (N,) about the number that was lost.
    """
    N, index = turns.size, np.arange(turns.size)
    late = turns - index - rough
    mean = max(float(late.mean()), EARLY)
    share = min(max(1.0 - N / (N + float(rough[-1] - rough[0])), 1.0 / N), 0.5)
    step = np.append(1.0, np.diff(turns))
    begins = np.arange(0, N, TOGETHER)
    # (W, n) messages of each window; what lies beyond the ends is the first or last one again.
    members = np.clip(begins[:, None] + np.arange(-LEAD, TOGETHER + LEAD), 0, N - 1)
    inside = np.diff(members, axis=1, prepend=-1) > 0
    base = rough[members[:, LEAD]]
    best = _paths(
        turns[members] - members - base[:, None], step[members] < BEHIND, inside, mean, share
    )
    lost = np.zeros(N, dtype=np.int64)
    middle = slice(LEAD, LEAD + TOGETHER)
    lost[members[:, middle]] = (best + base[:, None])[:, middle]
    return lost


def _paths(late: F64, queued: Bool, inside: Bool, mean: float, share: float) -> Int:
    """(W, n) likeliest losses of messages of W windows, over the number that they are late by.

    Args:
        late: (W, n) by how much messages come after their place among those that came [periods].
        queued: (W, n) whether a message came right behind the one before.
        inside: (W, n) False for messages that are there twice.
        mean: delay [periods].
        share: of messages that are lost.
    """
    W, n = late.shape
    reach = BESIDE + int(np.ceil(share * n * 2))
    numbers = np.arange(-reach, reach + 1)
    moves = np.arange(LOSSES) * np.log(share) + np.log1p(-share)
    score = np.zeros((W, numbers.size))
    came = np.zeros((n, W, numbers.size), dtype=np.int8)
    for i in range(n):
        if i:
            padded = np.pad(score, ((0, 0), (LOSSES - 1, 0)), constant_values=-np.inf)
            ways = np.stack(
                [padded[:, LOSSES - 1 - k : padded.shape[1] - k] + moves[k] for k in range(LOSSES)]
            )
            came[i] = np.where(inside[:, i, None], ways.argmax(axis=0), 0)
            score = np.where(inside[:, i, None], ways.max(axis=0), score)
        delay = late[:, i, None] - numbers
        some = np.maximum(delay, EARLY) / mean
        known = np.where(queued[:, i, None], np.log(-np.expm1(-some)), -some - np.log(mean))
        known -= 0.5 * (np.minimum(delay, 0.0) / EARLY) ** 2
        score = score + np.where(inside[:, i, None], known, 0.0)
    place = score.argmax(axis=1)
    out = np.empty((W, n), dtype=np.int64)
    for i in range(n - 1, -1, -1):
        out[:, i] = numbers[place]
        place = place - came[i, np.arange(W), place]
    return out
