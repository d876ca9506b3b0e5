"""What errors to expect when an estimate is compared with the truth (the Cramer-Rao bound).

To first order the errors of a comparison are linear in those of the estimated coordinates: the
error of an SU's pose, less the rigid transform that aligns its limb, less what displacing it along
its unobservable directions takes up. Their covariance follows from that of the coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.covariance import ArrowCovariance
from skin2urdf.estimation.state import N_JOINT, N_PLACEMENT, State
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.model.prediction import Chains, joint_twists, su_kinematics, zero_frames
from skin2urdf.model.spatial import skew
from skin2urdf.structure.records import KinematicTree

Align = Literal["limbs", "base"]
"""One transform per limb, all that lies beyond one joint on the RS, or one for the whole robot."""

ON_BASE = -1
"""Limb of an SU on the reference segment."""

_BASIS = np.zeros((6, N_JOINT))
_BASIS[[3, 4, 0, 1], [0, 1, 2, 3]] = 1.0
_RCOND = 1e-9


@dataclass(frozen=True, eq=False)
class _Rows:
    """Error of one SU's pose in its own frame, linear part first, angular part times an arm.

    It depends on the joint coordinates that the SU's chain has and on the SU's placement for known
    joints, which are independent of each other.

    Attributes:
        columns: (m,) the joint coordinates.
        E: (C, 6, m + 6) error per coordinate at C configurations, those of the placement last.
        G: (C, 6, 6) error per motion of the whole base frame.
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
    """The motion of the base frame that aligns a limb best.

    Attributes:
        by_placement: (6, 6) its change per coordinate of an SU's placement, for the SUs that it is
            fitted to.
        across: (J, 6) its covariance with the joint coordinates.
        within: (6, 6) its covariance.
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


def expected_errors(
    tree: KinematicTree,
    state: State,
    covariance: ArrowCovariance,
    q: F64,
    *,
    free: Sequence[F64],
    trust: Int,
    arm: float,
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
            align nothing.
        arm: length that angles are weighed by [m].
        align: one transform per limb, or one for all.

    Returns:
        Position (U,) [m] and orientation (U,) [rad], root mean square over configurations. Of an
        SU on the RS the position is 0, for it never counts.
    """
    limbs = limbs_of(tree)
    rows = _error_rows(tree, state, q, covariance, arm)
    up = np.array([0.0, 0.0, 1.0])
    for u, row in enumerate(rows):
        directions = free[u]
        if limbs[u] == ON_BASE:
            yaw = state.T_joint_su[u, :3, :3].T @ up if align == "limbs" else np.zeros(3)
            directions = _span(np.vstack([directions, np.eye(6)[:3], np.r_[0.0, 0.0, 0.0, yaw]]))
        rows[u] = row.without(directions)

    groups = limbs if align == "limbs" else np.zeros_like(limbs)
    anchors = {int(g): _anchors(groups, trust, int(g)) for g in groups if g != ON_BASE}
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
    tree: KinematicTree, state: State, q: F64, covariance: ArrowCovariance, arm: float
) -> list[_Rows]:
    """Errors of all SUs."""
    chains = Chains.of(tree)
    pinocchio = PinocchioTree(tree)
    pinocchio.write_joints(state.T_parent_joint)
    R, p = pinocchio.joint_frames(q)
    up = np.tile([0.0, 0.0, 1.0], (len(q), 1))
    kin = su_kinematics(chains, tree.su_joint, R, p, state.T_joint_su, up)
    basis = np.tile(_BASIS, (tree.n_joints, 1, 1))
    twists = joint_twists(chains, kin, *zero_frames(R, p, q, tree.prismatic), basis)
    twists = np.roll(twists, 3, axis=-2)  # linear part first
    scale = np.repeat([1.0, arm], 3)[:, None]
    result = []
    for u in range(tree.n_sus):
        columns = covariance.columns[u]
        E = np.zeros((len(q), 6, len(columns) + N_PLACEMENT))
        E[..., : twists.shape[2] * N_JOINT] = np.swapaxes(twists[:, u], 1, 2).reshape(len(q), 6, -1)
        E[..., : len(columns)] += covariance.lean[u, :N_PLACEMENT]
        E[..., len(columns) :] = np.eye(N_PLACEMENT)
        Rt = np.swapaxes(kin.R[:, u], 1, 2)
        G = np.zeros((len(q), 6, 6))
        G[:, :3, :3] = G[:, 3:, 3:] = Rt
        G[:, :3, 3:] = -Rt @ skew(kin.p[:, u])
        own = covariance.own[u, :N_PLACEMENT, :N_PLACEMENT]
        result.append(_Rows(columns, E * scale, G * scale, own))
    return result


def _anchors(groups: Int, trust: Int, group: int) -> Int:
    """SUs that a limb is aligned by."""
    best = trust[groups == group].max()
    return np.flatnonzero((groups == group) & (trust == best) & (trust >= 0))


def _fit(rows: Mapping[int, _Rows], joint: F64) -> _Fit:
    """The alignment by least squares over the given SUs."""
    N, M = np.zeros((6, 6)), np.zeros((6, len(joint)))
    by_placement = {}
    for u, row in rows.items():
        N += np.einsum("cij,cik->jk", row.G, row.G)
        both = np.einsum("cij,cik->jk", row.G, row.E)
        np.add.at(M.T, row.columns, both[:, :-N_PLACEMENT].T)
        by_placement[u] = both[:, -N_PLACEMENT:]
    solve = np.linalg.pinv(N, rcond=_RCOND, hermitian=True)
    by_joints = solve @ M
    by_placement = {u: solve @ block for u, block in by_placement.items()}
    across = joint @ by_joints.T
    within = by_joints @ across
    for u, block in by_placement.items():
        within += block @ rows[u].own @ block.T
    return _Fit(by_placement, across, within)


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
