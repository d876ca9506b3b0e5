"""Closed-form start, outwards from the RS, where slopes s were not measured.

The training data of the paper are gravity and peak acceleration only. Gravity h_p in the parent
segment's frame is known in every pose; for a candidate axis k of the next joint, the SU rotation
that best maps ``Rot(k, -q_p) h_p`` onto the readings is Wahba's problem. Only k is searched: on a
grid over the sphere, the best candidates then refined by Gauss-Newton with ``tau_n . k = 0`` as a
second term. Hypotheses the data can not tell apart yet (axis 1 along gravity, both senses) are
carried along.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.start.orientation import (
    ROUGH_BIAS,
    Orientations,
    su_orientation,
    with_all_sus,
)
from skin2urdf.estimation.start.peeling import Readings, misfit_of
from skin2urdf.geometry.so3 import (
    axis_rotation,
    cross,
    fibonacci_sphere,
    rotation_exp,
    skew,
    spread_out,
    wahba,
)
from skin2urdf.structure.records import KinematicTree

_GRID = 800
_REFINED = 4
_MOST_HYPOTHESES = 4
_EQUAL_COST = 30.0
"""Chi-squared difference up to which an alternative axis stays a hypothesis."""


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    axes: tuple[F64, ...]
    cost: float


def outward_starts(
    tree: KinematicTree, blocks: FeatureBlocks, priors: Priors
) -> Iterator[Orientations]:
    """Starts for trees of revolute joints with an SU on every segment, best first.

    Yields nothing where a segment carries no SU that is heard or a joint is prismatic: their axes
    can not be found from gravity in the next segment.
    """
    heard = np.isfinite(blocks.noise).all(axis=2).any(axis=0)
    on_segment = [np.flatnonzero(heard & (tree.su_joint == j)) for j in range(tree.n_joints)]
    if not tree.n_joints or tree.prismatic.any() or any(not len(u) for u in on_segment):
        return
    if blocks.log.max(initial=0) > 0:
        return
    beam = [_Hypothesis((), 0.0)]
    for j in range(tree.n_joints):
        extended = [e for h in beam for e in _extend(tree, blocks, priors, h, j, on_segment[j])]
        if len(extended) > 1:
            su = int(on_segment[j][0])
            extended.sort(key=lambda h: h.cost + _lever_misfit(tree, blocks, priors, h, su))
        beam = extended[:_MOST_HYPOTHESES]
    for h in beam:
        yield with_all_sus(tree, blocks, np.array(h.axes), np.array([[0.0, 0.0, 1.0]]), priors)


def _lever_misfit(
    tree: KinematicTree, blocks: FeatureBlocks, priors: Priors, found: _Hypothesis, su: int
) -> float:
    """Chi-squared of an SU's lever arms, which tells the senses of vertical axes apart."""
    chain = list(tree.chain(int(tree.su_joint[su])))
    axes, prismatic = np.array(found.axes)[chain], tree.prismatic[chain]
    up = np.array([[0.0, 0.0, 1.0]])
    R_base_su, *_ = su_orientation(blocks, su, axes, prismatic, up, priors)
    return misfit_of(Readings.of(blocks, su), axes @ R_base_su, prismatic)


def _extend(
    tree: KinematicTree,
    blocks: FeatureBlocks,
    priors: Priors,
    before: _Hypothesis,
    joint: int,
    sus: Int,
) -> list[_Hypothesis]:
    """All hypotheses for the next axis that the readings on its segment allow."""
    su = int(sus[0])
    chain = list(tree.chain(joint))
    L = blocks.chains.joint.shape[1]
    ok = np.isfinite(blocks.noise[:, su]).all(axis=1)
    noise2 = (blocks.noise[ok, su] ** 2).mean(axis=1)
    q = blocks.q[ok][:, chain]
    R = np.broadcast_to(np.eye(3), (len(q), 3, 3))
    axes_parent = []
    for i, j in enumerate(chain[:-1]):
        R = R @ axis_rotation(before.axes[j], q[:, i])
    for i, j in enumerate(chain[:-1]):
        beyond = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        for e in range(i + 1, len(chain) - 1):
            beyond = beyond @ axis_rotation(before.axes[chain[e]], q[:, e])
        axes_parent.append(before.axes[j] @ beyond)
    h = R[:, 2] * priors.gravity
    f0 = blocks.coefficients[ok, su, 0]
    var_f0 = noise2 * blocks.variance[ok, su, 0] + ROUGH_BIAS**2
    rows = 1 + L + np.arange(len(chain))
    tau = blocks.coefficients[ok, su][:, rows]
    w_tau = 1 / (noise2[:, None] * blocks.variance[ok, su][:, rows] + 1e-6)
    problem = _NextAxis(q[:, -1], h, f0, 1 / var_f0, tau, w_tau, np.array(axes_parent))
    grid = fibonacci_sphere(_GRID)
    candidates = grid[np.argsort(problem.grid_loss(grid), kind="stable")]
    k, cost = problem.refine(spread_out(candidates, _REFINED))
    order = np.argsort(cost)
    kept: list[int] = []
    for i in order:
        close = cost[i] - cost[order[0]] < max(_EQUAL_COST, 0.05 * cost[order[0]])
        if close and all(_distinct(k[i], k[o], h) for o in kept):
            kept.append(int(i))
    return [
        _Hypothesis((*before.axes, k[i]), before.cost + float(cost[i]))
        for i in kept[:_MOST_HYPOTHESES]
    ]


