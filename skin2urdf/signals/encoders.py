"""Errors of encoders: leaps that no joint can make, and recordings with known errors taken off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.faults import Fault
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.health import is_within
from skin2urdf.signals.records import EncoderError, Features

_LEAP = 10.0
"""Change of a joint's step from one sample to the next, over the 99.9 % quantile of such changes.

Motion is smooth at the rate of joint states: where thousands of samples move, the largest change
stays within a small multiple of that quantile. The readings have the last word on a leap.
"""
_SHARP = 1.5
"""What a track's turning round leaves of its smoothness, over the 99.9 % quantile of that: of
normal noise, one in a hundred thousand samples exceeds it by 1.34."""
_STEPS = 3.5
"""Encoder steps that rounding alone can make of one smooth motion between samples, and more."""
_NEARBY = 4
"""Samples to either side whose usual step a leap is compared with: a median of nine passes over one
that leaps, and over its neighbour."""
_MOST = 20
"""Leaps of one joint beyond which they are its way of moving, or noise."""


def leaps(recording: Recording, log: int) -> tuple[EncoderError, ...]:
    """Places where an encoder's zero changes from one sample to the next.

    Args:
        recording: the log.
        log: its index.
    """
    return tuple(error for joint in recording.joints for error in _leaps(joint, log))


def _leaps(joint: JointStream, log: int) -> list[EncoderError]:
    x, t = joint.position, joint.time
    at, sudden, limit = _sudden(joint)
    for i, j in pairwise(at):
        # What comes back at once comes back all the way: less than a leap is seen as none.
        if j - i <= _NEARBY and abs(sudden[i] + sudden[j]) < limit:
            away = (sudden[i] - sudden[j]) / 2
            sudden[i], sudden[j] = away, -away
    stood = {end for _, end in _standing(x, at, limit)}
    return [
        EncoderError("offset", joint.name, float(sudden[i]), log, float((t[i] + t[i + 1]) / 2))
        for i in at.tolist()
        if i not in stood
    ]


def without_what_stood(recording: Recording) -> tuple[Recording, tuple[Fault, ...]]:
    """A recording without positions that stood still while joints moved on.

    A driver that hears nothing of an encoder sends its last position again and again. No joint
    stops from one sample to the next, nor is it elsewhere and on its way a sample later: where it
    was meanwhile nothing tells. Times are left out for all joints alike, as what one of them does
    is felt beyond the others.

    Args:
        recording: the log.

    Returns:
        What is left of it, and a fault for each joint that stood.
    """
    stood = {joint.name: _times_of_standing(joint) for joint in recording.joints}
    times = [span for spans in stood.values() for span in spans]
    if not times:
        return recording, ()
    joints = [joint.at(~is_within(joint.time, times)) for joint in recording.joints]
    faults = tuple(
        Fault(
            "frozen", name, "encoder", begin=spans[0][0], end=spans[-1][1],
            size=sum(end - begin for begin, end in spans), unit="s",
        )
        for name, spans in stood.items()
        if spans
    )  # fmt: skip
    return replace(recording, joints=tuple(joints)), faults


def _times_of_standing(joint: JointStream) -> list[tuple[float, float]]:
    """Times of a joint's first repetition, and of its next position, where it moved between [s]."""
    at, _, limit = _sudden(joint)
    stood = _standing(joint.position, at, limit)
    return [(float(joint.time[begin + 1]), float(joint.time[end + 1])) for begin, end in stood]


def _standing(x: F64, at: Int, limit: float) -> list[tuple[int, int]]:
    """First and last samples of what stood still while the joint moved, of a track (N,).

    Args:
        x: the track.
        at: samples after which it leaps.
        limit: change of a step that no motion makes.
    """
    out = []
    least = _STEPS * _finest(np.diff(x))
    for end in at.tolist():
        differs = np.flatnonzero(x[: end + 1] != x[end])
        begin = int(differs[-1]) + 1 if len(differs) else 0
        if end - begin < _NEARBY:
            continue
        # What leaps back at once is not on its way, nor are setpoints that go in leaps.
        before, behind = (
            _NEARBY * abs(float(np.median(np.diff(x[first : first + _NEARBY + 1]))))
            for first in (max(0, begin - 1 - _NEARBY), end + 1)
        )
        stops = before > least and abs(x[begin] - x[begin - 1]) > limit
        if stops or behind > least:
            out.append((begin, end))
    return out


