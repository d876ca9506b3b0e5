"""How a base leans by what loads it all the time, which nothing shows.

The weight of what stands still on a base, and that of the whole robot on a lever that does not
change, turn it by as much in all poses. Readings then are those of a robot whose axes are turned
against gravity, but the URDF's are those on a base without load. So two numbers join the others
that make the base's motion: of them nothing is known but that they may be as large as what the base
is seen to do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import N_PLACEMENT
from skin2urdf.estimation.trajectory.azimuth import turned
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.skeleton import turn
from skin2urdf.estimation.trajectory.slack import with_unseen
from skin2urdf.estimation.trajectory.unseen import Unseen


def with_leaning_base(problem: MotionProblem, fitted: Fitted) -> tuple[MotionProblem, Fitted]:
    """A problem and its fit with constant turns of the base about its horizontal axes.

    Args:
        problem: what was fitted; where its base stands still, nothing is added.
        fitted: the fit.
    """
    tree = problem.tree
    if not problem.base_swings:
        return problem, fitted
    turns = np.concatenate(problem.base_motions(fitted.state))[:, 3:]
    about = np.array([turn(tree, 0), turn(tree, 1)])
    constant = Unseen(about, tuple(np.ones((len(log.q), 2)) for log in problem.logs))
    wider = with_unseen(problem, constant, float(turns.std(axis=0).max()))
    state = replace(fitted.state, unseen=np.append(fitted.state.unseen, np.zeros(2)))
    return wider, replace(fitted, problem=wider, state=state)


def with_pulls_on_leaning(
    problem: MotionProblem, fitted: Fitted, pulls: list[tuple[F64, F64]]
) -> list[tuple[F64, F64]]:
    """Pulls on the coordinates of a fit, with what they do to constant turns of its base.

    A base that leans turns all that stands on it: what pulls at that pulls at the lean as much.

    Args:
        problem: what was fitted; where its base stands still, pulls are as they are.
        fitted: the fit.
        pulls: parts (J,) and (U, n) of gradients.

    Returns:
        The same on the coordinates of :func:`with_leaning_base`.
    """
    if not problem.base_swings:
        return pulls
    layout, places = problem.layout, fitted.state.placements
    ways = [turned(problem.tree, places, axis) for axis in np.eye(3)[:2]]
    out = []
    for joint, su in pulls:
        of_joints, of_sus = joint[layout.joints], su[:, :N_PLACEMENT]
        lean = [float(a.ravel() @ of_joints + (b * of_sus).sum()) for a, b in ways]
        out.append((np.insert(joint, layout.unseen.stop, lean), su))
    return out
