"""The cost a second time, from CasADi: chi-squared, its Gauss-Newton system, and its bending.

What an SU reads, as a function of everything that touches it, is written with the symbolic twin
(:mod:`skin2urdf.model.symbolic`) and differentiated by CasADi: one set of functions per kind of
chain, mapped over all poses and all SUs of that kind. The readings are linear in the features, so
whitening stays outside of the expressions, and the system keeps its arrow form: time grows
linearly with the number of SUs.

The chi-squared is that of :class:`skin2urdf.estimation.problem.cost.Cost`; kinematics and
derivatives share no code with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.cost import Cost, NormalEquations
from skin2urdf.estimation.problem.state import (
    JOINT_COORDINATES,
    N_INTRINSIC,
    N_JOINT,
    N_PLACEMENT,
    N_SU,
    State,
    Step,
)
from skin2urdf.geometry.so3 import cross
from skin2urdf.model.symbolic import (
    chain_kinematics,
    composed,
    moved_placements,
    stacked_placements,
)

_N_TURN = 2


@dataclass(frozen=True, eq=False)
class ReadingFunctions:
    """CasADi functions of one SU in one pose, for one kind of chain of n joints.

    Inputs are vectors: positions (n), placements (12 (n + 1)), gravity_up (3) [m/s^2], bias (3),
    shape (6). Coordinates z (n N_JOINT + 2 + 15): the joints, the turn of gravity about base x and
    y, the SU; all as in :class:`skin2urdf.estimation.problem.state.Step`.

    Attributes:
        readings: the read coefficients (3 m), one row of a feature block after the other.
        jacobian: their derivatives in z at zero, one reading (of z's length) after the other.
        bending: with a further input z, their second derivative (3 m) in e at zero along e z,
            where placements move along screws ``T exp(e z)``.
    """

    readings: Any
    jacobian: Any
    bending: Any


@lru_cache(maxsize=64)
def reading_functions(prismatic: tuple[bool, ...]) -> ReadingFunctions:
    """The functions for a chain of these joint types, from the RS outwards."""
    import casadi as ca

    n = len(prismatic)
    q, T, up = ca.SX.sym("q", n), ca.SX.sym("T", 12 * (n + 1)), ca.SX.sym("up", 3)
    bias, shape = ca.SX.sym("bias", 3), ca.SX.sym("shape", 6)
    z, e = ca.SX.sym("z", n * N_JOINT + _N_TURN + N_SU), ca.SX.sym("e")
    inputs = [q, T, up, bias, shape]

    def readings(z: Any, motion: Callable[[Any, Any], Any]) -> Any:
        joints, turn, su = ca.vertsplit(z, [0, n * N_JOINT, n * N_JOINT + _N_TURN, z.numel()])
        x = ca.SX(6, n + 1)
        x[list(JOINT_COORDINATES), :n] = ca.reshape(joints, N_JOINT, n)
        x[:, n] = su[:N_PLACEMENT]
        chain = chain_kinematics(prismatic, q, motion(ca.reshape(T, 3, 4 * (n + 1)), x))
        M = ca.SX.eye(3) + _symmetric(shape + su[N_PLACEMENT + 3 :])
        read = M @ chain.features(_turned(up, turn))
        read[:, 0] += bias + su[N_PLACEMENT : N_PLACEMENT + 3]
        return ca.vec(read)

    at_rest = readings(ca.SX(z.numel(), 1), moved_placements)
    jacobian = ca.jacobian(readings(z, moved_placements), z).T
    jacobian = ca.substitute(ca.vec(jacobian), z, ca.DM.zeros(z.shape))
    along = readings(e * z, _screw_placements)
    bending = ca.substitute(ca.jacobian(ca.jacobian(along, e), e), e, 0)
    return ReadingFunctions(
        ca.Function("readings", inputs, [ca.densify(at_rest)]),
        ca.Function("jacobian", inputs, [ca.densify(jacobian)]),
        ca.Function("bending", [*inputs, z], [ca.densify(bending)]),
    )


def _symmetric(s: Any) -> Any:
    import casadi as ca

    rows = ((s[0], s[5], s[4]), (s[5], s[1], s[3]), (s[4], s[3], s[2]))
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))


def _turned(up: Any, turn: Any) -> Any:
    """``up`` turned about base x and y, to the second order that derivatives at zero see."""
    import casadi as ca

    w = ca.vertcat(turn, 0)
    first = ca.cross(w, up)
    return up + first + ca.cross(w, first) / 2


def _screw_placements(placements: Any, x: Any) -> Any:
    """Placements moved along screws, to the second order that derivatives at zero see."""
    import casadi as ca

    moved = []
    for T, x_k in zip(ca.horzsplit(placements, 4), ca.horzsplit(x), strict=True):
        t, W = x_k[:3], ca.skew(x_k[3:])
        half = ca.SX.eye(3) + W / 2
        moved.append(composed(T, ca.SX.eye(3) + W @ half, half @ t))
    return ca.horzcat(*moved)


@dataclass(frozen=True, eq=False)
class _Group:
    """SUs whose chains have the same joint types.

    Attributes:
        sus: (K,) their indices.
        chains: (K, n) joints of their chains.
        columns: (K, c) indices of the joint and log coordinates that touch them.
        functions: CasADi's functions of their kind of chain.
        W: (P, K, m, m) square root of the information, rows of the group's chains only.
        target: (P, K, m, 3) whitened measurements [m/s^2].
        weight: (P, K, 1, 3) one over the noise; 0 where there is no data.
    """

    sus: Int
    chains: Int
    columns: Int
    functions: ReadingFunctions
    W: F64
    target: F64
    weight: F64


class SymbolicCost:
    """Chi-squared of states and its quadratic models, for the problem of a :class:`Cost`."""

    def __init__(self, cost: Cost) -> None:
        self._cost = cost
        deviations = cost.priors.deviations
        self._prior = np.divide(1.0, deviations, out=np.zeros(N_INTRINSIC), where=deviations > 0)
        self._per_offset = 1 / cost.priors.position
        self._groups = tuple(_groups(cost))

    def chi2(self, state: State) -> float:
        """Sum of squared whitened residuals and priors; infinite where not a number."""
        total = float(sum(np.vdot(r, r) for r in self._prior_residuals(state)))
        for group in self._groups:
            residual = self._residual(group, state)
            total += float(np.vdot(residual, residual))
        return total if np.isfinite(total) else np.inf

    def linearised(self, state: State) -> Linearisation:
        """Gauss-Newton's model at a state."""
        jacobians = tuple(self._jacobian(group, state) for group in self._groups)
        residuals = [self._residual(group, state) for group in self._groups]
        gradient = self._pulled_back(jacobians, residuals)
        sensors, joints, sus = self._prior_residuals(state)
        gradient.sus[:, N_PLACEMENT:] += sensors * self._prior
        gradient.sus[:, :3] += _into(state.T_joint_su, sus) * self._per_offset
        gradient.joints[:, :2] += _into(state.T_parent_joint, joints)[:, :2] * self._per_offset
        equations = self._normal_equations(jacobians)
        return Linearisation(self, state, equations, gradient, jacobians)

    def bending(self, state: State, jacobians: tuple[F64, ...], step: Step) -> Step:
        """See :meth:`Linearisation.bending`."""
        turn = np.concatenate([np.zeros((1, _N_TURN)), step.logs])[self._cost.blocks.log]
        bent = []
        for group in self._groups:
            joints = step.joints[group.chains].reshape(1, len(group.sus), -1)
            z = _broadcast(group, joints, turn[:, None], step.sus[group.sus])
            y = self._evaluate(group, group.functions.bending, state, z)
            bent.append(group.W @ y.reshape(group.target.shape) * group.weight)
        total = self._pulled_back(jacobians, bent)
        # A screw bends the way of an SU's origin; a joint's origin it bends along its axis only.
        total.sus[:, :3] += cross(step.sus[:, 3:6], step.sus[:, :3]) * self._per_offset**2
        return total

    def _residual(self, group: _Group, state: State) -> F64:
        """(P, K, m, 3) whitened residuals."""
        y = self._evaluate(group, group.functions.readings, state).reshape(group.target.shape)
        return (group.W @ y - group.target) * group.weight

    def _prior_residuals(self, state: State) -> tuple[F64, F64, F64]:
        """Sensors (U, 9), offsets of joints (D, 3) and of SUs (U, 3) over their deviations."""
        return (
            np.concatenate([state.bias, state.shape], axis=1) * self._prior,
            state.T_parent_joint[:, :3, 3] * self._per_offset,
            state.T_joint_su[:, :3, 3] * self._per_offset,
        )

    def _jacobian(self, group: _Group, state: State) -> F64:
        """(P, K, 3 m, Z) derivatives of the whitened residuals in the functions' coordinates."""
        P, K, m = group.target.shape[:3]
        raw = self._evaluate(group, group.functions.jacobian, state).reshape(P, K, m, 3, -1)
        white = group.W @ (raw * group.weight[..., None]).reshape(P, K, m, -1)
        return white.reshape(P, K, 3 * m, -1)

    def _pulled_back(self, jacobians: tuple[F64, ...], residuals: list[F64]) -> Step:
        """``J^T r`` over all groups."""
        zero = self._cost.zero_step()
        joint, sus = np.zeros(zero.joints.size + zero.logs.size), zero.sus
        for group, J, r in zip(self._groups, jacobians, residuals, strict=True):
            part = np.zeros((len(group.sus), group.columns.shape[1] + N_SU))
            by_pose = (r.reshape(*J.shape[:2], 1, -1) @ J)[:, :, 0]
            for poses, local, to in self._logs(group):
                part[:, to] += by_pose[poses][..., local].sum(axis=0)
            c = group.columns.shape[1]
            np.add.at(joint, group.columns, part[:, :c])
            sus[group.sus] = part[:, c:]
        return zero.like(np.concatenate([joint, sus.ravel()]))

    def _normal_equations(self, jacobians: tuple[F64, ...]) -> NormalEquations:
        zero = self._cost.zero_step()
        n_joint, U = zero.joints.size + zero.logs.size, len(zero.sus)
        C = max((group.columns.shape[1] for group in self._groups), default=0)
        H, su = np.zeros((n_joint, n_joint)), np.zeros((U, N_SU, N_SU))
        mixed, columns = np.zeros((U, N_SU, C)), np.zeros((U, C), dtype=np.int64)
        for group, J in zip(self._groups, jacobians, strict=True):
            K, n = group.columns.shape
            information = np.zeros((K, n + N_SU, n + N_SU))
            for poses, local, to in self._logs(group):
                J_log = np.swapaxes(J[poses], 0, 1).reshape(K, -1, J.shape[-1])[..., local]
                information[:, to[:, None], to] += np.swapaxes(J_log, 1, 2) @ J_log
            c = group.columns
            np.add.at(H, (c[:, :, None], c[:, None, :]), information[:, :n, :n])
            su[group.sus] = information[:, n:, n:]
            mixed[group.sus, :, :n], columns[group.sus, :n] = information[:, n:, :n], c
        offsets, sensors = np.arange(3), np.arange(N_PLACEMENT, N_SU)
        su[:, offsets, offsets] += self._per_offset**2
        su[:, sensors, sensors] += self._prior**2
        across = np.arange(zero.joints.size).reshape(-1, N_JOINT)[:, :2]
        H[across, across] += self._per_offset**2
        return NormalEquations(joint=H, su=su, mixed=mixed, columns=columns)

    def _logs(self, group: _Group) -> Iterator[tuple[Bool, Int, Int]]:
        """Poses of each log, the functions' coordinates they see, and which of a group's these are.

        Gravity of the first log is fixed; a group's coordinates are its columns, then the SU's.
        """
        c, n_logs = group.columns.shape[1], self._cost.n_logs
        n = c - _N_TURN * (n_logs - 1)
        joints, sus = np.arange(n), np.arange(N_SU)
        for log in range(n_logs):
            turn = np.arange(_N_TURN if log else 0)
            local = np.concatenate([joints, n + turn, n + _N_TURN + sus])
            to = np.concatenate([joints, n + _N_TURN * (log - 1) + turn, c + sus])
            yield np.asarray(self._cost.blocks.log == log), local, to

    def _evaluate(self, group: _Group, function: Any, state: State, *more: F64) -> F64:
        """(P K, N) outputs of a function in all poses (slow) and SUs (fast) of a group."""
        blocks = self._cost.blocks
        T = np.concatenate(
            [state.T_parent_joint[group.chains], state.T_joint_su[group.sus, None]], axis=1
        )
        inputs = (
            blocks.q[:, group.chains],
            stacked_placements(T),
            (state.up * self._cost.priors.gravity)[blocks.log, None],
            state.bias[group.sus],
            state.shape[group.sus],
            *more,
        )
        N = group.W.shape[0] * group.W.shape[1]
        columns = [_broadcast(group, x).reshape(N, x.shape[-1]).T for x in inputs]
        return np.asarray(function.map(N)(*columns).full().T)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Gauss-Newton's model of chi2 / 2 at a state.

    Attributes:
        cost: the cost it belongs to.
        state: where.
        equations: the system in arrow form.
        gradient: its gradient.
    """

    cost: SymbolicCost
    state: State
    equations: NormalEquations
    gradient: Step
    _jacobians: tuple[F64, ...]

    def bending(self, step: Step) -> Step:
        """``J^T r''`` with r'' the second derivative of the residuals along a step.

        Placements move along screws.
        """
        return self.cost.bending(self.state, self._jacobians, step)


def _into(T: F64, v: F64) -> F64:
    """Vectors v (N, 3) of the outer frames, seen in the frames T (N, 4, 4) lead to."""
    return np.asarray((v[:, None] @ T[:, :3, :3])[:, 0])


def _broadcast(group: _Group, *parts: F64) -> F64:
    """(P, K, N) parts of shapes broadcastable to (P, K, .) side by side."""
    P, K = group.W.shape[:2]
    return np.concatenate([np.broadcast_to(x, (P, K, x.shape[-1])) for x in parts], axis=-1)


def _groups(cost: Cost) -> Iterator[_Group]:
    """SUs of one kind of chain together."""
    blocks, tree = cost.blocks, cost.tree
    weight = np.divide(1.0, blocks.noise)[:, :, None]
    L = blocks.chains.joint.shape[1]
    logs = tree.n_joints * N_JOINT + np.arange(_N_TURN * (cost.n_logs - 1))
    chains = [tree.chain(int(joint)) for joint in tree.su_joint]
    kinds = [tuple(bool(tree.prismatic[j]) for j in chain) for chain in chains]
    for kind in sorted(set(kinds)):
        sus = np.array([u for u, other in enumerate(kinds) if other == kind], dtype=np.int64)
        K, n = len(sus), len(kind)
        joints = np.array([chains[u] for u in sus], dtype=np.int64).reshape(K, n)
        own = joints[..., None] * N_JOINT + np.arange(N_JOINT)
        rows = np.r_[0, 1 : 1 + n, 1 + L : 1 + L + n]
        yield _Group(
            sus=sus,
            chains=joints,
            columns=np.concatenate([own.reshape(K, -1), np.tile(logs, (K, 1))], axis=1),
            functions=reading_functions(kind),
            W=blocks.W[:, sus[:, None, None], rows[:, None], rows],
            target=blocks.target[:, sus[:, None], rows],
            weight=weight[:, sus],
        )