def _sudden(joint: JointStream) -> tuple[Int, F64, float]:
    """Where a joint leaps.

    Returns:
        (L,) samples after which it does, (N - 1,) by how much steps differ from those around them,
        and the least that is a leap.
    """
    x, t = joint.position, joint.time
    step, period = np.diff(x), np.diff(t)
    if len(step) < 100:
        return np.zeros(0, dtype=np.int64), step, np.inf
    sudden = step - _middle(step)
    # A sample that was sent twice is no stop: by their times, such steps are none.
    speed = np.divide(step, period, out=np.zeros_like(step), where=period > 0)
    size = np.minimum(np.abs(sudden), np.abs(step - _middle(speed) * period))
    limit = max(_LEAP * float(np.quantile(size, 0.999)), _STEPS * _finest(step))
    # Across a gap, a joint can be anywhere, and what it does there says nothing of the other side.
    usual = float(np.median(period))
    first = np.maximum(np.arange(len(step)) - _NEARBY, 0)
    last = np.minimum(np.arange(len(step)) + _NEARBY + 1, len(step))
    near = t[last] - t[first] < 2 * (2 * _NEARBY + 1) * usual
    # Nor do the few samples before the first steps, at which a drive may as well set out.
    near[:_NEARBY] = near[len(near) - _NEARBY :] = False
    at = np.flatnonzero((size > limit) & (period < 1.5 * usual) & near)
    return at if len(at) <= _MOST else at[:0], sudden, limit


def _middle(values: F64) -> F64:
    """(N,) running median of values (N,)."""
    return np.asarray(median_filter(values, 2 * _NEARBY + 1, mode="nearest"))


def reversal(joint: JointStream, between: tuple[float, float]) -> float | None:
    """Time at which a joint's track turns round at once, as no joint can.

    Motion is smooth: a second difference is the mean of those around it, but for noise. Mirrored
    from one sample on, a track has one second difference that is not, and all are once the steps
    after it have the other sign.

    Args:
        joint: the track, without leaps.
        between: times between which it is [s].

    Returns:
        The time [s] of the sample that stands out; None where the joint kept still, or nearly so.
    """
    n, step = _NEARBY, np.diff(joint.position)
    low, high = _inside(joint, between)
    if high - low < 3:
        return None
    plain, mirrored = _sharpness(step)
    gain = (plain - mirrored)[low - n - 1 : high - n - 1]
    best = int(np.argmax(gain))
    if gain[best] <= _least_sharp(step, plain):
        return None
    return float(joint.time[low + best : low + best + 2].mean())


def standstill(joint: JointStream, between: tuple[float, float]) -> float:
    """Middle of the longest standstill of a joint, in which its track may turn round unseen.

    Args:
        joint: the track, without leaps.
        between: times between which it is [s].

    Returns:
        The time [s]; where it does not stand still, that of the slowest motion.
    """
    step = np.diff(joint.position)
    low, high = _inside(joint, between)
    if high - low < 3:
        return sum(between) / 2
    # A change of sense hides where the steps on either side of it are as small as that.
    small = np.sqrt(_least_sharp(step, _sharpness(step)[0]))
    speed = np.abs(step[low:high])
    slow = speed <= max(small / 2, speed.min())
    begin, end = _longest(slow)
    return float(joint.time[low + begin : low + end + 1].mean())


def turning_for(joint: JointStream, begin: float, size: float) -> float | None:
    """Time from which a track is mirrored if later positions are to be other ones, the nearest.

    Where a joint hardly moves, a track may turn round unseen in many places, each with another
    value about which it is mirrored.

    Args:
        joint: the track, as reported.
        begin: time from which it was taken for mirrored [s].
        size: by how much the positions after it come out too large so [rad or m].

    Returns:
        The time [s]; None where no place gives such positions to a step of the encoder.
    """
    about = _about(joint.position)
    i = int(np.searchsorted(joint.time, begin)) - 2
    if not 0 <= i < len(about):
        return None
    off = about - (about[i] - size)
    passed = np.flatnonzero(off[:-1] * off[1:] <= 0)
    if len(passed):
        near = int(passed[np.argmin(np.abs(passed - i))])
        best = min(near, near + 1, key=lambda k: abs(off[k]))
    else:
        best = int(np.argmin(np.abs(off)))
        if abs(off[best]) > _finest(np.diff(joint.position)):
            return None
    return float(joint.time[best + 1 : best + 3].mean())


