"""SUs that sit elsewhere on their segment from some time on.

For each SU, given the joints, one placement for all poses is held against two, one before and one
after a time (Chow 1960): with chi-squared ``c1`` and ``c2`` and k coordinates of a placement,

    F = ((c1 - c2) / k) / (c2 / dof)

has Fisher's distribution where the SU is fixed. That the joints are held at the estimate, to which
the SU itself contributed, only makes F smaller. All times between two poses, and all poses as the
one in which it happened, are tried. Dividing by ``c2 / dof`` allows for a noise that is misjudged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import N_PLACEMENT, N_SU, State
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.hypotheses.encoder_score import unweighted

FALSE_ALARM = 1e-6
"""Probability that chance makes any SU of a calibration count as loose."""
_FEWEST = 2
"""Poses on either side of a slip."""
_MARGIN = 3.0
"""Standard deviations of a pose's chi-squared from which a slip is put inside of it."""


@dataclass(frozen=True)
class Slip:
    """An SU whose placement changed.

    Attributes:
        su: index of the SU in the tree.
        before: last pose with the earlier placement, and
        after: first pose with the later one, in the order of time; poses between them have both.
        gain: F, by which one placement is worse.
        drop: of chi-squared from where it is to two placements, the joints as they are. An SU that
            was weighed down is further from one placement than it need be.
        log_probability: natural logarithm of the probability of such an F by chance.
    """

    su: int
    before: int
    after: int
    gain: float
    drop: float
    log_probability: float


def slips(estimate: Estimate, order: Int) -> tuple[Slip, ...]:
    """SUs that are loose beyond doubt, the most certain one first.

    Args:
        estimate: an estimate, however bad.
        order: (P,) the poses in the order of time.
    """
    plain = unweighted(estimate).cost
    sums = _sums(plain, estimate.state)
    found = []
    for u in range(estimate.tree.n_sus):
        free = estimate.free.sus[u]
        here = _best(sums, u, free, estimate.count[:, u], order)
        tests = estimate.tree.n_sus * 2 * len(order)
        if here is not None and here.log_probability < np.log(FALSE_ALARM / tests):
            found.append(here)
    return tuple(sorted(found, key=lambda slip: -slip.gain))


@dataclass(frozen=True, eq=False)
class _Sums:
    """Normal equations of the SUs, by pose and of their priors.

    Attributes:
        A: (P, U, 15, 15) information.
        b: (P, U, 15) gradient.
        c: (P, U) chi-squared.
        A0: (U, 15, 15), and
        b0: (U, 15), and
        c0: (U,), of the priors.
    """

    A: F64
    b: F64
    c: F64
    A0: F64
    b0: F64
    c0: F64


def _sums(cost: Cost, state: State) -> _Sums:
    here = cost.at(state)
    P, U, m, _ = here.residual.shape
    _, J = here.jacobian()
    by_pose = J[:, : P * m * 3].reshape(U, P, m * 3, N_SU).swapaxes(0, 1)
    r = here.residual.reshape(P, U, m * 3)
    prior = J[:, P * m * 3 :]
    r0 = np.concatenate([here.prior, here.offsets[1]], axis=1)
    return _Sums(
        np.swapaxes(by_pose, -1, -2) @ by_pose,
        np.einsum("puij,pui->puj", by_pose, r),
        np.einsum("pui,pui->pu", r, r),
        np.swapaxes(prior, -1, -2) @ prior,
        np.einsum("uij,ui->uj", prior, r0),
        np.einsum("ui,ui->u", r0, r0),
    )


def _best(sums: _Sums, u: int, free: Bool, count: Int, order: Int) -> Slip | None:
    """The likeliest slip of an SU, where there can be one at all."""
    order = order[count[order] > 0]
    k, n = int(free[:N_PLACEMENT].sum()), len(order)
    cuts = [(i, skip) for i in range(_FEWEST, n - _FEWEST + 1) for skip in (0, 1)]
    if not cuts:
        return None
    first, skip = np.array(cuts, dtype=np.int64).reshape(-1, 2).T
    second = first + skip
    counted = _before(count[order])
    used = counted[first] + counted[-1] - counted[second]
    some = (n - second >= _FEWEST) & (used - int(free.sum()) - k >= k)
    if not some.any():
        return None
    first, skip, second, used = first[some], skip[some], second[some], used[some]
    dof = used - int(free.sum()) - k
    of_poses = [x[order, u] for x in (sums.A, sums.b, sums.c)]
    left = tuple(_before(x)[first] for x in of_poses)
    right = tuple(_before(x[::-1])[n - second] for x in of_poses)
    both = tuple(x + y for x, y in zip(left, right, strict=True))
    one = _chi2(sums, u, free, [both])
    two = np.maximum(_chi2(sums, u, free, [left, right]), 1e-12)
    lost = counted[-1] - dof
    scale = float((two / dof).min())
    best = int(np.argmin(two + skip * scale * (lost + _MARGIN * np.sqrt(2 * lost))))
    # Of the pose in which it slipped nothing is left to explain.
    now = float(sums.c0[u] + sums.c[order, u].sum())
    least, freedom = float(two[best]), int(dof[best])
    F = max(float(one[best]) - least, 0.0) / k / (least / freedom)
    with np.errstate(divide="ignore"):
        log_p = float(np.log(fdtrc(k, freedom, F)))
    last, after = int(order[first[best] - 1]), int(order[second[best]])
    return Slip(u, last, after, F, max(now - least, 0.0), log_p)


def _before(x: NDArray[Any]) -> NDArray[Any]:
    """(n + 1, ...) sums of the first of n values, from none of them to all."""
    return np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)])


def _chi2(sums: _Sums, u: int, free: Bool, sides: Sequence[tuple[F64, ...]]) -> F64:
    """(C,) chi-squared of an SU with a placement for each set of poses, and one sensor.

    Args:
        sums: the priors of the SUs.
        u: the SU.
        free: (15,) its coordinates that are estimated.
        sides: of each set information (C, 15, 15), gradient (C, 15) and chi-squared (C,), for C
            ways to part the poses.
    """
    n, C = N_PLACEMENT * (len(sides) - 1), len(sides[0][2])
    A, b = np.zeros((C, N_SU + n, N_SU + n)), np.zeros((C, N_SU + n))
    c = np.full(C, float(sums.c0[u]))
    sensor = np.arange(N_PLACEMENT, N_SU) + n
    open_ = np.concatenate([*[free[:N_PLACEMENT]] * len(sides), free[N_PLACEMENT:]])
    for i, (information, gradient, chi2) in enumerate(sides):
        own = np.concatenate([np.arange(N_PLACEMENT) + N_PLACEMENT * i, sensor])
        A[:, own[:, None], own] += information
        b[:, own] += gradient
        c += chi2
    own = np.concatenate([np.arange(N_PLACEMENT), sensor])
    A[:, own[:, None], own] += sums.A0[u]
    b[:, own] += sums.b0[u]
    A, b = A[:, open_][:, :, open_], b[:, open_]
    scale = np.sqrt(np.maximum(np.einsum("cii->ci", A), 1e-300))
    unit = A / scale[:, :, None] / scale[:, None, :] + 1e-9 * np.eye(A.shape[1])
    x = np.linalg.solve(unit, (b / scale)[..., None])[..., 0]
    return np.asarray(c - (x * (b / scale)).sum(axis=1))
