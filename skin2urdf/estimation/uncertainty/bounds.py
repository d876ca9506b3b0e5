"""What errors to expect when an estimate is compared with the truth (the Cramer-Rao bound).

To first order the errors of a comparison are linear in those of the estimated coordinates: the
error of an SU's pose, less the rigid transform that aligns its limb and the motion of branches
along open directions, less what displacing the SU along its unobservable directions takes up.
Their covariance follows from that of the coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.state import JOINT_COORDINATES, N_PLACEMENT, State
from skin2urdf.estimation.uncertainty.covariance import ArrowCovariance
from skin2urdf.estimation.uncertainty.displacements import Displacements
from skin2urdf.model.records import OpenDirection
from skin2urdf.structure.records import KinematicTree

Align = Literal["limbs", "base"]
"""One transform per limb, all that lies beyond one joint on the RS, or one for the whole robot."""

ON_BASE = -1
"""Limb of an SU on the reference segment."""

NEWS = 0.01
"""Part of a motion along an open direction that must remain beside motions of the base."""
_RCOND = 1e-9


@dataclass(frozen=True, eq=False)
class _Rows:
    """Error of one SU's pose in its own frame, linear part first, angular part times an arm.

    It depends on the joint coordinates that the SU's chain has and on the SU's placement for known
    joints, which are independent of each other.

    Attributes:
        columns: (m,) the joint coordinates.
        E: (C, 6, m + 6) error per coordinate at C configurations, those of the placement last.
        G: (C, 6, 6 + K) error per motion of the whole base frame, and along K open directions.
        own: (6, 6) covariance of the placement for known joints.
    """

    columns: Int
    E: F64
    G: F64
    own: F64

    def without(self, free: F64) -> _Rows:
        """The rows less what one displacement along free directions (k, 6) takes up."""
        P = free.T @ free
        return replace(self, E=self.E - P @ self.E.mean(axis=0), G=self.G - P @ self.G.mean(axis=0))


@dataclass(frozen=True, eq=False)
class _Fit:
    """The motion of the base frame and along K open directions that aligns a limb best.

    Attributes:
        by_placement: (6 + K, 6) its change per coordinate of an SU's placement, for the SUs that
            it is fitted to.
        across: (J, 6 + K) its covariance with the joint coordinates.
        within: (6 + K, 6 + K) its covariance.
    """

    by_placement: dict[int, F64]
    across: F64
    within: F64


def limbs_of(tree: KinematicTree) -> Int:
    """(U,) joint that names each SU's limb; :data:`ON_BASE` on the RS.

    It is the first revolute joint before the SU: sliding parts keep their orientation, so limbs
    on a slide are as unconnected as limbs on the RS.
    """
    limbs = []
    for joint in tree.su_joint:
        chain = tree.chain(int(joint))
        turning = [j for j in chain if not tree.prismatic[j]]
        limbs.append((turning or chain or (ON_BASE,))[0])
    return np.array(limbs, dtype=np.int64)


def moved_sus(tree: KinematicTree, directions: Sequence[OpenDirection]) -> Bool:
    """(K, U) the SUs that each of K open directions moves."""
    active = tree.activity()
    joints = [[name in each.joints for name in tree.joint_names] for each in directions]
    sus = [[name in each.sus for name in tree.su_names] for each in directions]
    by_joint = np.reshape(joints, (-1, tree.n_joints)).astype(int) @ active.T.astype(int) > 0
    return np.asarray(by_joint | np.reshape(sus, (-1, tree.n_sus)).astype(bool))


def expected_errors(
    tree: KinematicTree,
    state: State,
    covariance: ArrowCovariance,
    q: F64,
    *,
    free: Sequence[F64],
    trust: Int,
    arm: float,
    open_directions: Sequence[OpenDirection] = (),
    align: Align = "limbs",
) -> tuple[F64, F64]:
    """Standard deviations of SU poses after alignment, as the comparison of URDFs aligns.

    Args:
        tree: the kinematic tree.
        state: the estimate.
        covariance: of its coordinates.
        q: (C, D) configurations [rad or m].
        free: per SU (k, 6) orthonormal directions that do not count (linear [m], angular [rad]
            times ``arm``).
        trust: (U,) each limb is aligned by its SUs of the highest value; negative for SUs that
            align nothing. Where an open direction moves none of these, the best that it moves
            join them.
        arm: length that angles are weighed by [m].
        open_directions: ways in which branches may sit elsewhere that do not count either.
        align: one transform per limb, or one for all.

    Returns:
        Position (U,) [m] and orientation (U,) [rad], root mean square over configurations. Of an
        SU on the RS the position is 0, for it never counts.
    """
    limbs = limbs_of(tree)
    rows = _error_rows(tree, state, q, covariance, open_directions, arm)
    up = np.array([0.0, 0.0, 1.0])
    for u, row in enumerate(rows):
        directions = free[u]
        if limbs[u] == ON_BASE:
            yaw = state.T_joint_su[u, :3, :3].T @ up if align == "limbs" else np.zeros(3)
            directions = _span(np.vstack([directions, np.eye(6)[:3], np.r_[0.0, 0.0, 0.0, yaw]]))
        rows[u] = row.without(directions)

    groups = limbs if align == "limbs" else np.zeros_like(limbs)
    moved = moved_sus(tree, open_directions)
    anchors = {int(g): _anchors(groups, trust, moved, int(g)) for g in groups if g != ON_BASE}
    fits = {
        g: _fit({int(u): rows[u] for u in on}, covariance.joint)
        for g, on in anchors.items()
        if len(on)
    }
    leading = max(fits, key=lambda g: (len(anchors[g]), tree.joint_names[g]), default=ON_BASE)

    deviations = np.full((len(rows), 2), np.nan)
    for u, row in enumerate(rows):
        fit = fits.get(leading if groups[u] == ON_BASE else int(groups[u]))
        if fit is not None:
            deviations[u] = _deviations(row, u, fit, covariance.chain(u))
    return deviations[:, 0], deviations[:, 1] / arm


def _error_rows(
    tree: KinematicTree,
    state: State,
    q: F64,
    covariance: ArrowCovariance,
    open_directions: Sequence[OpenDirection],
    arm: float,
) -> list[_Rows]:
    """Errors of all SUs."""
    moves = Displacements.of(tree, state, q, arm)
    local = np.swapaxes(moves.by_joint[..., list(JOINT_COORDINATES)], 2, 3)
    local = local.reshape(*local.shape[:3], -1)
    along = [moves.along(direction) for direction in open_directions]
    G = np.concatenate([moves.by_base, *(motion[..., None] for motion in along)], axis=-1)
    result = []
    for u in range(tree.n_sus):
        columns = covariance.columns[u]
        E = np.zeros((len(q), 6, len(columns) + N_PLACEMENT))
        E[..., : local.shape[-1]] = local[:, u]
        E[..., : len(columns)] += covariance.lean[u, :N_PLACEMENT] * moves.scale[:, None]
        E[..., len(columns) :] = np.diag(moves.scale)
        own = covariance.own[u, :N_PLACEMENT, :N_PLACEMENT]
        result.append(_Rows(columns, E, G[:, u], own))
    return result


def _anchors(groups: Int, trust: Int, moved: Bool, group: int) -> Int:
    """SUs that a limb is aligned by; ``moved`` (K, U) tells what each open direction moves."""
    members = (groups == group) & (trust >= 0)
    anchors = members & (trust == trust[groups == group].max())
    for mine in moved & members:
        if mine.any() and not (mine & anchors).any():
            anchors |= mine & (trust == trust[mine].max())
    return np.flatnonzero(anchors)


def _fit(rows: Mapping[int, _Rows], joint: F64) -> _Fit:
    """The alignment by least squares over the given SUs."""
    k = next(iter(rows.values())).G.shape[-1]
    N, M = np.zeros((k, k)), np.zeros((k, len(joint)))
    by_placement = {}
    for u, row in rows.items():
        N += np.einsum("cij,cik->jk", row.G, row.G)
        both = np.einsum("cij,cik->jk", row.G, row.E)
        np.add.at(M.T, row.columns, both[:, :-N_PLACEMENT].T)
        by_placement[u] = both[:, -N_PLACEMENT:]
    kept = _kept(N)
    solve = np.zeros_like(N)
    solve[np.ix_(kept, kept)] = np.linalg.pinv(N[np.ix_(kept, kept)], rcond=_RCOND, hermitian=True)
    by_joints = solve @ M
    by_placement = {u: solve @ block for u, block in by_placement.items()}
    across = joint @ by_joints.T
    within = by_joints @ across
    for u, block in by_placement.items():
        within += block @ rows[u].own @ block.T
    return _Fit(by_placement, across, within)


def _kept(N: F64) -> Int:
    """Columns of normal equations N (6 + K) to fit: the base's, and what open directions add."""
    base = np.linalg.pinv(N[:6, :6], rcond=_RCOND, hermitian=True)
    beside = np.diag(N)[6:] - np.einsum("ik,ij,jk->k", N[:6, 6:], base, N[:6, 6:])
    return np.concatenate([np.arange(6), 6 + np.flatnonzero(beside > NEWS**2 * np.diag(N)[6:])])


def _deviations(row: _Rows, u: int, fit: _Fit, chain: F64) -> tuple[float, float]:
    """Root mean square of the linear and of the angular part of the error of SU u.

    Args:
        row: its error.
        u: the SU.
        fit: the alignment of its limb.
        chain: (m, m) covariance of the joint coordinates that it depends on.
    """
    m, k = len(chain), len(fit.within)
    S = np.zeros((m + N_PLACEMENT + k, m + N_PLACEMENT + k))
    S[:m, :m], S[m:-k, m:-k], S[-k:, -k:] = chain, row.own, fit.within
    S[:m, -k:] = fit.across[row.columns]
    if u in fit.by_placement:
        S[m:-k, -k:] = row.own @ fit.by_placement[u].T
    S[-k:, :-k] = S[:-k, -k:].T
    F = np.concatenate([row.E, -row.G], axis=-1)
    variance = np.einsum("cij,cij->ci", F @ S, F).mean(axis=0).clip(min=0.0)
    return float(np.sqrt(variance[:3].sum())), float(np.sqrt(variance[3:].sum()))


def _span(rows: F64) -> F64:
    """(k, 6) orthonormal directions that span given ones (m, 6)."""
    _, values, Vt = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(Vt[values > 1e-6])
