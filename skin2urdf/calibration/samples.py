"""All samples of the logs, moves between poses included: the last and widest look at them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.calibration.clock import Tell
from skin2urdf.calibration.rounds import Solution
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.trajectory.estimate import (
    MotionEstimate,
    estimate_along,
    motion_priors,
)
from skin2urdf.estimation.trajectory.front_end import common_front_end
from skin2urdf.signals.sampling import Sampled
from skin2urdf.signals.trajectory import Trajectory, in_order, trajectory

_SETTLED = 5e-3
"""By how much clocks may still be off once features were taken [s]: nothing is compared so near to
a gap."""


_MOST = 0.5
"""Share of the poses from which the samples say all that features do."""


def fit_samples(solution: Solution, tell: Tell) -> MotionEstimate | None:
    """Fit all samples of mended logs, starting from what the features around poses say.

    Args:
        solution: the logs, and the estimate to begin with.
        tell: told the share of the work that is done.

    Returns:
        None where most poses have no samples to compare, as rests that were recorded one by one:
        filters reach beyond them, and the few that are left know less than the features.
    """
    found, features, logs = solution.found, solution.features, solution.logs
    tree, settings = found.tree, logs.settings
    sus = np.array([logs.su_names.index(name) for name in tree.su_names], dtype=np.int64)
    latency = features.latency[[features.su_names.index(name) for name in tree.su_names]]
    reach = float(np.abs(latency).max(initial=0.0)) + _SETTLED
    trajectories = []
    for log, sampled in enumerate(logs.sampled):
        names = sampled.motion.dof_names
        dofs = np.array([names.index(name) for name in tree.joint_names], dtype=np.int64)
        trajectories.append(in_order(trajectory(sampled, log, reach), dofs, sus))
    if _share_of_poses(trajectories, logs.sampled) < _MOST:
        return None
    front = np.zeros(2), np.full(2, settings.slowest_pole**2)
    if settings.bandwidth is not None:
        front = common_front_end(*settings.bandwidth)
    sensors = found.cost.priors
    if not settings.estimation.intrinsics:
        sensors = replace(sensors, bias=0.0, scale=0.0, cross=0.0)
        front = np.zeros(2), np.zeros(2)
    priors = motion_priors(sensors, gravity=settings.gravity_deviation, front=front)
    return estimate_along(trajectories, tree, found.state, priors, latency, tell)


def _share_of_poses(trajectories: Sequence[Trajectory], sampled: Sequence[Sampled]) -> float:
    """Share of the poses in whose windows there are samples to compare."""
    seen = []
    for log, s in zip(trajectories, sampled, strict=True):
        there = log.kept[log.valid.any(axis=1)]
        for pose in s.neighbourhoods:
            ends = np.searchsorted(there, np.array(pose.windows))
            seen.append(bool((ends[:, 1] > ends[:, 0]).any()))
    return float(np.mean(seen)) if seen else 0.0


def with_samples(found: Estimate, along: MotionEstimate) -> Estimate:
    """An estimate with the placements and sensors that all samples show."""
    return replace(found, state=along.state)
