"""What springs make of the noise of encoders: what is bent by loads swings along with it.

Loads go with accelerations, and so with their noise. Where joints and a base of compliance C carry
links of inertia M, and dampers make them late by L, noise n of joints' accelerations moves them by

    e = (1 + i w L - w^2 C M)^-1 w^2 C M n

besides: near a resonance more than the joints do, and the other way round by loads that weigh less
than nothing. Least squares would ask for these, as for a low-pass of all readings: what they cut
off is taken off chi-squared (corrected scores, as in :mod:`shaken`). About which point a base turns
is taken to be known for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Complex, Record
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.bending import Bending
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, Skeleton
from skin2urdf.estimation.trajectory.torques import regressors
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

FREQUENCIES = 24
"""Frequencies at most at which springs are asked: a fifth of a hertz apart up to 5 Hz, where a
resonance is wider."""
_PLACES = 32
"""Samples at most at which they are: what they make of noise changes with the pose, and is summed
up over all of a log."""
_OF_ALL = 20_000
"""The same times SUs: so many take 30 MB."""


@dataclass(frozen=True, eq=False)
class ShakenSprings(Record):
    """What springs make of the noise of encoders along a log.

    Of several kinds of them each is bent by what joints do.

    Attributes:
        w: (F,) angular frequencies [rad/s].
        felt: (k, U, H, H) products of what SUs feel per unit of acceleration of D joints, and of
            the base's hinges behind them, at some samples [m^2 where both turn, 1 where both
            slide].
        weights: (k, U) information of these [s^4/m^2], and
        shaken: (k, D) share of the noise that is in them.
        inertia: by kind of springs, (k, P, H, H) of joints and hinges, per load: times compliances,
            in [s^2].
    """

    w: F64
    felt: F64
    weights: F64
    shaken: F64
    inertia: tuple[F64, ...]

    @staticmethod
    def of(
        kinds: Sequence[Bending],
        tree: KinematicTree,
        log: Trajectory,
        state: State,
        weights: F64,
        w: F64,
    ) -> ShakenSprings:
        """Of a log at placements.

        Args:
            kinds: what yields.
            tree: the structure.
            log: the trajectory.
            state: the placements.
            weights: (K, U) information of its samples.
            w: (F,) angular frequencies.
        """
        K, U = weights.shape
        most = min(K, _PLACES, max(1, _OF_ALL // U))
        some = np.linspace(0, K - 1, most).round().astype(np.int64)
        q = log.q[log.kept[some], : tree.n_joints]
        base = any(each.base for each in kinds)
        felt = _felt(tree, state, q, base=base)
        square = np.einsum("kuch,kuci->kuhi", felt, felt, optimize=True)
        per_parameter = _per_parameter(tree, log, state, q, base=base)
        inertia = tuple(
            np.einsum("kiho,po->kphi", per_parameter, each.basis, optimize=True) for each in kinds
        )
        return ShakenSprings(w, square, weights[some], log.shaken[some], inertia)

    @property
    def of_rigid(self) -> F64:
        """(U, D) by how much chi-squared grows with each encoder's noise, without springs."""
        n = self.shaken.shape[1]
        return self._sum(np.diagonal(self.felt[:, :, :n, :n], axis1=2, axis2=3))

    def counts(self, kinds: Sequence[Bending], numbers: Sequence[F64]) -> F64:
        """(F, U, D) the same on springs, by the numbers of each kind, frequency by frequency."""
        out, springs = [], self._springs(kinds, numbers)
        for w in self.w:
            swung = self._swung([each.swing(w) for each in springs])
            square = np.einsum("khd,kuhi,kid->kud", swung.conj(), self.felt, swung, optimize=True)
            out.append(self._sum(square.real))
        return np.array(out)

    def pull(
        self, kinds: Sequence[Bending], numbers: Sequence[F64], noise: F64, share: F64
    ) -> list[F64]:
        """By kind of springs, (S,) half of by how much what is left grows with each number.

        Args:
            kinds: what yields, and
            numbers: (S,) the numbers of each.
            noise: (F, D) mean squares of each encoder's noise.
            share: (F, U) by how much of what SUs feel of it counts.
        """
        springs = self._springs(kinds, numbers)
        for w, of_joints, of_sus in zip(self.w, noise, share, strict=True):
            swings = [each.swing(w) for each in springs]
            counts = np.einsum("u,ku,kuhi->khi", of_sus, self.weights, self.felt, optimize=True)
            swung = self._swung(swings).conj().swapaxes(1, 2)
            heard = (of_joints * self.shaken)[..., None] * swung @ counts
            for each, swing in zip(springs, swings, strict=True):
                each.add(w, swing, heard)
        return [each.slopes() for each in springs]

    def _springs(self, kinds: Sequence[Bending], numbers: Sequence[F64]) -> list[_Springs]:
        n, each_kind = self.shaken.shape[1], zip(kinds, self.inertia, numbers, strict=True)
        return [_Springs(bends, inertia, x, n) for bends, inertia, x in each_kind]

    def _swung(self, swings: Sequence[_Swing]) -> Complex:
        """(k, H, D) what joints and hinges do with all springs, per unit of joints' noise."""
        H, n = self.felt.shape[2], self.shaken.shape[1]
        return np.asarray(np.eye(H)[:, :n] + sum(each.moved for each in swings))

    def _sum(self, square: F64) -> F64:
        """(U, D) information in squares (k, U, D) of what SUs feel of each encoder's noise."""
        of_all = np.einsum("ku,kd,kud->ud", self.weights, self.shaken, square, optimize=True)
        return np.asarray(of_all)


