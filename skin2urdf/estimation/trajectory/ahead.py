"""The step that a fit of all samples did not take.

A fit ends where its next step would be short, but also where it may take no more steps, or none
leads on. What the next step would change is in its normal equations all the same: the gradient that
is left, through the information. Where it was not taken, that is an error of the estimate like any
other, and is stated as one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.estimation.problem.state import N_JOINT, N_PLACEMENT, N_SU
from skin2urdf.estimation.trajectory.arrow import eliminated, newton_step
from skin2urdf.estimation.trajectory.fit import Fitted


@dataclass(frozen=True, eq=False)
class Ahead(Record):
    """The step that a fit did not take.

    Attributes:
        joint: (J,) and
        su: (U, n) the gradient that is left.
        steps: (J,) and (U, n) the step.
        share: its length, over that of the error which noise alone makes of an estimate.
    """

    joint: F64
    su: F64
    steps: tuple[F64, F64]
    share: float

    @property
    def is_most(self) -> bool:
        """Whether more of the estimate's error is due to it than to noise: it has not arrived."""
        return not self.share <= 1.0


def step_ahead(
    fitted: Fitted, taken_off: tuple[F64, F64] | None = None, *, within: float = np.inf
) -> Ahead:
    """The step that a fit did not take.

    Args:
        fitted: the fit.
        taken_off: parts (J,) and (U, n) of the gradient by which it is off its optimum on purpose.
        within: see :func:`step_along`.
    """
    equations = fitted.minimised(fitted.equations)
    joint, su = equations.joint_gradient, equations.su_gradient
    if taken_off is not None:
        joint, su = joint + taken_off[0], su + taken_off[1]
    return step_along(fitted, joint, su, within=within)


def step_along(fitted: Fitted, joint: F64, su: F64, *, within: float = np.inf) -> Ahead:
    """The step that a gradient would have a fit take.

    Args:
        fitted: the fit.
        joint: (J,) and
        su: (U, n) the gradient.
        within: deviation [m and rad] within which joints and SUs are taken to be placed already.
            Along what nothing shows, a step is as long as rounding makes it, and too long to be
            a small turn.
    """
    problem = fitted.problem
    free_joint, free_su = problem.free_joint, problem.free_su
    joint, su = np.where(free_joint, joint, 0.0), np.where(free_su, su, 0.0)
    own, each = np.array(fitted.equations.joint), np.array(fitted.equations.su)
    of_joints = range(N_JOINT * problem.tree.n_joints)
    own[of_joints, of_joints] += within**-2
    each[:, range(N_PLACEMENT), range(N_PLACEMENT)] += within**-2
    left = replace(fitted.equations, joint=own, su=each, joint_gradient=joint, su_gradient=su)
    steps = newton_step(eliminated(left, free_joint, free_su), free_joint)
    # By noise alone chi-squared is lower at an estimate than at the truth: by 1 per coordinate.
    fall = float(joint @ steps[0] + (su * steps[1]).sum())
    count = free_joint[: problem.layout.gravity].sum() + free_su[:, :N_SU].sum()
    return Ahead(joint, su, steps, float(np.sqrt(max(fall, 0.0) / max(count, 1))))
