"""All samples of the logs, moves between poses included: the last and widest look at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.calibration.clock import Tell
from skin2urdf.calibration.rounds import Solution
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.trajectory.estimate import MotionEstimate, estimate_along, motion_priors
from skin2urdf.signals.trajectory import in_order, trajectory

_SETTLED = 5e-3
"""By how much clocks may still be off once features were taken [s]: nothing is compared so near to
a gap."""


def fit_samples(solution: Solution, tell: Tell) -> MotionEstimate:
    """Fit all samples of mended logs, starting from what the features around poses say.

    Args:
        solution: the logs, and the estimate to begin with.
        tell: told the share of the work that is done.
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
    priors = motion_priors(
        found.cost.priors, gravity=settings.gravity_deviation, pole=settings.slowest_pole
    )
    return estimate_along(trajectories, tree, found.state, priors, latency, tell)


def with_samples(found: Estimate, along: MotionEstimate) -> Estimate:
    """An estimate with the placements and sensors that all samples show."""
    return replace(found, state=along.state)