@dataclass(frozen=True, eq=False)
class _Swing:
    """What springs of one kind do by a unit of joints' noise, at one frequency.

    Attributes:
        settled: (k, R, D) of each part about the numbers at the origin.
        moved: (k, H, D) of joints and hinges by those numbers and what there is beyond them.
        turned_round: (k, R, R) of parts, per unit of what bends them.
    """

    settled: Complex
    moved: Complex
    turned_round: Complex


class _Springs:
    """Springs of one kind, and sums of what their slopes are made of.

    Args:
        bends: what yields.
        inertia: (k, P, H, H) of joints and hinges, per load.
        x: (S,) its numbers. What they make is as linear in them about the origin as motions are:
            were noise to resonate where no motion does, that would be paid for.
        n: D.
    """

    def __init__(self, bends: Bending, inertia: F64, x: F64, n: int) -> None:
        self._bends, self._inertia, self._n = bends, inertia, n
        self._moves = bends.moves[: inertia.shape[2]]
        P, R, base, more = len(bends.basis), len(bends.parts), bends.of_base, x - bends.origin
        of_loads = (bends.origin[:P], more[:P])
        self._of_loads, self._more_loads = (
            np.einsum("p,kphi->khi", loads, inertia, optimize=True) for loads in of_loads
        )
        C, root = bends.compliance, np.sqrt(np.diag(bends.compliance))
        self._own, self._late = bends.inertia_of_parts, bends.damped * bends.late
        self._more_compliance = 0.5 * (more[P : P + R, None] + more[P : P + R]) * C
        for share, (i, j) in zip(more[bends.of_crosses], bends.crosses, strict=True):
            self._more_compliance[i, j] += root[i] * root[j] * share
            self._more_compliance[j, i] += root[i] * root[j] * share
        self._more_late = bends.damped * (bends.later * more[bends.of_dampers])
        self._more_own = np.zeros_like(self._own)
        if bends.base:
            by_numbers, numbers = bends.inertia_by_numbers, more[bends.of_inertia]
            self._more_own[base, base] = np.einsum("n,nij->ij", numbers, by_numbers)
        self._by_inertia = np.zeros_like(self._of_loads)
        self._by_compliance, self._by_own, self._by_damper = np.zeros((3, R, R))

    def swing(self, w: float) -> _Swing:
        """What they do at an angular frequency."""
        C, moves, by_parts = self._bends.compliance, self._moves, self._moves.T @ self._of_loads
        turned_round = np.linalg.inv(
            np.eye(len(C)) + 1j * w * self._late - w**2 * C @ (by_parts @ moves + self._own)
        )
        settled = w**2 * turned_round @ C @ by_parts[:, :, : self._n]
        more = w**2 * C @ (moves.T @ self._more_loads @ self._moved(settled))
        more += (w**2 * C @ self._more_own - 1j * w * self._more_late) @ settled
        more += self._more_compliance @ self._torques(w, settled)
        return _Swing(settled, moves @ (settled + turned_round @ more), turned_round)

    def add(self, w: float, swing: _Swing, heard: Complex) -> None:
        """Add what is left at a frequency.

        Args:
            w: which.
            swing: what they do there.
            heard: (k, D, H) slopes of what is left by what joints and hinges do.
        """
        C, moves, settled = self._bends.compliance, self._moves, swing.settled
        back = heard @ moves @ swing.turned_round
        by_parts = (settled @ back).sum(axis=0).T
        by_torques = (self._torques(w, settled) @ back).sum(axis=0).T
        of_all = (self._moved(settled) @ back @ C @ moves.T).swapaxes(1, 2)
        self._by_inertia += w**2 * of_all.real
        self._by_compliance += by_torques.real
        self._by_own += w**2 * (C @ by_parts).real
        self._by_damper += (-1j * w * by_parts).real

    def slopes(self) -> F64:
        """(S,) half of by how much what is left grows with each number."""
        bends, by_compliance = self._bends, self._by_compliance
        out, C, P = np.zeros(bends.n_numbers), bends.compliance, len(bends.basis)
        out[:P] = np.einsum("kphi,khi->p", self._inertia, self._by_inertia, optimize=True)
        of_parts = C * by_compliance
        out[P : P + len(C)] = 0.5 * (of_parts.sum(axis=0) + of_parts.sum(axis=1))
        root = np.sqrt(np.diag(C))
        for number, (i, j) in enumerate(bends.crosses, bends.of_crosses.start):
            out[number] = root[i] * root[j] * (by_compliance[i, j] + by_compliance[j, i])
        out[bends.of_dampers] = (bends.damped * self._by_damper).sum(axis=0) * bends.later
        if bends.base:
            by_own = self._by_own[bends.of_base, bends.of_base]
            out[bends.of_inertia] = np.einsum("nij,ij->n", bends.inertia_by_numbers, by_own)
        # Numbers that move nothing are held, as the scale of what all parts yield is.
        return np.where(np.isin(np.arange(len(out)), bends.number), out, 0.0)

    def _moved(self, settled: Complex) -> Complex:
        """(k, H, D) what joints and hinges do where parts do (k, R, D)."""
        return np.asarray(np.eye(len(self._moves))[:, : self._n] + self._moves @ settled)

    def _torques(self, w: float, settled: Complex) -> Complex:
        """(k, R, D) what loads springs there: links, the base's own inertia, and its dampers."""
        base, late = self._bends.of_base, self._bends.late
        out = self._moves.T @ self._of_loads @ self._moved(settled) + self._own @ settled
        out = np.asarray(w**2 * out)
        out[:, base] -= 1j * w * late[base, None] * settled[:, base]
        return out


