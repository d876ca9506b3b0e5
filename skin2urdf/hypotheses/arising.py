"""When an encoder's zero changed, while the robot moved from one pose to the next.

Poses tell between which of them a zero changed. In the move between them, readings follow from what
the encoder reports until it begins to slip, and from that less the slip once it has ended.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import (
    filtered,
    first_derivative,
    low_pass,
    second_derivative,
    shifted,
)
from skin2urdf.signals.records import EncoderError, Features
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.ordering import places_of

_STANDS_OUT = 3.0
"""Mean size of what is left, over that in the rest of the move, from which readings do not follow:
three standard deviations, as a mean over dozens of measurements exceeds it by no chance."""


def narrowed(
    error: EncoderError, found: Estimate, features: Features, sampled: Sampled
) -> EncoderError:
    """An offset with the time at which it arises, as near as the readings tell.

    Args:
        error: arises somewhere between two poses.
        found: an estimate with the error taken off.
        features: what it rests on.
        sampled: the log in which it arises, with the error taken off from ``begin`` on.

    Returns:
        The error with another time and a smaller spread; as it is where readings do not tell.
    """
    before, after = (_left(error, found, features, sampled, x) for x in (0.0, error.size))
    time = sampled.motion.grid.time
    inside = np.flatnonzero(np.abs(time - error.begin) <= error.spread)
    if len(inside) < 3 or not np.isfinite(before[inside] + after[inside]).all():
        return error
    limit = _STANDS_OUT**2 * float(np.median(np.minimum(before, after)[inside]))
    first, last = before[inside] > limit, after[inside] > limit
    if not (first.any() and last.any()):
        return error
    begin = inside[int(np.argmax(first))]
    end = inside[len(inside) - 1 - int(np.argmax(last[::-1]))]
    if end <= begin:
        return error
    middle = float(time[begin] + time[end]) / 2
    return replace(error, begin=middle, spread=float(time[end] - time[begin]) / 2)


def _left(
    error: EncoderError, found: Estimate, features: Features, s: Sampled, offset: float
) -> F64:
    """(N,) mean square of what SUs beyond the joint read beside what follows from an offset.

    Args:
        error: the whole offset, where it begins.
        found: an estimate.
        features: tell the SUs' latencies.
        s: the log, with the error taken off.
        offset: of the joint's encoder at any time [rad or m].

    Returns:
        Squares [m^2/s^4]; NaN where all of those SUs lack readings, or near the move's ends.
    """
    tree, motion, state = found.tree, s.motion, found.state
    rate, taps = motion.grid.rate, low_pass(s.cutoff, motion.grid.rate)
    joint = tree.joint_names.index(error.dof)
    beyond = np.flatnonzero(tree.activity()[:, joint])
    near = np.flatnonzero(np.abs(motion.grid.time - error.begin) <= error.spread)
    out = np.full(motion.grid.size, np.nan)
    if not len(near) or not len(beyond):
        return out
    # The filters reach that far.
    part = slice(max(0, near[0] - 2 * len(taps)), near[-1] + 2 * len(taps))
    q = np.array(motion.q[part, places_of(tree.joint_names, motion.dof_names)])
    q[:, joint] += error.size * (motion.grid.time[part] >= error.begin)
    q = filtered(q, taps)
    qd, qdd = first_derivative(q, rate), second_derivative(q, rate)
    q[:, joint] -= offset
    up = state.up[error.log] * found.cost.priors.gravity
    ideal = filtered(specific_forces(state.model(tree), q, qd, qdd, up), taps)
    expected = np.einsum("uij,nuj->nui", state.sensor_matrix(), ideal) + state.bias
    square, count = np.zeros(len(q)), np.zeros(len(q))
    for u in beyond:
        column = features.su_names.index(tree.su_names[u])
        reading = shifted(s.readings[part, column], rate, float(features.latency[column]))
        left = filtered(filtered(reading, taps), taps) - expected[:, u]
        there = s.valid[part, column]
        square += np.where(there, (left**2).mean(axis=1), 0.0)
        count += there
    out[near] = (square / np.where(count > 0, count, np.nan))[near - part.start]
    return out
