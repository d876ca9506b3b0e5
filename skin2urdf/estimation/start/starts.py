"""Which closed-form start to take: positions for its orientations, and where it leads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import N_PLACEMENT, N_SU, Free, State, moved
from skin2urdf.estimation.solve.arrow import factor
from skin2urdf.estimation.solve.gauss_newton import gauss_newton
from skin2urdf.estimation.solve.progressive import progressive, smallest_fall
from skin2urdf.estimation.start.inward import inward_starts
from skin2urdf.estimation.start.orientation import Orientations
from skin2urdf.estimation.start.outward import outward_starts
from skin2urdf.geometry.se3 import placement
from skin2urdf.geometry.so3 import axis_rotation, skew
from skin2urdf.signals.records import Features
from skin2urdf.structure.ordering import Ordering
from skin2urdf.structure.records import KinematicTree

_EXPLAINED = 10.0
"""Chi-squared per measurement up to which a followed start counts as an explanation."""
_HOPELESS = 100.0
"""Ratio of chi-squared after two steps from which a start is not followed beside a good one."""
_CAUTION = 1e-3
"""Relative damping of the first steps.

Axes of a start are off by milliradians. Offsets that show only by such angles, along axes that
are nearly parallel, would take up that error with hundreds of metres.
"""
_ROUGH_LEVER = 0.01
"""Error [m] that a lever arm may have while joints are roughly placed."""
_LOOSE = 0.3
"""Standard deviation [rad] from which gravity is taken not to show an SU's turn about it."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Where a start leads.

    Attributes:
        state: the state reached.
        chi2: its chi-squared.
    """

    state: State
    chi2: float


def followed_starts(
    cost: Cost, free: Free, earlier: State | None, search: bool = True
) -> tuple[State, tuple[float, ...]]:
    """The most promising start, followed to the neighbourhood of its optimum.

    An earlier estimate that explains the data needs no other start. Otherwise peeling inwards
    comes first where slopes were measured. The search outwards follows where they were not, or
    where no peeled start explains the data (slopes and accelerations are hard to tell apart in
    a short pattern of one frequency).

    Args:
        cost: the cost.
        free: which coordinates may move.
        earlier: an earlier estimate of the same tree, if there is one.
        search: look for starts even so, where the earlier estimate does not explain the data.

    Returns:
        The best state, and chi-squared of every start that was followed.

    Raises:
        InsufficientDataError: no start can be computed from these features.
    """
    tree, blocks, priors = cost.tree, cost.blocks, cost.priors
    followed: list[Followed] = []
    if earlier is not None:
        followed.append(Followed(*gauss_newton(cost, earlier, free, iterations=8)))
        if _explains(cost, followed) or not search:
            return followed[0].state, (followed[0].chi2,)
    if _slopes_measured(cost):
        followed += _follow(cost, free, inward_starts(tree, blocks, priors))
    if not _explains(cost, followed):
        followed += _follow(cost, free, outward_starts(tree, blocks, priors))
    if not followed:
        raise InsufficientDataError(
            "no start for the estimation: the gravity slopes of the DoFs were not measured, and a "
            "segment carries no SU",
            "record patterns that move every DoF by 0.05 rad or more around each pose",
            lacks="starts",
        )
    best = min(followed, key=lambda f: f.chi2)
    if _explains(cost, [best]):
        state, _ = gauss_newton(cost, best.state, free, iterations=40)
    else:
        state = progressive(cost, best.state, free)
    return state, tuple(f.chi2 for f in followed)


def _explains(cost: Cost, followed: list[Followed]) -> bool:
    """Whether one of the starts explains the data."""
    return any(f.chi2 < _EXPLAINED * cost.n_data for f in followed)


def _follow(cost: Cost, free: Free, starts: Iterator[Orientations]) -> list[Followed]:
    """Follow starts, the one with the least chi-squared after two steps first.

    Once one explains the data down to its noise, others are followed only where those two steps
    brought them nearly as far.
    """
    # From far away, a sensor matrix would rather turn itself inside out: it is released last.
    coordinate = np.arange(N_SU)
    placements = Free(free.joints, free.logs, free.sus & (coordinate < N_PLACEMENT))
    unshaped = Free(free.joints, free.logs, free.sus & (coordinate < N_PLACEMENT + 3))

    def refined(state: State, steps: int, what: Free) -> Followed:
        return Followed(*gauss_newton(cost, state, what, steps, 1e-2, _CAUTION))

    begun = [refined(placed(cost, start, free), 2, placements) for start in starts]
    begun.sort(key=lambda f: f.chi2)
    noise = cost.n_data + 5 * np.sqrt(2 * cost.n_data)
    followed: list[Followed] = []
    for begin in begun:
        if begin.chi2 > _HOPELESS * begun[0].chi2 and followed[0].chi2 < noise:
            break
        nearly = refined(begin.state, 6, placements)
        nearly = refined(nearly.state, 20, unshaped)
        enough = max(1e-6, smallest_fall(cost, nearly.chi2))
        followed.append(Followed(*gauss_newton(cost, nearly.state, free, 8, enough)))
    return followed


def _slopes_measured(cost: Cost) -> bool:
    """Whether most DoFs' slopes s were measured in most poses where the DoF moved the SU."""
    L = cost.blocks.chains.joint.shape[1]
    slopes = cost.blocks.variance[:, :, 1 : 1 + L][:, cost.blocks.chains.present]
    levers = cost.blocks.variance[:, :, 1 + L :][:, cost.blocks.chains.present]
    return bool(np.isfinite(slopes).sum() > 0.5 * max(1, int(np.isfinite(levers).sum())))


