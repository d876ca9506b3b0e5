"""Moments in which what a fit of all samples leaves is more than noise: hits, if nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.trajectory.kinematics import levers
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.signals.sampling import Sampled

_HIT = 3.0
"""Mean size of what is left during a hit, in standard deviations of noise, from which it is one."""
_MOMENT = 0.5
"""Length of moments that may stand out [s]: about that of the shortest hit that matters."""


def anything_stands_out(along: MotionEstimate) -> bool:
    """Whether any half second of an SU is far from what noise and all that was found leave.

    What yields is followed as slowly as it moves; a spring that is let go overshoots by as much
    again, and rings on.
    """
    problem, fitted = along.problem, along.fitted
    unseen = problem.unseen
    stiff = problem.stiff() if unseen else problem
    at = replace(fitted.state, unseen=np.zeros(stiff.layout.n_unseen))
    for g, (log, p) in enumerate(zip(problem.logs, fitted.predicted, strict=True)):
        size = max(1, round(_MOMENT * len(log.kept) / float(log.time[-1] - log.time[0])))
        first = np.arange(0, len(log.kept), size)
        count = np.diff(np.append(first, len(log.kept)))

        noise = _usual(along, g)
        left = _mean_squares(p.residual / noise, p.measured, first, count)
        if unseen:
            by_spring = (stiff.predict(at, g).residual - p.residual) / noise
            bent = _mean_squares(by_spring, p.measured, first, count)
            before = np.concatenate([bent[:1], bent[:-1]])
            left /= 1 + np.maximum(bent, before)
        if left.max() > _HIT**2:
            return True
    return False


def stands_out(
    along: MotionEstimate,
    sampled: Sequence[Sampled],
    g: int,
    begin: float,
    end: float,
    *,
    pushed: str | None = None,
) -> bool:
    """Whether what a fit leaves in some time is more than noise and play, in any SU.

    A joint that was pushed moves the SUs beyond it by more than any other: what an SU on a base
    that gives way feels alone came from elsewhere.

    Args:
        along: the fit.
        sampled: its logs.
        g: number of the log.
        begin: of the time [s], and
        end: its end; a time that is not known stands out.
        pushed: the joint whose SUs count; by default all do.
    """
    log, fitted = along.problem.logs[g], along.fitted
    if not (np.isfinite(begin) and np.isfinite(end)):
        return True
    time = log.time + sampled[g].motion.grid.start
    during = (time >= begin) & (time <= end)
    if not during.any():
        return True
    seen = fitted.predicted[g].measured[during, :, None]
    noise = np.hypot(_usual(along, g)[during], _rattle(along, g)[:, None])
    ratio = np.where(seen, fitted.predicted[g].residual[during] / noise, 0.0)
    left = (ratio**2).mean(axis=(0, 2))
    tree = along.problem.tree
    if pushed in tree.joint_names:
        left = left[tree.activity()[:, tree.joint_names.index(pushed)]]
    return bool(left.max(initial=0.0) > _HIT**2)


def _usual(along: MotionEstimate, g: int) -> F64:
    """(K, U, 3) what is usually left of a log's samples [m/s^2].

    Readings that met what changes faster than they are taken tell too much of it, and are no hit;
    nor is what joints do between two positions that were read.
    """
    log, noise = along.problem.logs[g], along.fitted.noise[g][..., :3]
    also = log.between_positions @ (levers(along.problem.tree, along.state) ** 2).T
    if log.leaps is not None:
        also += log.leaps.readings
    return np.asarray(np.hypot(noise, np.sqrt(also)[..., None]))


def _rattle(along: MotionEstimate, g: int) -> F64:
    """(U,) what SUs feel of joints that cross their slack at once [m/s^2]; 0 where they have none.

    A joint goes from what its slack is in one place to what it is in another. A step that is
    low-passed as readings are has a largest acceleration, which joints that cross back and forth
    come near to for long; it counts over the levers of all joints.
    """
    log = along.problem.logs[g]
    step = np.convolve(log.taps, log.taps) * log.rate
    push = float(np.abs(np.diff(step) * log.rate).max())
    steps = np.maximum(np.sqrt(2) * along.slack, along.widest_slack[g])
    arm = np.sqrt(((levers(along.problem.tree, along.state) * steps) ** 2).sum(axis=1))
    return np.asarray(push * arm)


def _mean_squares(x: F64, measured: Bool, first: Int, count: Int) -> F64:
    """(moments, U) mean squares of what is measured of x (K, U, 3), a moment from each first on."""
    seen = np.where(measured[..., None], x, 0.0) ** 2
    return np.asarray(np.add.reduceat(seen.mean(axis=2), first, axis=0) / count[:, None])