def _inside(joint: JointStream, between: tuple[float, float]) -> tuple[int, int]:
    """First step of a track between two times, and one past the last, that has neighbours."""
    first, last = np.searchsorted(joint.time, between)
    return max(_NEARBY + 1, int(first)), min(len(joint.time) - 1 - _NEARBY, int(last) - 1)


def _sharpness(step: F64) -> tuple[F64, F64]:
    """Squares of second differences beside their neighbours', as they are and if mirrored there."""
    n = _NEARBY
    i = np.arange(n + 1, len(step) - n)
    before, after = (step[i - 1] - step[i - 1 - n]) / n, (step[i + n] - step[i]) / n
    plain = (step[i] - step[i - 1] - (before + after) / 2) ** 2
    return plain, (-step[i] - step[i - 1] - (before - after) / 2) ** 2


def _least_sharp(step: F64, plain: F64) -> float:
    """Square of a second difference that stands out from a track's noise."""
    return max((_SHARP**2) * float(np.quantile(plain, 0.999)), _finest(step) ** 2)


def _longest(there: Bool) -> tuple[int, int]:
    """First index of the longest stretch of True, and one past its last; (0, 0) for none."""
    edges = np.flatnonzero(np.diff(np.r_[False, there, False].astype(np.int8))).reshape(-1, 2)
    if not len(edges):
        return 0, 0
    begin, end = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    return int(begin), int(end)


def _finest(step: F64) -> float:
    """Smallest change of a track, its encoder's step where it has one."""
    changes = np.abs(step[step != 0])
    return float(np.quantile(changes, 0.02)) if changes.size else 0.0


def corrected(recordings: Sequence[Recording], errors: Sequence[EncoderError]) -> list[Recording]:
    """The recordings with errors of encoders taken off, in the order given."""
    return [
        replace(recording, joints=tuple(_corrected(j, log, errors) for j in recording.joints))
        for log, recording in enumerate(recordings)
    ]


def _corrected(joint: JointStream, log: int, errors: Sequence[EncoderError]) -> JointStream:
    x: F64 = joint.position
    for error in errors:
        if error.dof != joint.name:
            continue
        if error.kind == "scale":
            x = x / error.size
        elif error.log == log and error.kind == "sign":
            x = _mirrored(joint.time, x, error.begin)
        elif error.log == log:
            x = x - error.size * (joint.time >= error.begin)
    return joint if x is joint.position else replace(joint, position=x)


def _mirrored(time: F64, x: F64, begin: float) -> F64:
    """Positions (N,) with the other sign from a time on, so that they go on as they did before."""
    i = int(np.searchsorted(time, begin))
    if not 2 <= i < len(x) - 1:
        return -x if i < 2 else x
    return np.concatenate([x[:i], _about(x)[i - 2] - x[i:]])


def _about(x: F64) -> F64:
    """(N - 3,) sum of positions before and after, were a track (N,) mirrored from each sample on.

    The first of them is of the third sample: a track goes on as it did before.
    """
    step = ((x[1:-2] - x[:-3]) - (x[3:] - x[2:-1])) / 2
    return x[1:-2] + step + x[2:-1]


def corrected_features(features: Features, error: EncoderError) -> Features:
    """Features as they would be without an offset or a scale, to first order around each pose."""
    D = features.n_dofs
    at = np.arange(D) == features.dof_names.index(error.dof)
    if error.kind == "offset":
        later = (features.log == error.log) & (features.span.mean(axis=1) >= error.begin)
        return replace(features, q=features.q - error.size * (later[:, None] & at))
    scale = np.where(at, error.size, 1.0)
    rows = np.concatenate([[1.0], scale, scale])
    return replace(
        features,
        q=features.q / scale,
        coefficients=features.coefficients * rows[:, None],
        information=features.information.scaled(1 / rows),
        encoders=features.encoders.rescaled(scale),
    )
