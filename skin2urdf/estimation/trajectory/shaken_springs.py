"""What springs make of the noise of encoders: what is bent by loads swings along with it.

Loads go with accelerations, and so with their noise. Where joints and a base of compliance C carry
links of inertia M, and dampers make them late by L, noise n of joints' accelerations moves them by

    e = (1 + i w L - w^2 C M)^-1 w^2 C M n

besides: near a resonance more than the joints do, and the other way round by loads that weigh less
than nothing. Least squares would ask for these, as for a low-pass of all readings.
"""

from __future__ import annotations

from collections.abc import Iterator
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

_PLACES = 32
"""Samples at most at which springs are asked: what they make of noise changes with the pose, and is
summed up over all of a log."""
_OF_ALL = 20_000
"""The same times SUs: so many take 30 MB."""
FREQUENCIES = 24
"""Frequencies at most at which they are: a fifth of a hertz apart, and a resonance is wider."""


@dataclass(frozen=True, eq=False)
class ShakenSprings(Record):
    """What springs make of the noise of encoders along a log.

    Attributes:
        w: (F,) angular frequencies [rad/s].
        felt: (k, U, H, H) products of what SUs feel of accelerations of D joints, and hinges of the
            base, at some samples.
        weights: (k, U) information of these, and
        shaken: (k, D) share of the noise that is in them.
        inertia: (k, P, H, H) of joints and hinges, per load.
    """

    w: F64
    felt: F64
    weights: F64
    shaken: F64
    inertia: F64

    @staticmethod
    def of(
        bends: Bending, tree: KinematicTree, log: Trajectory, state: State, weights: F64, w: F64
    ) -> ShakenSprings:
        """Of a log at placements.

        Args:
            bends: what yields.
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
        felt = _accelerations(tree, state, q, base=bends.base)
        square = np.einsum("kuch,kuci->kuhi", felt, felt, optimize=True)
        inertia = _inertias(bends, tree, log, state, q)
        return ShakenSprings(w, square, weights[some], log.shaken[some], inertia)

    def counts(self, bends: Bending) -> F64:
        """(F, U, D) by how much chi-squared grows with a mean square of each encoder's noise."""
        D = self.shaken.shape[1]
        out = np.empty((len(self.w), self.felt.shape[1], D))
        for f, (swung, _, _) in enumerate(self._swung(bends)):
            square = np.einsum("khd,kuhi,kid->kud", swung.conj(), self.felt, swung, optimize=True)
            square = square.real
            out[f] = np.einsum("ku,kd,kud->ud", self.weights, self.shaken, square, optimize=True)
        return out

    @property
    def of_rigid(self) -> F64:
        """(U, D) the same of a robot on no springs."""
        n = self.shaken.shape[1]
        square = np.diagonal(self.felt[:, :, :n, :n], axis1=2, axis2=3)
        of_all = np.einsum("ku,kd,kud->ud", self.weights, self.shaken, square, optimize=True)
        return np.asarray(of_all)

    def pull(self, bends: Bending, noise: F64, share: F64) -> F64:
        """(S,) half of by how much what is left of noise grows with each number.

        Args:
            bends: what yields, about its numbers.
            noise: (F, D) mean squares of each encoder's noise.
            share: (F, U) by how much of what SUs feel of it counts.
        """
        C, moves, own = bends.compliance, self._moves(bends), bends.inertia_of_parts
        base, of_loads = bends.of_base, self._of_loads(bends)
        by_inertia = np.zeros_like(of_loads)
        by_compliance, by_own, by_damper = np.zeros((3, len(C), len(C)))
        for f, (swung, parts, turned_round) in enumerate(self._swung(bends)):
            w = self.w[f]
            weighed = np.einsum("u,ku,kuhi->khi", share[f], self.weights, self.felt, optimize=True)
            heard = (noise[f] * self.shaken)[:, :, None] * swung.conj().swapaxes(1, 2)
            back = heard @ weighed @ moves @ turned_round
            torques = w**2 * (moves.T @ of_loads @ swung + own @ parts)
            torques[:, base] -= 1j * w * bends.late[base, None] * parts[:, base]
            by_compliance += (torques @ back).sum(axis=0).real.T
            by_own += w**2 * ((parts @ back).sum(axis=0) @ C).real.T
            by_damper += (-1j * w * (parts @ back).sum(axis=0)).real.T
            by_inertia += w**2 * (swung @ back @ C @ moves.T).real.swapaxes(1, 2)
        out = np.zeros(bends.n_numbers)
        P = len(bends.basis)
        out[:P] = np.einsum("kphi,khi->p", self.inertia, by_inertia, optimize=True)
        of_parts = C * by_compliance
        out[P : P + len(C)] = 0.5 * (of_parts.sum(axis=0) + of_parts.sum(axis=1))
        root = np.sqrt(np.diag(C))
        for at, (i, j) in enumerate(bends.crosses, bends.of_crosses.start):
            out[at] = root[i] * root[j] * (by_compliance[i, j] + by_compliance[j, i])
        out[bends.of_dampers] = (bends.damped * by_damper).sum(axis=0) * bends.later
        if bends.base:
            by_numbers = bends.inertia_by_numbers
            out[bends.of_inertia] = np.einsum("nij,ij->n", by_numbers, by_own[base, base])
        return out

    def _swung(self, bends: Bending) -> Iterator[tuple[Complex, Complex, Complex]]:
        """What joints' noise moves, frequency by frequency, per unit of it.

        Yields:
            (k, H, D) what joints and hinges do, and (k, R, D) parts; and (k, R, R) what these do
            per unit of what bends them.
        """
        C, moves, n = bends.compliance, self._moves(bends), self.shaken.shape[1]
        R, H = len(C), self.felt.shape[2]
        of_loads = self._of_loads(bends)
        of_parts = moves.T @ of_loads @ moves + bends.inertia_of_parts
        by_joints, late = moves.T @ of_loads[:, :, :n], bends.damped * bends.late
        for w in self.w:
            turned_round = np.linalg.inv(np.eye(R) + 1j * w * late - w**2 * C @ of_parts)
            parts = w**2 * turned_round @ C @ by_joints
            yield np.eye(H)[:, :n] + moves @ parts, parts, turned_round

    def _of_loads(self, bends: Bending) -> F64:
        """(k, H, H) inertia of the loads."""
        loads = bends.origin[: len(bends.basis)]
        return np.asarray(np.einsum("p,kphi->khi", loads, self.inertia))

    def _moves(self, bends: Bending) -> F64:
        """(H, R) what joints and hinges do per unit of each part."""
        return bends.moves[: self.felt.shape[2]]


def _accelerations(tree: KinematicTree, state: State, q: F64, *, base: bool) -> F64:
    """(k, U, 3, H) what SUs feel of accelerations of joints, and hinges of the base, at rest."""
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
            slides = skeleton.tree.prismatic[j]
            out[:, u, :, skeleton.numbers[j]] = axis if slides else np.cross(axis, at - p[:, j])
    return out


def _inertias(bends: Bending, tree: KinematicTree, log: Trajectory, state: State, q: F64) -> F64:
    """(k, P, H, H) inertia of joints and hinges at positions q (k, D), per load."""
    k, H = len(q), tree.n_joints + N_HINGES * bends.base
    at = np.repeat(np.hstack([q, np.zeros((k, H - q.shape[1]))]), H, axis=0)
    moved = replace(log, q=at, qd=np.zeros_like(at), qdd=np.tile(np.eye(H), (k, 1)))
    of_loads = [
        Y[:, :H] @ bends.basis.T for Y, _ in regressors(tree, state, 0, 0.0, moved, base=bends.base)
    ]
    # Torques (k, along, of, P) by a unit of acceleration of each.
    return np.concatenate(of_loads).reshape(k, H, H, -1).transpose(0, 3, 2, 1)