def _felt(tree: KinematicTree, state: State, q: F64, *, base: bool) -> F64:
    """(k, U, 3, H) what SUs feel per unit of acceleration of joints and hinges, at q (k, D).

    It is in the base's frame, from Pinocchio's frames of joints: with directions, which
    :func:`~skin2urdf.estimation.trajectory.kinematics.felt_of_joints` leaves out.
    """
    D = tree.n_joints
    skeleton = Skeleton(tree, D + np.arange(N_HINGES if base else 0))
    built = PinocchioTree(skeleton.tree)
    built.write_joints(skeleton.placements(state.T_parent_joint))
    still = np.zeros((len(q), len(skeleton.hinges)))
    R, p = built.joint_frames(np.ascontiguousarray(np.hstack([still, q])))
    out = np.zeros((len(q), tree.n_sus, 3, D + len(skeleton.hinges)))
    T_joint_su = skeleton.su_placements(state.T_joint_su)
    for u, joint in enumerate(skeleton.tree.su_joint.tolist()):
        if joint < 0:
            continue
        at = p[:, joint] + R[:, joint] @ T_joint_su[u, :3, 3]
        for j in skeleton.tree.chain(joint):
            axis = R[:, j, :, 2]
            turns = not skeleton.tree.prismatic[j]
            out[:, u, :, skeleton.numbers[j]] = np.cross(axis, at - p[:, j]) if turns else axis
    return out


def _per_parameter(
    tree: KinematicTree, log: Trajectory, state: State, q: F64, *, base: bool
) -> F64:
    """(k, H, H, 10 D) torques by a unit of acceleration of each, at rest and without gravity.

    Of each inertial parameter of the links, in the order of Pinocchio's regressors.
    """
    k, H = len(q), tree.n_joints + N_HINGES * base
    at = np.repeat(np.hstack([q, np.zeros((k, H - q.shape[1]))]), H, axis=0)
    moved = replace(log, q=at, qd=np.zeros_like(at), qdd=np.tile(np.eye(H), (k, 1)))
    of_all = [Y for Y, _ in regressors(tree, state, 0, 0.0, moved, base=base)]
    return np.concatenate(of_all)[:, :H].reshape(k, H, H, -1)
