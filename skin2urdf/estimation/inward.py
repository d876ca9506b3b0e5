"""Closed-form start, inwards: peel one joint after the other off an SU's chain.

In the SU's own frame the axis of the last joint is the same in every pose: ``tau_n`` and ``s_n``
are perpendicular to it and ``s_n = f0 x k``. Undoing that joint's known rotation in every pose
makes the next axis constant in turn, down to the base. Needs measured slopes s, and nothing but
one SU at the tip of each limb.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import brentq

from skin2urdf.arrays import F64
from skin2urdf.estimation.blocks import FeatureBlocks
from skin2urdf.estimation.cost import Priors
from skin2urdf.estimation.orientation import ROUGH_BIAS, Orientations, with_all_sus
from skin2urdf.model.spatial import axis_rotation, cross, frame_with_z, skew, wahba
from skin2urdf.structure.records import KinematicTree

_SENSE_EVIDENCE = 30.0
"""Chi-squared difference below which both senses of an axis are kept as hypotheses."""
_SENSE_LEVER = 1.5
"""Gravity across an axis [m/s^2 rms] below which its sense is not taken from gravity's slope."""
_MOST_HYPOTHESES = 8


def inward_starts(
    tree: KinematicTree, blocks: FeatureBlocks, priors: Priors
) -> Iterator[Orientations]:
    """Starts from the outermost SU of every limb; several where an axis' sense is open.

    Limbs that share joints are turned onto each other by the shared axes and gravity; limbs
    that share none keep an arbitrary relative yaw, which nothing in the data determines.
    """
    tips = _tips(tree, blocks)
    combinations: list[list[tuple[F64, F64]]] = [[]]
    for su in tips:
        options = list(_peel(tree, blocks, su))
        combinations = [[*c, o] for c in combinations for o in options][:_MOST_HYPOTHESES]
    for combination in combinations:
        axes = np.full((tree.n_joints, 3), np.nan)
        up = np.zeros((int(blocks.log.max(initial=0)) + 1, 3))
        up[:] = np.nan
        for su, (k, h) in zip(tips, combination, strict=True):
            chain = list(tree.chain(int(tree.su_joint[su])))
            R = _onto_base(axes[chain], k, up, h)
            new = np.isnan(axes[chain]).any(axis=1)
            axes[np.array(chain)[new]] = k[new] @ R.T
            up = np.where(np.isnan(up), h @ R.T, up)
        axes = np.where(np.isnan(axes), (0.0, 0.0, 1.0), axes)
        up = np.where(np.isnan(up), (0.0, 0.0, 1.0), up)
        # The limb that came first need not be in the first log, whose up is z.
        R = frame_with_z(up[0]).T
        axes, up = axes @ R.T, up @ R.T
        yield with_all_sus(tree, blocks, axes, up, priors)


def _tips(tree: KinematicTree, blocks: FeatureBlocks) -> list[int]:
    """SUs whose chains together cover every joint, longest chains and best data first."""
    data = np.isfinite(blocks.noise).all(axis=-1).sum(axis=0)
    order = sorted(range(tree.n_sus), key=lambda u: (-int(blocks.chains.length[u]), -int(data[u])))
    covered: set[int] = set()
    tips = []
    for u in order:
        chain = set(tree.chain(int(tree.su_joint[u])))
        if not chain <= covered:
            tips.append(u)
            covered |= chain
    return tips


def _onto_base(known: F64, k: F64, up: F64, h: F64) -> F64:
    """R_base_tip that turns a limb's axes k and ups h onto what is already in the base frame."""
    shared = np.isfinite(known).all(axis=1)
    logs = np.isfinite(up).all(axis=1) & np.isfinite(h).all(axis=1)
    reference = np.concatenate([known[shared], up[logs]])
    body = np.concatenate([k[shared], h[logs]])
    if not len(body):
        first = frame_with_z(h[np.flatnonzero(np.isfinite(h).all(axis=1))[0]])
        return np.asarray(first.T)
    if len(body) < 2:
        return np.asarray(frame_with_z(reference[0]) @ frame_with_z(body[0]).T)
    R, _ = wahba(body, reference, np.ones(len(body)))
    return R


