"""SUs of which a fit leaves readings that follow the robot's motion: they hang in a wrong place.

The noise of a fit is that which its residuals show. An SU that hangs on a wrong joint, or whose
clock is far off, leaves what changes as fast as the robot moves, which passes for a noisy sensor.
Noise, vibration and hits do not follow positions of joints, though, and what gears and links yield
by does so by far less than gravity turns: what is left is held against functions of the positions
of all joints, those that the tree lacks included, as gravity and levers beyond them are made of,
and against the prediction as it would be with any one joint more, or less, before the SU.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.trajectory.fit import Fitted

SHARE = 0.1
"""Share of what changes in the readings from which what is left of them and follows the motion is
no matter of physics: sensors' scale errors are 0.03, what yields by 20 mrad leaves 0.02, and an SU
on a wrong joint 0.3 and more."""
_LEAN = 0.1
"""Turn [rad] against gravity below which an SU counts as hardly moved: what is left of it is held
against what that turn would change."""
_ENOUGH = 10
"""Samples to each function, at least."""
STRETCH = 1.0
"""Length of stretches of time [s], of which every other one is predicted from the rest: longer than
noise lasts that is low-passed, and shorter than a robot stays in one place."""


def follow_motion(fitted: Fitted, prismatic: Bool) -> Bool:
    """(U,) True for SUs of which the fit leaves what follows the motion of the joints.

    Args:
        fitted: the fit.
        prismatic: (D,) True for joints that slide.
    """
    problem = fitted.problem
    n_sus = problem.tree.n_sus
    left, changed, count = np.zeros(n_sus), np.zeros(n_sus), np.zeros(n_sus)
    for log, predicted in zip(problem.logs, fitted.predicted, strict=True):
        readings = log.readings[log.kept]
        q, slides = log.q, prismatic
        if len(log.left_out):
            # What an SU feels of a joint that the tree lacks is left of it.
            q = np.hstack([q, log.left_out])
            slides = np.append(prismatic, np.zeros(log.left_out.shape[1], dtype=bool))
        for u in range(n_sus):
            use = predicted.measured[:, u]
            if not use.any():
                continue
            residual, y = predicted.residual[use, u, :3], readings[use, u]
            ahead = y - residual
            y = y - y.mean(axis=0)
            count[u] += len(y)
            changed[u] += (y**2).sum()
            if (residual**2).sum() > SHARE**2 * (y**2).sum():
                left[u] += _explained(q[log.kept[use]], log.time[use], residual, ahead, slides)
    about = changed + count * (_LEAN * fitted.state.gravity) ** 2
    return np.asarray(left > SHARE**2 * about)


def _explained(q: F64, time: F64, residual: F64, ahead: F64, prismatic: Bool) -> float:
    """Sum of squares of residuals (n, 3) that functions of positions and predictions foretell."""
    functions = [
        (q[:, [j]] - q[:, j].mean()) if slides else np.stack([np.sin(q[:, j]), np.cos(q[:, j])], 1)
        for j, slides in enumerate(prismatic)
    ]
    turned = [_products(each, ahead) for each in functions]
    pairs = [_products(a, b) for a, b in combinations(functions, 2)]
    columns = np.hstack([np.ones((len(q), 1)), *functions, *turned, *pairs])
    columns = columns[:, : max(1, len(q) // (2 * _ENOUGH))]
    even = (time // STRETCH) % 2 == 0
    explained = 0.0
    for here in (even, ~even):
        x = np.linalg.lstsq(columns[~here], residual[~here], rcond=None)[0]
        rest = residual[here] - columns[here] @ x
        explained += float((residual[here] ** 2).sum() - (rest**2).sum())
    return max(0.0, explained)


def _products(a: F64, b: F64) -> F64:
    """(n, k m) products of all columns of (n, k) and (n, m)."""
    return np.asarray((a[:, :, None] * b[:, None]).reshape(len(a), -1))