def _distinct(a: F64, b: F64, h: F64) -> bool:
    """Whether two axes are different hypotheses.

    Where gravity h (P, 3) in the parent segment hardly moves, an axis' azimuth about it is a
    gauge freedom, or nearly so, and only its angle to gravity counts.
    """
    mean = h.mean(axis=0) / np.linalg.norm(h, axis=1).mean()
    if np.linalg.norm(mean) > 0.995:
        angles = np.arccos(np.clip(np.array([a @ mean, b @ mean]), -1, 1))
        return bool(abs(angles[0] - angles[1]) > 0.1)
    return bool(a @ b < 0.999)


@dataclass(frozen=True, eq=False)
class _NextAxis:
    """Misfit of the next axis k, given everything before it.

    Attributes:
        q: (P,) positions of the joint.
        h: (P, 3) gravity in the parent segment's frame [m/s^2].
        f0: (P, 3) readings.
        w_f0: (P,) their weights.
        tau: (P, n, 3) linear Jacobian columns, the joint's own last.
        w_tau: (P, n) their weights.
        parents: (n - 1, P, 3) axes before, in the parent segment's frame.
    """

    q: F64
    h: F64
    f0: F64
    w_f0: F64
    tau: F64
    w_tau: F64
    parents: F64

    def turned(self, k: F64, x: F64) -> F64:
        """(K, P, 3) vectors x (P, 3) of the parent segment seen beyond an axis k (K, 3)."""
        c, s = np.cos(self.q)[:, None], np.sin(self.q)[:, None]
        along = (k @ x.T)[..., None] * k[:, None]
        return np.asarray(c * x - s * cross(k[:, None], x) + (1 - c) * along)

    def grid_loss(self, k: F64) -> F64:
        """(K,) Wahba's loss of static gravity for axes k (K, 3), rotations eliminated.

        The largest eigenvalue of Davenport's matrix by Newton's method (Markley's FOAM).
        """
        # B = sum w f (Rot(k, -q) h)^T is a polynomial in k.
        weighted = self.w_f0[:, None] * self.f0
        c, s = np.cos(self.q)[:, None], np.sin(self.q)[:, None]
        B_cos, B_sin = (weighted * c).T @ self.h, (weighted * s).T @ self.h
        B_rest = weighted.T @ self.h - B_cos
        B = B_cos - B_sin @ np.swapaxes(skew(k), 1, 2)
        B = B + (k @ B_rest.T)[:, :, None] * k[:, None, :]
        total = 0.5 * np.sum(self.w_f0[:, None] * (self.f0**2 + self.h**2))
        BtB = np.swapaxes(B, 1, 2) @ B
        norm2 = np.trace(BtB, axis1=1, axis2=2)
        det = (cross(B[:, 0], B[:, 1]) * B[:, 2]).sum(axis=1)
        adj2 = 0.5 * (norm2**2 - (BtB * BtB).sum(axis=(1, 2)))
        lam = np.full(len(k), total)
        for _ in range(12):
            a = lam**2 - norm2
            value = a**2 - 8 * lam * det - 4 * adj2
            slope = 4 * lam * a - 8 * det
            lam = lam - value / np.where(np.abs(slope) > 1e-300, slope, np.inf)
        return np.asarray(total - lam)

    def refine(self, k: F64, iterations: int = 7) -> tuple[F64, F64]:
        """Gauss-Newton on axis and SU rotation from several axes at once.

        Args:
            k: (K, 3) start axes.
            iterations: fixed number of steps.

        Returns:
            Axes (K, 3) and their misfits (K,).
        """
        K, P = len(k), len(self.q)
        y = self.turned(k, self.h)
        R, _ = wahba(np.broadcast_to(self.f0, (K, P, 3)), y, np.broadcast_to(self.w_f0, (K, P)))
        r, J = self._linearised(k, R)
        cost = np.einsum("ki,ki->k", r, r)
        damping = np.full(K, 1e-6)
        for _ in range(iterations):
            H = np.swapaxes(J, 1, 2) @ J
            g = (np.swapaxes(J, 1, 2) @ r[..., None])[..., 0]
            scale = np.einsum("kii->ki", H).max(axis=1)
            H += ((damping + 1e-12) * scale)[:, None, None] * np.eye(5)
            step = np.asarray(-np.linalg.solve(H, g[..., None])[..., 0])
            trial_k: F64 = np.asarray(k + (_tangent(k) @ step[:, :2, None])[..., 0])
            trial_k /= np.linalg.norm(trial_k, axis=1, keepdims=True)
            trial_R = R @ rotation_exp(step[:, 2:])
            trial_r, trial_J = self._linearised(trial_k, trial_R)
            trial_cost = np.einsum("ki,ki->k", trial_r, trial_r)
            better = trial_cost < cost
            k = np.where(better[:, None], trial_k, k)
            R = np.where(better[:, None, None], trial_R, R)
            r = np.where(better[:, None], trial_r, r)
            J = np.where(better[:, None, None], trial_J, J)
            gain = float(np.max((cost - trial_cost) / np.maximum(cost, 1e-300)))
            cost = np.where(better, trial_cost, cost)
            damping = np.where(better, damping / 10, damping * 100)
            if gain < 1e-3:
                break
        return k, cost

    def _linearised(self, k: F64, R: F64) -> tuple[F64, F64]:
        """Weighted residuals (K, N) and their Jacobian (K, N, 5) in tangent and rotation."""
        K, P = len(k), len(self.q)
        tangent = _tangent(k)
        Rt = np.swapaxes(R, 1, 2)[:, None]
        residuals, jacobians = [], []

        def add(reading: F64, x: F64, root: F64) -> None:
            """Rows of ``reading - R^T turned(k, x)`` where the reading is a known vector."""
            y = (Rt @ self.turned(k, x)[..., None])[..., 0]
            Dk = Rt @ self._turned_by_axis(k, x) @ tangent[:, None]
            residuals.append(((reading - y) * root[:, None]).reshape(K, -1))
            J = np.concatenate([-Dk, -skew(y)], axis=-1) * root[:, None, None]
            jacobians.append(J.reshape(K, -1, 5))

        def add_perpendicular(tau: F64, w: F64, Dw: F64, root: F64) -> None:
            """Rows of ``tau . w = 0`` for an axis w (K, P, 3) in the SU's frame."""
            residuals.append(np.einsum("pi,kpi->kp", tau, w) * root)
            by_axis = np.einsum("pi,kpij->kpj", tau, Dw)
            by_turn = np.einsum("pi,kpij->kpj", tau, skew(w))
            jacobians.append(np.concatenate([by_axis, by_turn], axis=-1) * root[:, None])

        add(self.f0, self.h, np.sqrt(self.w_f0))
        own = np.broadcast_to((Rt[:, 0] @ k[..., None])[..., 0][:, None], (K, P, 3))
        D_own = np.broadcast_to((Rt[:, 0] @ tangent)[:, None], (K, P, 3, 2))
        add_perpendicular(self.tau[:, -1], own, D_own, np.sqrt(self.w_tau[:, -1]))
        for i, x in enumerate(self.parents):
            w = (Rt @ self.turned(k, x)[..., None])[..., 0]
            Dw = Rt @ self._turned_by_axis(k, x) @ tangent[:, None]
            add_perpendicular(self.tau[:, i], w, Dw, np.sqrt(self.w_tau[:, i]))
        return np.concatenate(residuals, axis=1), np.concatenate(jacobians, axis=1)

    def _turned_by_axis(self, k: F64, x: F64) -> F64:
        """(K, P, 3, 3) derivative of :meth:`turned` in k."""
        c, s = np.cos(self.q)[:, None, None], np.sin(self.q)[:, None, None]
        along = (k @ x.T)[..., None, None] * np.eye(3) + k[:, None, :, None] * x[:, None, :]
        return np.asarray(s * skew(x) + (1 - c) * along)


def _tangent(k: F64) -> F64:
    """(K, 3, 2) orthonormal bases of the planes perpendicular to k (K, 3)."""
    flat = np.argmin(np.abs(k), axis=1)
    a = cross(k, np.eye(3)[flat])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return np.stack([a, cross(k, a)], axis=2)