def _peel(tree: KinematicTree, blocks: FeatureBlocks, su: int) -> Iterator[tuple[F64, F64]]:
    """Axes (n, 3) and up vectors (G, 3), both in the SU's frame at position zero."""
    chain = list(tree.chain(int(tree.su_joint[su])))
    ok = np.isfinite(blocks.noise[:, su]).all(axis=1)
    n, L = len(chain), blocks.chains.joint.shape[1]
    noise2 = (blocks.noise[ok, su] ** 2).mean(axis=1)
    y, variance = blocks.coefficients[ok, su], blocks.variance[ok, su] * noise2[:, None]
    q, log = blocks.q[ok][:, chain], blocks.log[ok]
    prismatic = tree.prismatic[chain]

    def inwards(i: int, R: F64, axes: tuple[F64, ...]) -> Iterator[tuple[F64, F64]]:
        f0 = (R @ y[:, 0, :, None])[..., 0]
        if i < 0:
            G = int(blocks.log.max(initial=0)) + 1
            h = np.full((G, 3), np.nan)
            for g in np.unique(log):
                mean = f0[log == g].mean(axis=0)
                h[g] = mean / np.linalg.norm(mean)
            yield np.array(axes), h
            return
        tau = (R @ y[:, 1 + L + i, :, None])[..., 0]
        if prismatic[i]:
            w = 1 / variance[:, 1 + L + i]
            mean = (tau * w[:, None]).sum(axis=0)
            yield from inwards(i - 1, R, (mean / np.linalg.norm(mean), *axes))
            return
        s = (R @ y[:, 1 + i, :, None])[..., 0]
        for k in constant_axis(f0, s, tau, variance[:, 1 + i], variance[:, 1 + L + i]):
            yield from inwards(i - 1, axis_rotation(k, q[:, i]) @ R, (k, *axes))

    identity = np.broadcast_to(np.eye(3), (int(ok.sum()), 3, 3))
    yield from inwards(n - 1, identity, ())


def constant_axis(f0: F64, s: F64, tau: F64, var_s: F64, var_tau: F64) -> list[F64]:
    """The axis that is constant in all poses; both senses where the data leave it open.

    Minimises the misfit of ``s = f0 x k`` and of ``s . k = tau . k = 0`` over unit vectors k.
    """
    w_s = np.where(np.isfinite(var_s), 1 / np.maximum(var_s, 1e-300), 0.0)
    w_tau = np.where(np.isfinite(var_tau), 1 / np.maximum(var_tau, 1e-300), 0.0)
    w_rough = np.where(w_s > 0, 1 / (np.where(w_s > 0, var_s, 0.0) + ROUGH_BIAS**2), 0.0)
    S = skew(f0)
    A = np.einsum("p,pi,pj->ij", w_s, s, s) + np.einsum("p,pi,pj->ij", w_tau, tau, tau)
    A += np.einsum("p,pji,pjk->ik", w_rough, S, S)
    b = np.einsum("p,pji,pj->i", w_rough, S, s)
    k = _least_on_sphere(A, b)
    lever = np.sqrt(np.mean(np.sum(cross(f0, k[None]) ** 2, axis=-1)))
    certain = 4 * float(b @ k) > _SENSE_EVIDENCE and lever > _SENSE_LEVER
    return [k] if certain else [k, -k]


def _least_on_sphere(A: F64, b: F64) -> F64:
    """Unit vector k that minimises ``k.A.k - 2 b.k`` (secular equation of the multiplier)."""
    lam, Q = np.linalg.eigh(A)
    beta = Q.T @ b
    size = float(np.linalg.norm(beta))
    if size <= 1e-12 * max(float(lam[2]), 1e-300) or abs(beta[0]) < 1e-9 * size:
        k = Q[:, 0]
        return np.asarray(k if b @ k >= 0 else -k)

    def excess(shift: float) -> float:
        return float(np.sum((beta / (lam - lam[0] + shift)) ** 2) - 1.0)

    low = abs(beta[0]) * (1 - 1e-12)
    shift = brentq(excess, min(low, size) * 1e-3, size * 1.0001, xtol=1e-14 * size)
    k = Q @ (beta / (lam - lam[0] + shift))
    return np.asarray(k / np.linalg.norm(k))
