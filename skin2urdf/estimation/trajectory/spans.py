"""What parts of the time say: their contributions to the normal equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted, Spans
from skin2urdf.estimation.trajectory.state import MotionState


def spans_of(
    problem: MotionProblem,
    state: MotionState,
    predicted: Sequence[Predicted],
    weights: Sequence[F64],
    members: Sequence[Int],
) -> Spans:
    """Contributions of parts of the time to the normal equations without priors.

    Args:
        problem: the logs.
        state: where.
        predicted: residuals of each log there.
        weights: per log (K, U, 3) information of each sample [s^4/m^2].
        members: per log (K,) the part that each sample is in.
    """
    layout, U, G = problem.layout, problem.tree.n_sus, len(problem.logs)
    J, n, S = layout.n_joint, layout.n_su, 1 + max(int(each.max()) for each in members)
    of_all = [sorted({c for g in range(G) for c in problem.all_columns(u, g)}) for u in range(U)]
    width = max(map(len, of_all))
    columns = np.full((U, width), -1)
    joint, su = np.zeros((S, J, J)), np.zeros((S, U, n, n))
    mixed = np.zeros((S, U, n, width))
    for u in range(U):
        columns[u, : len(of_all[u])] = of_all[u]
    beyond = problem.beyond()
    for rows in problem.rows(state, predicted, weights):
        u = rows.su
        own, A = rows.whole(beyond[rows.log] if beyond else None)
        nj, place = len(own), np.searchsorted(columns[u][columns[u] >= 0], own)
        for s, which in parts_of(members[rows.log]):
            part = A[:, :, which].reshape(len(A), -1)
            H = part @ part.T
            joint[s][np.ix_(own, own)] += H[:nj, :nj]
            su[s, u] += H[nj:, nj:]
            mixed[s, u][:, place] += H[nj:, :nj]
    return Spans(joint, su, mixed, columns)


def parts_of(members: Int) -> list[tuple[int, Int]]:
    """The parts of the time that there are, and which samples each has.

    Args:
        members: (K,) the part that each sample is in.
    """
    order = np.argsort(members, kind="stable")
    parts, first = np.unique(members[order], return_index=True)
    return list(zip(parts.tolist(), np.split(order, first[1:]), strict=True))
