"""Gaits: swings of several joints at once that are one swing, each joint's at a phase of its own.

They leave a pose and come back to it as patterns do. But of joints that swing at one frequency,
two swings a quarter of a period apart make all that any of them does, so that readings tell none of
three joints from the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import hilbert

from skin2urdf.arrays import F64
from skin2urdf.signals.motion import travel
from skin2urdf.signals.sampling import Sampled

_TAKES_PART = 0.1
"""Share of the largest swing, each over how far its joint goes in all, from which a joint takes
part in it: the drives of others give way by some hundredths."""
_AS_ONE = 0.5
"""Share of what joints have in common, at any phase, from which they swing as one: half."""


def are_gaits(sampled: Sequence[Sampled]) -> bool:
    """Whether in most swings around the poses of all logs several joints swing as one."""
    gaits = swings = 0
    for log in sampled:
        motion = log.motion
        far = travel(motion)
        for begin, end in (w for pose in log.neighbourhoods if pose.left for w in pose.windows):
            dq = motion.q[begin:end] - motion.q[begin]
            moved = np.abs(dq).max(axis=0, initial=0.0)
            if not (moved > motion.creep).any():
                continue
            share = np.divide(moved, far, out=np.zeros_like(far), where=far > 0)
            taking_part = share >= _TAKES_PART * share.max()
            swings += 1
            swing = motion.qd[begin:end, taking_part]
            gaits += taking_part.sum() > 1 and in_common(swing) > _AS_ONE
    return 2 * gaits > swings


def in_common(qd: F64) -> float:
    """What joints' swings have in common at any phase: 0 where nothing, 1 where they are one.

    The largest eigenvalue of their coherences is 1 where no two swing alike, and as many as they
    are where all do. Speeds tell, as a slow drift that goes with the swings is hardly in them.

    Args:
        qd: (n, m) speeds of two joints or more [rad/s or m/s].
    """
    swing = np.asarray(hilbert(qd - qd.mean(axis=0), axis=0))
    swing /= np.sqrt((np.abs(swing) ** 2).sum(axis=0))
    largest = np.linalg.eigvalsh(swing.conj().T @ swing)[-1]
    return float((largest - 1) / (qd.shape[1] - 1))
