"""All samples of the logs, moves between poses included: the last and widest look at them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.clock import Tell
from skin2urdf.calibration.rounds import Solution
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import N_JOINT
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import independent
from skin2urdf.estimation.trajectory.front_end import common_front_end
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import MotionPriors, motion_priors
from skin2urdf.signals.sampling import Sampled
from skin2urdf.signals.trajectory import ENOUGH_MOTION, Trajectory, in_order, trajectory
from skin2urdf.structure.ordering import places_of
from skin2urdf.structure.unknown_positions import usable

_SETTLED = 5e-3
"""By how much clocks may still be off once features were taken [s]: nothing is compared so near to
a gap."""
_MOST = 0.5
"""Share of the moments, around poses and between, from which samples say all that features do."""


def fit_samples(
    solution: Solution,
    tell: Tell,
    *,
    most: float = np.inf,
    without: Collection[str] = (),
    look_further: bool = True,
    unless_one_changed: bool = False,
    unless_on_the_base: bool = False,
) -> MotionEstimate | None:
    """Fit all samples of mended logs, starting from what the features around poses say.

    Args:
        solution: the logs, and the estimate to begin with.
        tell: told the share of the work that is done.
        most: misfit beyond which no physics is tried that a rigid robot has not.
        without: causes that need not be tried, see :func:`rejected`.
        look_further: whether any is tried.
        unless_one_changed: whether none is where the change of a single SU explains what is left.
        unless_on_the_base: whether none is where an SU on a vertical joint may sit on the base.

    Returns:
        None where most moments are around poses that have no samples to compare, as rests that were
        recorded one by one: filters reach beyond them, and the few samples that are left, hardly
        any in motion, know less than the features.
    """
    found, features, logs = solution.found, solution.features, solution.logs
    tree, settings = found.tree, logs.settings
    sus = places_of(tree.su_names, logs.su_names)
    latency = features.latency[places_of(tree.su_names, features.su_names)]
    reach = float(np.abs(latency).max(initial=0.0)) + _SETTLED
    use = usable(features, tree)
    trajectories = []
    for log, sampled in enumerate(logs.sampled):
        dofs = places_of(tree.joint_names, sampled.motion.dof_names)
        whole = in_order(trajectory(sampled, log, reach, sus), dofs, np.arange(tree.n_sus))
        mine = features.log == log
        # What lies beyond a joint whose position the log lacks tells nothing.
        tells = use[mine].any(axis=0) if mine.any() else np.ones(tree.n_sus, dtype=bool)
        trajectories.append(
            replace(
                whole,
                valid=whole.valid & tells,
                turning=None if whole.turning is None else whole.turning & tells,
            )
        )
    if (
        _share_compared(trajectories, logs.sampled) < _MOST
        and sum(log.in_motion for log in trajectories) < ENOUGH_MOTION
    ):
        return None
    priors = sample_priors(settings, found.cost.priors)
    return estimate_along(
        independent(trajectories), tree, found.state, priors, latency, tell,
        most=most, without=without, look_further=look_further,
        unless_one_changed=unless_one_changed, unless_on_the_base=unless_on_the_base,
        alike=settings.estimation.intrinsics,
        mended=_mended(logs.sampled, tree.su_names),
    )  # fmt: skip


def _mended(sampled: Sequence[Sampled], names: Sequence[str]) -> F64:
    """(G, U, 2) latency [s] and drift [1] that were taken off the stamps of SUs (U,)."""
    out = np.zeros((len(sampled), len(names), 2))
    for g, s in enumerate(sampled):
        known = {clock.su: clock for clock in s.clocks}
        for u, name in enumerate(names):
            if name in known:
                out[g, u] = known[name].latency, known[name].drift
    return out


def rejected(along: MotionEstimate | None) -> frozenset[str]:
    """Causes that a fit of nearly the same logs has tried, and that explained less than others."""
    return frozenset(along.tried) - frozenset(along.causes) if along else frozenset()


def sample_priors(settings: CalibrationSettings, sensors: Priors) -> MotionPriors:
    """What is known before all samples are fitted.

    Args:
        settings: choices.
        sensors: what is known of the sensors.
    """
    front = np.zeros(2), np.full(2, settings.slowest_pole**2)
    if settings.bandwidth is not None:
        front = common_front_end(*settings.bandwidth)
    if not settings.estimation.intrinsics:
        sensors = replace(sensors, bias=0.0, scale=0.0, cross=0.0)
        front = np.zeros(2), np.zeros(2)
    return motion_priors(
        sensors,
        gravity=settings.gravity_deviation,
        front=front,
        gyro=settings.estimation.intrinsics,
    )


def _share_compared(trajectories: Sequence[Trajectory], sampled: Sequence[Sampled]) -> float:
    """Share of the moments that have samples to compare; 1 where nothing rests.

    Left out are those around poses that have none at all. A robot that rests once and then moves on
    and on has no samples in its only pose, and a thousand beyond.
    """
    compared, lost = 0, 0
    for log, s in zip(trajectories, sampled, strict=True):
        if not s.at_rest:
            continue
        there = np.asarray(log.valid.any(axis=1))
        compared += int(there.sum())
        for pose in s.neighbourhoods:
            ends = [np.searchsorted(log.kept, window) for window in pose.windows]
            around = np.concatenate([there[begin:end] for begin, end in ends])
            if not around.any():
                lost += around.size
    return compared / (compared + lost) if compared + lost else 1.0


def with_samples(found: Estimate, along: MotionEstimate) -> Estimate:
    """An estimate with the placements and sensors that all samples show.

    Where limbs are relative to each other shows in no more than what a base does that gives way.
    That is told to be open, and all begin at the base's origin.
    """
    T = np.array(along.state.T_parent_joint)
    first = np.unique(along.problem.between_limbs // N_JOINT)
    T[first, :3, 3] = found.state.T_parent_joint[first, :3, 3]
    return replace(found, state=replace(along.state, T_parent_joint=T))
