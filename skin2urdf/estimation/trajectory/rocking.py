"""What it would change if a base that tilts were felt to accelerate.

Its tilts are followed as turns of gravity alone (:mod:`tilting`). One that turns within seconds is
felt to accelerate as well, by how much and about which point nobody knows: turns about its frame,
about a point below or above that, and where an SU on it is, are errors that nothing rules out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.skeleton import N_HINGES
from skin2urdf.estimation.trajectory.unseen import Unseen

_DEPTH = 0.5
"""Distance of the point about which a base tilts from its frame, and of an SU on it [m]: that of a
stand, or of the wheels below."""


def of_accelerations(problem: MotionProblem, fitted: Fitted) -> list[tuple[F64, F64]]:
    """Parts (J,) and (U, n) of the gradient: of turns about the base's frame, and of levers.

    Where SUs on the base are, nothing else tells, so that each axis of their lever is a part.

    Args:
        problem: what was fitted.
        fitted: the fit.

    Returns:
        Nothing where the base stands still, or where its accelerations are followed.
    """
    state = fitted.state
    if problem.unseen is None or not problem.unseen.slow:
        return []
    slow = [p.residual for p in fitted.predicted]
    levers = _DEPTH * np.stack([state.placements.up[0], *np.eye(3)])
    about_frame, *about = (_residuals(problem, fitted, lever) for lever in (np.zeros(3), *levers))
    on_base = problem.tree.su_joint < 0
    every, parts = np.ones_like(on_base), []
    felt = [(slow, about_frame, every), (about_frame, about[0], every)]
    felt += [(about_frame, each, on_base) for each in about[1:] if on_base.any()]
    for less, more, feels in felt:
        logs = zip(fitted.predicted, fitted.weights, less, more, strict=True)
        parts.append(
            [
                np.where((p.measured & feels)[:, :, None], w[..., :3] * (before - after), 0.0)
                for p, w, before, after in logs
            ]
        )
    return problem.gradients(state, fitted.predicted, parts)


def _residuals(problem: MotionProblem, fitted: Fitted, lever: F64) -> list[F64]:
    """Per log (K, U, 3) what is left where the base accelerates, a lever (3,) from its frame."""
    D, state = problem.tree.n_joints, fitted.state
    settled = []
    for g, log in enumerate(problem.logs):
        motion = np.array(problem.moved(state, g).q)
        motion[:, :D] -= log.q
        motion[:, D : D + 3] += np.cross(motion[:, D + 3 :], lever)
        settled.append(motion)
    # All that encoders do not see is known here, and one number that makes nothing stands for it.
    known = Unseen(
        D + np.arange(N_HINGES),
        tuple(np.zeros((len(each), 1)) for each in settled),
        column=np.zeros(N_HINGES, dtype=np.int64),
        number=np.zeros(N_HINGES, dtype=np.int64),
        settled=tuple(settled),
    )
    priors = replace(problem.priors, unseen=np.zeros(1))
    about = MotionProblem(problem.tree, problem.logs, priors, problem.layout.n_knots, known)
    here = replace(state, unseen=np.zeros(1))
    return [about.predict(here, g).residual for g in range(len(problem.logs))]
