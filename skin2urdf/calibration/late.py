"""Clocks of publishers and of SUs, as all samples show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.signals.clocks import is_off, widening_by_few_moves
from skin2urdf.signals.records import Features, JointClock, SuClock
from skin2urdf.signals.sampling import Sampled


def late_publishers(
    along: MotionEstimate | None, sampled: Sequence[Sampled]
) -> tuple[tuple[JointClock, ...], ...]:
    """Clocks of publishers of joint states that all samples show to be off, by log.

    Args:
        along: the fit of all samples, if there is one.
        sampled: the logs.
    """
    out: list[list[JointClock]] = [[] for _ in sampled]
    late = None if along is None else along.late
    if along is None or late is None:
        return tuple(tuple(each) for each in out)
    names = along.problem.tree.joint_names
    for c, (g, joints) in enumerate(zip(late.log.tolist(), late.joints, strict=True)):
        time = along.problem.logs[g].time
        out[g].append(
            JointClock(
                joints=tuple(names[j] for j in joints),
                latency=float(late.latency[c]),
                latency_sd=float(late.latency_sd[c]),
                drift=float(late.drift[c]),
                drift_sd=float(late.drift_sd[c]),
                middle=sampled[g].motion.grid.start + 0.5 * float(time[0] + time[-1]),
            )
        )
    return tuple(tuple(each) for each in out)


def clocks_in_all(
    clocks: Sequence[Sequence[SuClock]], along: MotionEstimate | None
) -> tuple[tuple[SuClock, ...], ...]:
    """Clocks that were set right before all else, with what all samples still found of them.

    Args:
        clocks: by log, the SUs whose clock ran differently from the joints'.
        along: the fit of all samples, if there is one.

    Returns:
        The same clocks: latency and drift as the fit leaves them, and its deviations.
    """
    if along is None:
        return tuple(tuple(of_log) for of_log in clocks)
    names, layout = along.problem.tree.su_names, along.problem.layout
    found, variances = along.fitted.state.clock, np.einsum("uii->ui", along.su_covariances)

    def fitted(clock: SuClock, log: int) -> SuClock:
        if clock.su not in names:
            return clock
        u = names.index(clock.su)
        late, fast = map(float, found[log, u])
        late_sd, fast_sd = map(float, np.sqrt(variances[u, layout.clock(log)].clip(0.0)))
        if late_sd > clock.latency_sd:
            # Its readings do not show it: it runs on the clock that all others share.
            return clock
        return replace(
            clock,
            latency=clock.latency + late,
            latency_sd=late_sd,
            drift=clock.drift + fast,
            drift_sd=fast_sd,
        )

    return tuple(tuple(fitted(clock, g) for clock in of_log) for g, of_log in enumerate(clocks))


def late_sus(
    along: MotionEstimate | None, sampled: Sequence[Sampled], features: Features
) -> tuple[tuple[SuClock, ...], ...]:
    """Clocks of SUs that only all samples show to be off, by log.

    Args:
        along: the fit of all samples, if there is one.
        sampled: the logs, which name the clocks that were set right before.
        features: those around poses; a latency that they show is told as such.
    """
    out: list[list[SuClock]] = [[] for _ in sampled]
    if along is None:
        return tuple(tuple(each) for each in out)
    layout, variances = along.problem.layout, np.einsum("uii->ui", along.su_covariances)
    shown = dict(zip(features.su_names, np.isfinite(features.latency_sd), strict=True))
    for g, s in enumerate(sampled):
        time = along.problem.logs[g].time
        middle = s.motion.grid.start + 0.5 * float(time[0] + time[-1])
        known = {clock.su for clock in s.clocks}
        widening = widening_by_few_moves(s.motion)
        for u, name in enumerate(along.problem.tree.su_names):
            if name in known or shown.get(name, False):
                continue
            late, fast = map(float, along.fitted.state.clock[g, u])
            late_sd, fast_sd = map(float, np.sqrt(variances[u, layout.clock(g)].clip(0.0)))
            clock = SuClock(name, late, widening * late_sd, fast, widening * fast_sd, middle)
            if is_off(clock, s.motion):
                out[g].append(clock)
    return tuple(tuple(each) for each in out)
