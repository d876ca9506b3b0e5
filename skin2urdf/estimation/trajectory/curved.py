"""Sensors whose axes are curved: what an axis reads bends away from a straight line.

With c its curvature, an axis reads ``l + c l^2`` and its bias, where l is linear in what it feels.
IEEE Std 1293 has c as the second-order nonlinearity coefficient of an axis; data sheets call the
largest departure over the full scale nonlinearity. What gears that yield do to gravity in an SU
looks alike, and so do encoders that are off in some places; so curvature is one of the causes that
are held against each other by the likelihood of the readings. How large that of one robot's sensors
is, the SUs tell together, as a group of numbers of one size (:mod:`slack`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.trajectory.arrow import NOTHING, eliminated
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Equations
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.geometry.units import GRAVITY

_MOST = 0.01 / (4 * GRAVITY)
"""Curvature of one standard deviation at most [s^2/m]: 1 % of a full scale of 4 g, twice what data
sheets of common sensors allow. More would take up what gears do that yield by milliradians."""
_SIZES = np.geomspace(_MOST / 1000, _MOST, 31)
"""Curvatures that are compared [s^2/m]: from what an hour of rests hardly shows, by a quarter."""
_WIDE = 10 * _MOST
"""One that stands for any, where only information is wanted [s^2/m]."""


@dataclass(frozen=True)
class Curvature:
    """How much the axes of all SUs are curved.

    Attributes:
        size: standard deviation of their curvatures [s^2/m].
        gain: logarithm of the likelihood of the readings, over that of straight axes.
    """

    size: float
    gain: float


def may_be_curved(problem: MotionProblem) -> bool:
    """Whether curvature is asked for: not of sensors that have any already, or are said exact."""
    return not problem.layout.curves and problem.priors.sensors.scale > 0


def with_curves(
    problem: MotionProblem, fitted: Fitted, size: float = _WIDE
) -> tuple[MotionProblem, Fitted]:
    """The same problem and state with axes that may be curved, and are not yet.

    Args:
        problem: what was fitted.
        fitted: the fit.
        size: standard deviation of their curvatures [s^2/m].
    """
    curved = problem.again(priors=replace(problem.priors, curvature=size))
    state = replace(fitted.state, curvature=np.zeros((problem.tree.n_sus, 3)))
    return curved, replace(fitted, problem=curved, state=state)


def fit_curved(problem: MotionProblem, fitted: Fitted, size: float) -> tuple[MotionProblem, Fitted]:
    """The fit with curved axes.

    Args:
        problem: what was fitted.
        fitted: the fit, near which it begins.
        size: as above.
    """
    curved, begin = with_curves(problem, fitted, size)
    return curved, fit(curved, begin.state, near=True, predicted=begin.predicted)


def without_curves(problem: MotionProblem, equations: Equations) -> Equations:
    """Equations of a problem with curved axes without their coordinates.

    Args:
        problem: that problem.
        equations: its own, where no axis is curved.
    """
    at = problem.layout.curvature
    kept = np.delete(np.arange(problem.layout.n_su), at)
    return replace(
        equations,
        su=equations.su[:, kept[:, None], kept],
        mixed=equations.mixed[:, kept],
        su_gradient=equations.su_gradient[:, kept],
    )


def straightened(problem: MotionProblem, state: MotionState) -> tuple[MotionProblem, MotionState]:
    """The problem with straight axes, and a state with all else as it is."""
    straight = problem.again(priors=replace(problem.priors, curvature=0.0))
    return straight, replace(state, curvature=np.zeros((0, 0)))


def likeliest_curvature(
    problem: MotionProblem, equations: Equations, held: Bool, x: F64 | None = None
) -> Curvature:
    """The size of curvatures that makes the readings most likely.

    All else follows them to first order, as in :mod:`slack`. Every SU is eliminated but for its
    three curvatures, which are integrated out for each size; what is left is the joint part, and
    its determinant tells how much less of it is known.

    Args:
        problem: with curved axes.
        equations: what its fit minimised.
        held: (J,) coordinates of the joint part that do not count.
        x: (U, 3) curvatures where they are [s^2/m]; 0 by default.
    """
    at = problem.layout.curvature
    free_joint, free_su = problem.free_joint & ~held, problem.free_su.copy()
    curves = free_su[:, at].all(axis=1)
    free_su[:, at] = False
    system = eliminated(equations, free_joint, free_su)
    others = -(system.su_inverse @ equations.su[:, :, at])
    own = equations.su[:, at, at] + np.swapaxes(others, 1, 2) @ equations.su[:, :, at]
    own = own - np.eye(3) * problem.priors.curvature**-2.0
    mixed = equations.mixed[:, at] + np.swapaxes(others, 1, 2) @ equations.mixed
    pull = equations.su_gradient[:, at] + np.einsum("unc,un->uc", others, equations.su_gradient)
    own, mixed, pull = own[curves], mixed[curves][:, :, free_joint], pull[curves]
    H, g = system.schur[np.ix_(free_joint, free_joint)], system.gradient[free_joint]
    if x is not None:
        # Seen from straight axes, without what was said of them before.
        pull = pull + problem.priors.curvature**-2.0 * x[curves]
        pull = pull + np.einsum("ucd,ud->uc", own, x[curves])
        g = g + np.einsum("ucj,uc->j", mixed, x[curves])
    unit = 1 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    H = H * unit[:, None] * unit + NOTHING * np.eye(len(H))
    mixed, g = mixed * unit, g * unit
    straight = _explained(0.0, own, mixed, pull, H, g)
    gains = [_explained(size, own, mixed, pull, H, g) - straight for size in _SIZES]
    best = int(np.argmax(gains))
    return Curvature(float(_SIZES[best]), gains[best])


def _explained(size: float, own: F64, mixed: F64, pull: F64, H: F64, g: F64) -> float:
    """Logarithm of the likelihood that curvatures of a size leave, but for a constant.

    Args:
        size: their standard deviation [s^2/m].
        own: (U, 3, 3) information on them, and
        mixed: (U, 3, J) that they share with the joint part.
        pull: (U, 3) their gradient.
        H: (J, J) information on the joint part of straight axes, and
        g: (J,) its gradient.
    """
    known = own * size**2 + np.eye(3)
    follow = np.linalg.solve(known, np.concatenate([mixed, pull[..., None]], axis=2)) * size**2
    less = np.tensordot(mixed, follow, ((0, 1), (0, 1)))
    H_left, g_left = H - less[:, :-1], g - less[:, -1]
    chi2 = float(np.einsum("uc,uc->", pull, follow[..., -1]))
    chi2 += float(g_left @ np.linalg.solve(H_left, g_left))
    narrower = float(np.linalg.slogdet(known)[1].sum() + np.linalg.slogdet(H_left)[1])
    return 0.5 * (chi2 - narrower)
