"""Publishers of joint states with clocks of their own: one found from the readings of SUs.

Arm and gripper, or torso and arms, often publish their joints on their own, each on its own clock.
Joints show nothing of each other, but an SU that several publishers' joints move feels all of them
at once. In a stretch of some seconds its readings lie in what the motions of all joints span where
each publisher's are taken at their own lag (:mod:`skin2urdf.signals.stretches`). So what is left of
the readings is a profile likelihood of two lags, that of the SU and that of the publisher, both
against the joints of a first publisher; the line of lags that suits all stretches and all SUs best
is the publisher's clock.

It is good to a grid's step of some 30 ms: the fit of all samples goes on from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, frozen
from skin2urdf.errors import InsufficientDataError
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.clocks import LARGEST_DRIFT, LARGEST_OFFSET
from skin2urdf.signals.filters import Spline
from skin2urdf.signals.motion import Motion, joint_motion, publishers_beyond_first
from skin2urdf.signals.records import JointClock, SuClock
from skin2urdf.signals.stretches import (
    EVERY,
    FEWEST,
    SAMPLES,
    SIGNIFICANT,
    Heard,
    best_line,
    binned,
    means_of,
    spanned,
    whole_bins,
    windows,
)

LARGEST_LAG = 1.0
"""Lag of a publisher that is looked for, its drift in [s]."""
_CERTAIN = 10.0
"""Logarithm of the likelihood that a lag has to gain for each number of its line, offset and drift,
which chance does once in 20,000; sound recordings gain nothing."""


def joint_clocks(recording: Recording) -> tuple[JointClock, ...]:
    """Clocks of publishers of joint states that seem to be far off that of most joints.

    What some seconds of readings propose, all samples of the log have to confirm.

    Args:
        recording: the log, with every stream on its own clock.

    Returns:
        One record for each publisher whose clock seems to be off, none for the others, and none
        where the joints are too few or their streams too short to tell.
    """
    times = [joint.time for joint in recording.joints]
    if all(np.array_equal(time, times[0]) for time in times):
        return ()
    try:
        motion = joint_motion(recording)
    except InsufficientDataError:
        return ()
    sus = [su for su in recording.sus if len(su.time) >= SAMPLES]
    others = publishers_beyond_first(motion.publisher, motion.moved)
    if not others or not sus:
        return ()
    middle = motion.grid.start + (motion.grid.size - 1) / (2 * motion.grid.rate)
    unknown = SuClock("", 0.0, np.inf, 0.0, np.inf, middle)
    means = [means_of(su, unknown, motion) for su in sus]
    readings = np.stack([values for values, _ in means], axis=1)
    valid = np.stack([whole for _, whole in means], axis=1)
    found = []
    for joints in others:
        line = _line(motion, joints, readings, valid)
        if line is not None:
            names = tuple(motion.dof_names[j] for j in joints)
            step = EVERY / motion.grid.rate
            half = motion.grid.size / motion.grid.rate / 2
            sd = step / np.sqrt(12)
            found.append(JointClock(names, line[0], sd, line[1], sd / half, middle))
    return tuple(found)


def on_one_clock(recording: Recording, clocks: Sequence[JointClock]) -> Recording:
    """A recording with the stamps of publishers of joint states set right.

    Args:
        recording: the log.
        clocks: of publishers.
    """
    by_joint = {name: clock for clock in clocks for name in clock.joints}
    times: dict[tuple[int, JointClock], F64] = {}

    def moved(joint: JointStream) -> JointStream:
        clock = by_joint.get(joint.name)
        if clock is None:
            return joint
        key = id(joint.time), clock
        if key not in times:
            times[key] = frozen(clock.undone(joint.time))
        return replace(joint, time=times[key])

    return replace(recording, joints=tuple(map(moved, recording.joints))) if clocks else recording


def together(one: Sequence[JointClock], other: Sequence[JointClock]) -> tuple[JointClock, ...]:
    """Clocks that were found first, with what was found of them once they were set right.

    Args:
        one: found first.
        other: found of logs that were set right by these.
    """
    later = {clock.joints: clock for clock in other}
    out = []
    for clock in one:
        more = later.pop(clock.joints, None)
        if more is None:
            out.append(clock)
            continue
        middle = np.array([clock.middle])
        out.append(
            replace(
                clock,
                latency=float((clock.stamped(more.stamped(middle)) - middle)[0]),
                latency_sd=more.latency_sd,
                drift=(1 + clock.drift) * (1 + more.drift) - 1,
                drift_sd=more.drift_sd,
            )
        )
    return (*out, *later.values())


def all_that_are_off(
    one: Sequence[Sequence[JointClock]], other: Sequence[Sequence[JointClock]]
) -> tuple[tuple[JointClock, ...], ...]:
    """By log, what was found in all of clocks that are off by more than their deviations make.

    Args:
        one: found first, by log.
        other: found of logs that were set right by these.
    """
    return tuple(
        tuple(
            clock
            for clock in together(first, then)
            if abs(clock.latency) > SIGNIFICANT * clock.latency_sd
            or abs(clock.drift) > SIGNIFICANT * clock.drift_sd
        )
        for first, then in zip(one, other, strict=True)
    )


def _line(motion: Motion, joints: Int, readings: F64, valid: Bool) -> tuple[float, float] | None:
    """Offset [s] and drift of a publisher's clock; None where none is certain.

    Args:
        motion: of all joints.
        joints: those of the publisher.
        readings: (n, U, 3) means over the bins of the search [m/s^2].
        valid: (n, U) where they are whole.
    """
    rate, span = motion.grid.rate / EVERY, motion.grid.size / motion.grid.rate
    most = int(LARGEST_LAG * rate)
    own = np.arange(-most, most + 1) / rate
    profile = _Profile.of(motion, joints, readings, valid, own)
    if profile is None:
        return None
    lags, time, rows = profile.lags, profile.time, np.arange(len(profile.time))
    total, without = np.zeros((len(time), len(own))), 0.0

    def along(offset: float, drift: float, grid: F64) -> Int:
        """(W,) where a line is on a grid of lags."""
        at = np.rint((offset + drift * time - grid[0]) * rate).astype(int)
        return np.asarray(np.clip(at, 0, len(grid) - 1))

    for u in np.flatnonzero(profile.counted.sum(axis=0) >= FEWEST):
        use, weight = profile.counted[:, u], profile.free[:, u, None]
        score = weight[..., None] * profile.score[..., u]
        if not weight[use].any():
            continue
        # Whatever the publisher's lag is in every stretch, and where it has none: what an SU that
        # feels no other publisher explains by one clock, it explains by its own as well.
        lines = [
            along(*best_line(time[use], seen, lags, LARGEST_OFFSET, LARGEST_DRIFT, span), lags)
            for seen in (score[use].max(axis=1), score[use, most])
        ]
        total += np.where(use[:, None], score[rows, :, lines[0]], 0.0)
        without += float(score[rows, most, lines[1]][use].sum())
    offset, drift = best_line(time, total, own, LARGEST_LAG, LARGEST_DRIFT, span)
    gain = float(total[rows, along(offset, drift, own)].sum()) - without
    return (offset, drift) if gain > 2 * _CERTAIN else None


class _Profile:
    """What motion leaves of the readings at every lag of a publisher and of U SUs.

    Attributes:
        score: (W, R, K, U) minus half the logarithm of what is left, in W stretches at R lags of
            the publisher and K of an SU.
        counted: (W, U) where motion is felt and explains most.
        free: (W, U) independent values beyond those that motion takes for itself.
        time: (W,) times of the stretches since the middle of the log [s].
        lags: (K,) lags of an SU [s].
    """

    def __init__(self, score: F64, counted: Bool, free: F64, time: F64, lags: F64) -> None:
        self.score, self.counted, self.free = score, counted, free
        self.time, self.lags = time, lags

    @classmethod
    def of(
        cls, motion: Motion, joints: Int, readings: F64, valid: Bool, own: F64
    ) -> _Profile | None:
        """The profile of a publisher's joints at lags (R,) of its own; None without stretches."""
        n, U = valid.shape
        rate = motion.grid.rate / EVERY
        most = int(np.ceil((LARGEST_OFFSET + LARGEST_DRIFT * n / (2 * rate)) * rate)) + 2
        mine = np.array([j for j in joints if motion.moved[j]])
        others = np.setdiff1d(np.flatnonzero(motion.moved), joints)
        both = np.hstack([motion.q, motion.qdd])
        D = motion.q.shape[1]
        q, fixed = binned(motion.q), binned(both[:, [*others, *(D + others)]])
        shifted = _shifted(both[:, [*mine, *(D + mine)]], motion.grid.rate, own)
        recorded = whole_bins(motion.valid)
        holes = np.cumsum(np.concatenate([np.zeros((1, U)), ~valid]), axis=0)
        still, pad = motion.creep, int(np.ceil(float(np.abs(own).max()) * rate))
        times, scores, counts, freedoms = [], [], [], []
        for part in windows(n, motion):
            wide = q[max(0, part.start - pad) : part.stop + pad]
            active = np.ptp(wide, axis=0) > still
            about = slice(max(part.start - most, 0), min(part.stop + most, n))
            length = part.stop - part.start
            short = about.stop - about.start < length + min(8, 2 * most)
            if short or not active[mine].any() or not recorded[part].all():
                continue
            moving = np.ptp(q[part], axis=0) > still
            basis = spanned(fixed[part][:, np.tile(moving[others], 2)])
            heard = Heard(readings[about], length)
            if not heard.free(basis.shape[1]).any():
                continue
            steady = heard.inside(basis)
            inside, constant = steady.sum(axis=2), steady[..., 0]
            score, most_there, counted = [], 0, np.zeros(U, dtype=bool)
            for columns in shifted:
                more = _beside(basis, columns[part][:, np.tile(active[mine], 2)])
                most_there = max(most_there, more.shape[1])
                judged = heard.judged(inside + heard.inside(more).sum(axis=2), constant)
                left = judged.share
                counted |= judged.felt & judged.explained
                # Beyond the log nothing is known: lags that reach there count as the worst.
                curve = np.repeat(-left.max(axis=0)[None], 2 * most + 1, axis=0)
                first = about.start - (part.start - most)
                curve[first : first + len(left)] = -left
                score.append(curve.astype(np.float32))
            times.append((part.start + length / 2 - n / 2) / rate)
            scores.append(np.array(score))
            counts.append(counted & (holes[about.stop] == holes[about.start]))
            freedoms.append(heard.free(basis.shape[1] + most_there))
        if not times:
            return None
        lags = np.arange(-most, most + 1) / rate
        return cls(np.array(scores), np.array(counts), np.array(freedoms), np.array(times), lags)


def _shifted(columns: F64, rate: float, own: F64) -> list[F64]:
    """Means over the bins of what (N, C) columns are where their stamps are late by each lag."""
    spline, grid = Spline(columns), np.arange(len(columns))
    return [binned(spline.within(np.clip(grid + lag * rate, 0, len(grid) - 1))) for lag in own]


def _beside(basis: F64, columns: F64) -> F64:
    """(L, r) orthonormal basis of what columns (L, C) span beside another basis."""
    columns = columns - columns.mean(axis=0)
    size = np.sqrt((columns**2).sum(axis=0))
    columns = columns[:, size > 0] / size[size > 0]
    columns = columns - basis @ (basis.T @ columns)
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, values > 1e-2])
