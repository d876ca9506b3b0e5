"""Whether a base moves by the loads of its robot alone, or as SUs on it feel.

Loads go with the motion of the links, of which nothing is noise, and tell turns of a base from
shifts, which a single SU on it does not; but a base may yield in ways that they are not fitted by.
An SU on it feels all of them, and noise. Where both explain all samples, that counts by which more
is known.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.calibration.rounds import Solution
from skin2urdf.calibration.samples import fit_samples, with_samples
from skin2urdf.estimation.trajectory.attempt import BASE
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.moving_base import FELT
from skin2urdf.estimation.uncertainty.observability import aligned_deviations, observability


def by_loads_or_felt(solution: Solution, along: MotionEstimate, clock: Clock) -> MotionEstimate:
    """The fit of all samples with a base that yields to loads alone, where that tells more.

    Args:
        solution: the robot.
        along: the fit, without what SUs on the base feel.
        clock: runs the stages.
    """
    if along.moving_base is None or not along.moving_base.goes_with_loads:
        return along
    other = clock.run("all samples", partial(fit_samples, solution, without={FELT}))
    if other is None or BASE not in other.causes or other.misfit > GOOD_FIT:
        return along
    return min(along, other, key=partial(_expected_error, solution))


def _expected_error(solution: Solution, along: MotionEstimate) -> float:
    """Error of the SUs to expect where the robot has been seen, rms [m]."""
    found = with_samples(solution.found, along)
    q = found.cost.blocks.q
    position, _ = aligned_deviations(found, observability(found, along.information), q)
    known = position[np.isfinite(position)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.inf