def placed(cost: Cost, start: Orientations, free: Free) -> State:
    """Positions for known orientations: one linear least-squares problem (tau = w x r).

    SUs whose turn about gravity gravity does not show, behind a vertical axis, are left out
    at first; then each is turned and placed by what it feels of the joints' accelerations.

    Args:
        cost: the cost.
        start: orientations.
        free: which coordinates may move.
    """
    joints, sus = free.joints.copy(), free.sus.copy()
    joints[:, 2:], sus[:, 3:] = False, False
    only = Free(joints, np.zeros_like(free.logs), sus)
    loose = _loose(cost.tree, start)
    firm = cost
    if loose.any():
        weight = np.broadcast_to(1.0 * ~loose, cost.blocks.count.shape)
        firm = Cost(cost.tree, cost.blocks.reweighted(weight), cost.priors)
    state = start.state(cost.tree)
    here = firm.at(state)
    step = factor(here.normal_equations(), only, _CAUTION).newton_step(here.gradient())
    state = moved(state, step)
    if not loose.any():
        return state
    T = state.T_joint_su.copy()
    kin = cost.at(state).kin
    for u in np.flatnonzero(loose):
        T[u] = T[u] @ _turned_about_gravity(cost, int(u), kin.w[:, u], kin.v[:, u], start)
    return replace(state, T_joint_su=T)


def _loose(tree: KinematicTree, start: Orientations) -> Bool:
    """(U,) SUs to be turned about gravity later; enough are kept to place all joints by."""
    certain = np.einsum("i,uij,j->u", start.up[0], start.information, start.up[0])
    loose = certain < _LOOSE**-2
    covered = {j for u in np.flatnonzero(~loose) for j in tree.chain(int(tree.su_joint[u]))}
    for u in sorted(np.flatnonzero(loose), key=lambda u: -len(tree.chain(int(tree.su_joint[u])))):
        chain = tree.chain(int(tree.su_joint[u]))
        if not covered.issuperset(chain):
            loose[u] = False
            covered.update(chain)
    return np.asarray(loose & (tree.su_joint >= 0))


def _turned_about_gravity(cost: Cost, su: int, w: F64, v: F64, start: Orientations) -> F64:
    """Transform (4, 4) from an SU's frame to the one it has by its accelerations.

    With y the reading per acceleration, f the direction of gravity in the SU's frame, and c, s
    the cosine and sine of the turn, ``f (f.y) + c (y - f (f.y)) + s f x y = v + w x r`` is linear
    in c, s and the SU's position r.

    Args:
        cost: the cost.
        su: which SU.
        w: (P, L, 3) axes of its chain in its frame, and
        v: (P, L, 3) linear columns of its Jacobian, for an SU in its joint's origin.
        start: the orientations it was placed by.
    """
    blocks, n = cost.blocks, int(cost.blocks.chains.length[su])
    rows = 1 + blocks.chains.joint.shape[1] + np.arange(n)
    variance = blocks.variance[:, su][:, rows] * (blocks.noise[:, su] ** 2).mean(-1)[:, None]
    p, i = np.nonzero(np.isfinite(variance))
    weight = 1 / np.sqrt(variance[p, i] + _ROUGH_LEVER**2)
    y = blocks.coefficients[p, su, rows[i]]
    f = start.R_base_su[su].T @ start.up[0]
    along = (y @ f)[:, None] * f
    unknown = np.concatenate([(y - along)[..., None], (skew(f) @ y[..., None]), skew(w[p, i])], -1)
    A = (unknown * weight[:, None, None]).reshape(-1, 5)
    b = ((v[p, i] - along) * weight[:, None]).reshape(-1)
    certain = np.sqrt(max(0.0, float(start.up[0] @ start.information[su] @ start.up[0])) * len(w))
    prior = np.diag([certain, certain, *[1 / cost.priors.position] * 3])
    x = np.linalg.lstsq(
        np.concatenate([A, prior]), np.concatenate([b, [certain, 0, 0, 0, 0]]), rcond=1e-12
    )[0]
    return placement(axis_rotation(f, np.arctan2(x[1], x[0])), x[2:])


def felt_up(state: State, cost: Cost, features: Features) -> F64:
    """Direction opposite to gravity that the SUs feel at rest in each log.

    The median SU knows it, whatever is wrong with some.

    Args:
        state: placements and sensors, whose own directions do not count.
        cost: of all logs.
        features: of all logs.

    Returns:
        (G, 3) unit vectors in the base frame; the state's first one for a log in which no SU of the
        tree is heard.
    """
    everywhere = replace(state, up=np.tile(state.up[:1], (cost.n_logs, 1)))
    order = Ordering.of(cost.tree, features)
    felt = np.linalg.solve(
        state.sensor_matrix(), (features.f0[:, order.su] - state.bias)[..., None]
    )
    up = (cost.at(everywhere).kin.R @ felt)[..., 0]
    known = np.isfinite(cost.blocks.noise).all(axis=2)
    out = np.array(everywhere.up)
    for g in range(cost.n_logs):
        heard = up[known & (cost.blocks.log == g)[:, None]]
        if len(heard):
            middle = np.median(heard, axis=0)
            out[g] = middle / np.linalg.norm(middle)
    return out
