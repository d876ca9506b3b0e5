"""What loads do along a log, and what the deflections that they make do to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.bending import PAIRS, TENSOR, Bending
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, shift, turn
from skin2urdf.estimation.trajectory.springs import Springs
from skin2urdf.estimation.trajectory.torques import bodies, joint_inertias, loads_of, regressors
from skin2urdf.geometry.so3 import skew
from skin2urdf.signals.filters import (
    first_derivative,
    second_derivative,
)
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

if TYPE_CHECKING:
    import pinocchio as pin

_LATE = 2e-3
"""Time by which dampers make deflections late [s]: a twentieth of the critical damping at 8 Hz."""
_SLOWLY = 2
"""Samples from one at which inertias are worked out to the next: some 30 ms."""
_TOGETHER = 16
"""Numbers whose motions are worked out at once, so that what is copied for them stays small."""
_FAR = 3.0
"""Logarithm that it does not reach: nothing is late by more than a sixth of a swing at 4 Hz."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """What loads do along a log, and what these deflections do to the loads.

    Attributes:
        tree: the structure.
        state: placements, and gravity's direction per log.
        g: number of the log.
        gravity: its magnitude [m/s^2].
        log: as the encoders have it.
        found: what yields, about its numbers.
        within: samples that are compared; what a log begins and ends with swings as nobody knows.
    """

    tree: KinematicTree
    state: State
    g: int
    gravity: float
    log: Trajectory
    found: Bending
    within: slice

    def nearer(self, beyond: F64, springs: Springs) -> tuple[F64, float]:
        """(N, D + 6) deflections after a step of Newton's method, and the length of the step.

        Args:
            beyond: (N, D + 6) where it begins [rad or m].
            springs: how deflections follow their loads there.
        """
        parts = self.found.parts
        bent = self._bent(beyond, self._torques(beyond)) - self._absent
        lacking = self.log.smooth(bent - beyond[:, parts])
        # What springs ring with beyond the low-pass, none would take away again.
        step = self.log.smooth(springs.bent(lacking[..., None])[..., 0])
        nearer = (beyond[:, parts] + step) @ self._moves.T
        largest = float(np.abs(nearer[self.within, parts]).max(initial=1e-300))
        return nearer, float(np.abs(step[self.within]).max(initial=0.0)) / largest

    def motions(self, beyond: F64, springs: Springs) -> F64:
        """(N, R or R + 3, S) what parts do, and the base's shifts, per unit of each number.

        Where nothing has a load yet, no number but the P loads moves anything, and S is P.

        Args:
            beyond: (N, D + 6) deflections about which that is [rad or m].
            springs: how deflections follow their loads there.
        """
        found = self.found
        out = self._loaded_by_loads(beyond) if self._at_rest else self._loaded(beyond)
        out *= self._there[:, None, None]
        for first in range(0, out.shape[2], _TOGETHER):
            some = slice(first, first + _TOGETHER)
            out[..., some] = self.log.smooth(springs.bent(out[..., some]))
        if not found.base:
            return out
        shifts = np.einsum("ji,njs->nis", skew(found.lever), out[:, -3:])
        if not self._at_rest:
            for i in range(3):
                shifts[:, :, i - 3] += beyond[:, self._turns] @ skew(np.eye(3)[i])
        return np.concatenate([out, shifts], axis=1)

    @property
    def _at_rest(self) -> bool:
        """Whether nothing has a load yet, so that nothing bends and no inertia is known."""
        return not self.found.origin.any()

    def _loaded_by_loads(self, beyond: F64) -> F64:
        """(N, R, P) what loads the springs, per unit of each load."""
        tau, _ = self._under(beyond, self.found.basis)
        return np.asarray(np.matmul(-self.found.compliance, tau))

    def _loaded(self, beyond: F64) -> F64:
        """(N, R, S) what loads the springs, per unit of each number, where they are bent."""
        found, C = self.found, self.found.compliance
        P, R, S = len(found.basis), len(found.parts), found.n_numbers
        tau, force = self._under(beyond, found.basis)
        out = np.zeros((len(beyond), R, S))
        np.matmul(-C, tau, out=out[..., :P])
        robot, force = (each @ found.origin[:P] for each in (tau, force))
        rates = first_derivative(beyond[:, found.parts], self.log.rate)
        # The base's dampers and its own inertia load its springs as the robot does.
        late, a = self._late, second_derivative(beyond[:, found.parts], self.log.rate)
        tau = robot + a @ self._own_inertia()
        tau[:, self._of_base] += rates[:, self._of_base] * late[self._of_base]
        bent = -tau @ C
        r = np.arange(R)
        out[:, r, P + r] = 0.5 * bent
        out[:, :, P : P + R] -= 0.5 * np.einsum("ri,ni->nri", C, tau)
        first = self._of_damping.start
        sooner = 1 - np.tanh(found.origin[self._of_damping] / _FAR) ** 2
        out[:, :, first : first + R] = -np.einsum(
            "ri,ni->nri", self._damped, rates * (late * sooner)
        )
        if found.base:
            self._write_base(out, tau, a)
            for i in range(3):
                out[:, :, S - 3 + i] = -self._deeper(i, robot, force, beyond) @ C
        return out

    def springs(self, beyond: F64) -> Springs:
        """How deflections follow their loads along a motion.

        Args:
            beyond: (N, D + 6) of the links beyond the encoders [rad or m].
        """
        found, size = self.found, len(beyond)
        damped = self._damped * self._late
        if self._at_rest:
            none = np.zeros((1, *found.compliance.shape))
            return Springs(found.compliance, none, damped, self.log.rate, size)
        thin = slice(None, None, _SLOWLY)
        moved = self._moved(beyond)
        moved = replace(moved, q=moved.q[thin], qd=moved.qd[thin], qdd=moved.qdd[thin])
        q = moved.q
        of_all = joint_inertias(self.tree, self.state, moved, self._parameters, base=found.base)
        moves = self._moves[: of_all.shape[1]]
        inertia = moves.T @ of_all @ moves + self._own_inertia()
        at = np.minimum(np.arange(size) / _SLOWLY, len(q) - 1)
        low = at.astype(np.int64)
        high, part = np.minimum(low + 1, len(q) - 1), (at - low)[:, None, None]
        inertia = (1 - part) * inertia[low] + part * inertia[high]
        return Springs(found.compliance, inertia, damped, self.log.rate)

    @cached_property
    def _there(self) -> F64:
        """(N,) share of the loads that is there: before and behind what is compared they fade.

        Differences and filters lack samples at the ends; what resonates would swing by that.
        """
        n, within = len(self.log.q), self.within
        at = [0, within.start, within.stop - 1, n - 1]
        return np.asarray(np.sin(np.pi / 2 * np.interp(np.arange(n), at, [0, 1, 1, 0])) ** 2)

    @cached_property
    def _absent(self) -> F64:
        """(N, R) deflections by the share that is not."""
        none = np.zeros((len(self.log.q), self.tree.n_joints + N_HINGES))
        return np.asarray((1 - self._there)[:, None] * self._bent(none, self._torques(none)))

    @property
    def _of_damping(self) -> slice:
        """Numbers by which parts are late."""
        P, R = len(self.found.basis), len(self.found.parts)
        first = P + R + 3 * self.found.base
        return slice(first, first + R)

    @property
    def _late(self) -> F64:
        """(R,) times by which dampers make parts late [s]."""
        found = self.found.origin[self._of_damping] / _FAR
        return np.asarray(_LATE * np.exp(_FAR * np.tanh(found)))

    @property
    def _damped(self) -> F64:
        """(R, R) by how much each damper, of a spring of unit stiffness, makes all parts late."""
        C, of_base = np.eye(len(self.found.parts)), self._of_base
        C[of_base, of_base] = self.found.compliance[of_base, of_base]
        return C

    @property
    def _of_base(self) -> slice:
        """The parts that are the base's turns."""
        R = len(self.found.parts)
        return slice(R - 3 * self.found.base, R)

    @property
    def _moves(self) -> F64:
        """(D + 6, R) what joints and hinges do per unit of each part: a turned base shifts, too."""
        tree, parts = self.tree, self.found.parts
        out = np.zeros((tree.n_joints + N_HINGES, len(parts)))
        out[parts, np.arange(len(parts))] = 1.0
        if self.found.base:
            out[self._shifts, self._of_base] = skew(self.found.lever).T
        return out

    @property
    def _shifts(self) -> slice:
        """Columns of the base's shifts."""
        return slice(shift(self.tree, 0), turn(self.tree, 0))

    @property
    def _turns(self) -> slice:
        """Columns of the base's turns."""
        return slice(turn(self.tree, 0), turn(self.tree, 0) + 3)

    def _moved(self, beyond: F64) -> Trajectory:
        """The log with the motion of the links."""
        log, n = self.log, self.tree.n_joints + N_HINGES * self.found.base
        e = beyond[:, :n]
        still = np.zeros((len(e), n - log.q.shape[1]))
        return replace(
            log,
            q=np.hstack([log.q, still]) + e,
            qd=np.hstack([log.qd, still]) + first_derivative(e, log.rate),
            qdd=np.hstack([log.qdd, still]) + second_derivative(e, log.rate),
        )

    @property
    def _parameters(self) -> F64:
        """(10 D,) inertial parameters of what joints carry, as far as deflections tell."""
        found = self.found
        return np.asarray(found.origin[: len(found.basis)] @ found.basis)

    @cached_property
    def _bodies(self) -> list[pin.Inertia]:
        """(D,) what joints carry."""
        return bodies(self._parameters)

    def _torques(self, beyond: F64) -> F64:
        """(N, R) torques of parts by these."""
        moved, base = self._moved(beyond), self.found.base
        tau = loads_of(self.tree, self.state, self.g, self.gravity, moved, self._bodies, base=base)
        return np.asarray(tau @ self._moves[: tau.shape[1]])

    def _under(self, beyond: F64, basis: F64) -> tuple[F64, F64]:
        """Torques of parts (N, R, P) and forces on the base (N, 3, P) per unit of each load."""
        tree, found, moved = self.tree, self.found, self._moved(beyond)
        torques = np.empty((len(moved.q), len(found.parts), len(basis)))
        forces = np.zeros((len(moved.q), 3, len(basis)))
        for Y, at in regressors(tree, self.state, self.g, self.gravity, moved, base=found.base):
            torques[at] = self._moves[: Y.shape[1]].T @ Y @ basis.T
            if found.base:
                forces[at] = Y[:, self._shifts] @ basis.T
        return torques, forces

    def _bent(self, beyond: F64, tau: F64) -> F64:
        """(N, R) deflections by loads, where they are late by others.

        Args:
            beyond: (N, D + 6) deflections that the loads go with [rad or m].
            tau: (N, R) torques.
        """
        parts, rate = self.found.parts, self.log.rate
        rates, a = (of(beyond[:, parts], rate) for of in (first_derivative, second_derivative))
        by_springs = (tau + a @ self._own_inertia()) @ self.found.compliance
        return np.asarray(-by_springs - rates * self._late @ self._damped)

    def _own_inertia(self) -> F64:
        """(R, R) inertia of the base itself, of which the numbers are over its stiffness."""
        found, R = self.found, len(self.found.parts)
        out = np.zeros((R, R))
        if found.base:
            tensor = self._of_damping.stop + np.arange(len(TENSOR))
            for n, (i, j) in zip(tensor, TENSOR, strict=True):
                i, j = R - 3 + i, R - 3 + j
                out[i, j] = out[j, i] = found.origin[n]
        return out

    def _write_base(self, out: F64, tau: F64, a: F64) -> None:
        """Write what the base's cross compliances and its own inertia do into loads.

        Args:
            out: (N, R, S) the loads.
            tau: (N, R) what loads the springs.
            a: (N, R) the parts' accelerations.
        """
        found, C = self.found, self.found.compliance
        P, R = len(found.basis), len(found.parts)
        root = np.sqrt(np.diag(C)[-3:])
        for n, (i, j) in enumerate(PAIRS):
            for one, other in ((i, j), (j, i)):
                out[:, R - 3 + one, P + R + n] = -root[one] * root[other] * tau[:, R - 3 + other]
        first = self._of_damping.stop
        for n, (i, j) in enumerate(TENSOR):
            for one, other in {(i, j), (j, i)}:
                out[:, :, first + n] -= a[:, R - 3 + other, None] * C[:, R - 3 + one]

    def _deeper(self, axis: int, robot: F64, force: F64, beyond: F64) -> F64:
        """(N, R) loads per metre that the base turns about a point further off along an axis.

        The lever of the forces is longer, and the frame shifts more, which moves all links.

        Args:
            axis: x, y or z.
            robot: (N, R) what the robot loads the springs with.
            force: (N, 3) what it pushes the frame with.
            beyond: (N, D + 6) of the links beyond the encoders.
        """
        unit = skew(np.eye(3)[axis])
        shifted = np.array(beyond)
        shifted[:, self._shifts] += beyond[:, self._turns] @ unit
        loads = self._torques(shifted) - robot
        loads[:, self._of_base] += force @ unit.T
        return np.asarray(loads)
