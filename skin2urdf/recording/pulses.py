"""Single samples that depart far from all around them: spikes, and pulses of motion.

A bus, a driver or a sensor spoils messages of one SU, or of several at once. But a controller that
steps the velocity of a joint pushes all SUs beyond it for as long as a sample, and to leave that
out takes part of the motion away. Such pulses come when other SUs are shaken more than they are in
the mean, in samples that are none of their own spikes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.stats import gamma, rankdata

from skin2urdf.arrays import F64, Bool
from skin2urdf.recording.credibility import spikes

# By how much clocks of two SUs may differ [s]: those of hosts without a common one are set to a
# tenth of a second, and what differs by more leaves pulses to be spikes.
_APART = 0.3
# Lags up to which it is asked how much an SU is shaken at any time [s], and how many each way.
_USUAL = 3.0
_LAGS = 10
# Samples of another SU that are about one moment: clocks fall in between.
_NEARBY = 3
# Logarithm of the odds from which it is certain that samples come when another SU is shaken.
_CERTAIN = 10.0


class Read(NamedTuple):
    """What an SU reads.

    Attributes:
        time: (N,) of its samples, rising [s].
        values: (N, 3) them [m/s^2].
    """

    time: F64
    values: F64


def lonely_spikes(read: Sequence[Read]) -> list[Bool]:
    """Single samples that no motion made, of SUs on one robot.

    Args:
        read: of some SUs on clocks that are about the same.

    Returns:
        (N,) of each, True for them.
    """
    alone = [spikes(each.values) for each in read]
    if not any(found.any() for found in alone):
        return alone
    shaken = {
        u: (each.time, _shaken(each.values, found))
        for u, (each, found) in enumerate(zip(read, alone, strict=True))
        if len(each.time) > 2
    }
    return [
        _not_felt(read[u].time, found, [other for v, other in shaken.items() if v != u])
        for u, found in enumerate(alone)
    ]


def _shaken(values: F64, alone: Bool) -> F64:
    """(N,) by how much an SU is shaken about each sample: logarithm of how seldom it is so much.

    Args:
        values: (N, 3) what it reads.
        alone: (N,) samples that may be spikes, by which nothing is shaken.
    """
    bend = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    kink = np.pad(np.sqrt(np.einsum("nc,nc->n", bend, bend)), 1)
    kink[maximum_filter1d(alone.astype(np.int8), 3) > 0] = 0.0
    score = -np.log1p(-(rankdata(kink) - 0.5) / len(kink))
    return np.asarray(maximum_filter1d(score, _NEARBY))


def _not_felt(time: F64, alone: Bool, others: Sequence[tuple[F64, F64]]) -> Bool:
    """(N,) samples that may be spikes, of which others feel none.

    Args:
        time: (N,) of an SU's samples [s].
        alone: (N,) those that may be spikes.
        others: times of other SUs, and by how much these are shaken.
    """
    at = time[alone]
    if not len(at):
        return alone
    certain = _CERTAIN + np.log(max(len(others), 1))
    felt = [there for each in others if (there := _when(at, *each, certain)) is not None]
    if not felt:
        return alone
    out = alone.copy()
    out[alone] = np.mean(felt, axis=0) < 0
    return out


def _when(at: F64, time: F64, shaken: F64, certain: float) -> F64 | None:
    """(K,) by how much more than usual another SU is shaken at some times, on its own clock.

    What is usual shows at lags that no clocks have. At moments of no account scores are about
    exponential, and sums of them have about a gamma distribution.

    Args:
        at: (K,) the times [s].
        time: (N,) of its samples [s].
        shaken: (N,) by how much it is shaken.
        certain: logarithm of the odds that are asked of a single SU.

    Returns:
        None where it is shaken by no more than at other times, for certain, at any lag.
    """
    step = max(float(np.median(np.diff(time))), _APART / 100)
    near = np.arange(-_APART, _APART + step, step)
    far = np.linspace(_APART, _USUAL, _LAGS)

    def about(lags: F64) -> F64:
        return np.asarray(shaken[np.searchsorted(time, at[:, None] + lags).clip(max=len(time) - 1)])

    there, usual = about(near), float(about(np.concatenate([-far, far])).mean())
    best = int(np.argmax(there.sum(axis=0)))
    more = (there[:, best] - usual).sum() / max(float(shaken.std()), 1e-12)
    chance = gamma.logsf(len(at) + more, len(at)) + np.log(len(near))
    return there[:, best] - usual if chance < -certain else None
