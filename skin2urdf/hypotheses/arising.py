"""When an encoder's zero or sense changed, beside what poses and its track tell.

Poses tell between which of them a zero changed. In the move between them, readings follow from what
the encoder reports until it begins to slip, and from that less the slip once it has ended. A track
may turn round in several places in which a change of sense would hide; readings follow from one
sense before it, and from the other one after it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
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


def turning_between(
    dof: str,
    between: tuple[float, float],
    about: float,
    late: bool,
    known: tuple[Estimate, Features],
    s: Sampled,
) -> tuple[float, float]:
    """Times between which the readings say that a joint began to count the other way.

    Args:
        dof: the joint.
        between: times between which it did [s].
        about: sum of its positions with either sense [rad]; NaN where that is not known.
        late: whether it is the earlier ones that differ from what is known.
        known: an estimate from poses of this log with one sense, and features that tell the SUs'
            latencies.
        s: the log.

    Returns:
        Nearer times [s]; as they are where readings do not tell.
    """
    found, features = known
    motion, taps = s.motion, _taps(s)
    joint = found.tree.joint_names.index(dof)
    near = np.flatnonzero((motion.grid.time >= between[0]) & (motion.grid.time <= between[1]))
    if len(near) < len(taps) or not np.isfinite(about):
        return between
    part = _around(near, s)
    plain = filtered(motion.q[part, places_of(found.tree.joint_names, motion.dof_names)], taps)
    turned = np.array(plain)
    turned[:, joint] = about - plain[:, joint]
    before, after = (
        _left_by(found, features, s, part, (q, joint), found.state.up[0])[near - part.start]
        for q in ((turned, plain) if late else (plain, turned))
    )
    noise = np.nanmedian(np.minimum(before, after))
    if not np.isfinite(noise):
        return between
    # Up to a time the one sense holds, from there on the other. Samples that a filter joins are one
    # reading, and a change is blurred by a period of its cutoff.
    more = np.nancumsum(before - after)
    likely = near[more <= more.min() + _STANDS_OUT**2 * noise * len(taps)]
    reach = 1 / s.cutoff
    first, last = motion.grid.time[likely[0]] - reach, motion.grid.time[likely[-1]] + reach
    return float(max(first, between[0])), float(min(last, between[1]))


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
    motion = s.motion
    joint = found.tree.joint_names.index(error.dof)
    near = np.flatnonzero(np.abs(motion.grid.time - error.begin) <= error.spread)
    out = np.full(motion.grid.size, np.nan)
    if not len(near):
        return out
    part = _around(near, s)
    q = np.array(motion.q[part, places_of(found.tree.joint_names, motion.dof_names)])
    q[:, joint] += error.size * (motion.grid.time[part] >= error.begin)
    q = filtered(q, _taps(s))
    q[:, joint] -= offset
    left = _left_by(found, features, s, part, (q, joint), found.state.up[error.log])
    out[near] = left[near - part.start]
    return out


def _taps(s: Sampled) -> F64:
    """The filter that positions and readings of a log pass."""
    return low_pass(s.cutoff, s.motion.grid.rate)


def _around(near: Int, s: Sampled) -> slice:
    """The samples that those of a stretch depend on: the filters reach that far."""
    reach = 2 * len(_taps(s))
    return slice(max(0, int(near[0]) - reach), min(s.motion.grid.size, int(near[-1]) + reach + 1))


def _left_by(
    found: Estimate,
    features: Features,
    s: Sampled,
    part: slice,
    motion: tuple[F64, int],
    up: F64,
) -> F64:
    """(n,) mean square of what SUs beyond a joint read beside what follows from a motion.

    Args:
        found: an estimate.
        features: tell the SUs' latencies.
        s: the log.
        part: n samples of it.
        motion: (n, J) positions in it, low-passed, and the joint.
        up: (3,) direction opposite to gravity in the log.

    Returns:
        Squares [m^2/s^4]; NaN where all of those SUs lack readings.
    """
    tree, state, rate, taps = found.tree, found.state, s.motion.grid.rate, _taps(s)
    q, joint = motion
    qd, qdd = first_derivative(q, rate), second_derivative(q, rate)
    gravity = up * found.cost.priors.gravity
    ideal = filtered(specific_forces(state.model(tree), q, qd, qdd, gravity), taps)
    expected = np.einsum("uij,nuj->nui", state.sensor_matrix(), ideal) + state.bias
    square, count = np.zeros(len(q)), np.zeros(len(q))
    for u in np.flatnonzero(tree.activity()[:, joint]):
        column = features.su_names.index(tree.su_names[u])
        reading = shifted(s.readings[part, column], rate, float(features.latency[column]))
        left = filtered(filtered(reading, taps), taps) - expected[:, u]
        there = s.valid[part, column]
        square += np.where(there, (left**2).mean(axis=1), 0.0)
        count += there
    return np.asarray(square / np.where(count > 0, count, np.nan))
