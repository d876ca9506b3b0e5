"""What loads do along a log, and what the deflections that they make do to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.bending import Bending
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

_SLOWLY = 2
"""Samples from one at which inertias are worked out to the next: some 30 ms."""
_TOGETHER = 16
"""Numbers whose motions are worked out at once, so that what is copied for them stays small."""


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

    def nearer(self, bent: F64, springs: Springs) -> tuple[F64, float]:
        """(N, R) deflections after a step of Newton's method, and the length of the step.

        Args:
            bent: (N, R) where it begins [rad or m].
            springs: how deflections follow their loads there.
        """
        lacking = self.log.smooth(self._bent(bent, self._torques(bent)) - self._absent - bent)
        # What springs ring with beyond the low-pass, none would take away again.
        step = self.log.smooth(springs.bent(lacking[..., None])[..., 0])
        nearer = bent + step
        largest = float(np.abs(nearer[self.within]).max(initial=1e-300))
        return nearer, float(np.abs(step[self.within]).max(initial=0.0)) / largest

    def motions(self, bent: F64, springs: Springs) -> F64:
        """(N, M, S) what joints and hinges do, those that move, per unit of each number.

        Where nothing has a load yet, no number but the P loads moves anything, and S is P.

        Args:
            bent: (N, R) deflections about which that is [rad or m].
            springs: how deflections follow their loads there.
        """
        found = self.found
        out = self._loaded_by_loads(bent) if self._at_rest else self._loaded(bent)
        out *= self._there[:, None, None]
        for first in range(0, out.shape[2], _TOGETHER):
            some = slice(first, first + _TOGETHER)
            out[..., some] = self.log.smooth(springs.bent(out[..., some]))
        if not found.base:
            return out
        out = found.moves[found.moved_parts] @ out
        if not self._at_rest:
            for i in range(3):
                out[:, -6:-3, i - 3] += bent[:, -3:] @ skew(np.eye(3)[i])
        return out

    @property
    def _at_rest(self) -> bool:
        """Whether nothing has a load yet, so that nothing bends and no inertia is known."""
        return not self.found.origin[: len(self.found.basis)].any()

    def _loaded_by_loads(self, bent: F64) -> F64:
        """(N, R, P) what loads the springs, per unit of each load."""
        tau, _ = self._under(bent, self.found.basis)
        return np.asarray(np.matmul(-self.found.compliance, tau))

    def _loaded(self, bent: F64) -> F64:
        """(N, R, S) what loads the springs, per unit of each number, where they are bent."""
        found, C = self.found, self.found.compliance
        P, R, S = len(found.basis), len(found.parts), found.n_numbers
        tau, force = self._under(bent, found.basis)
        out = np.zeros((len(bent), R, S))
        np.matmul(-C, tau, out=out[..., :P])
        robot, force = (each @ found.origin[:P] for each in (tau, force))
        rates, a = (of(bent, self.log.rate) for of in (first_derivative, second_derivative))
        # The base's dampers and its own inertia load its springs as the robot does.
        late, base = found.late, found.of_base
        tau = robot + a @ found.inertia_of_parts
        tau[:, base] += rates[:, base] * late[base]
        by_springs = -tau @ C
        r = np.arange(R)
        out[:, r, P + r] = 0.5 * by_springs
        out[:, :, P : P + R] -= 0.5 * np.einsum("ri,ni->nri", C, tau)
        out[:, :, found.of_dampers] = -np.einsum("ri,ni->nri", found.damped, rates * found.later)
        if found.base:
            self._write_base(out, tau, a)
            for i in range(3):
                out[:, :, S - 3 + i] = -self._deeper(i, robot, force, bent) @ C
        return out

    def springs(self, bent: F64) -> Springs:
        """How deflections follow their loads along a motion.

        Args:
            bent: (N, R) of the links beyond the encoders [rad or m].
        """
        found, size = self.found, len(bent)
        damped = found.damped * found.late
        if self._at_rest:
            base_alone = found.inertia_of_parts[None]
            return Springs(found.compliance, base_alone, damped, self.log.rate, size)
        thin = slice(None, None, _SLOWLY)
        moved = self._moved(bent @ found.moves.T)
        moved = replace(moved, q=moved.q[thin], qd=moved.qd[thin], qdd=moved.qdd[thin])
        q = moved.q
        of_all = joint_inertias(self.tree, self.state, moved, self._parameters, base=found.base)
        moves = found.moves[: of_all.shape[1]]
        inertia = moves.T @ of_all @ moves + found.inertia_of_parts
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
        none = np.zeros((len(self.log.q), len(self.found.parts)))
        return np.asarray((1 - self._there)[:, None] * self._bent(none, self._torques(none)))

    @property
    def _shifts(self) -> slice:
        """Columns of the base's shifts."""
        return slice(shift(self.tree, 0), turn(self.tree, 0))

    def _moved(self, beyond: F64) -> Trajectory:
        """The log with the motion of the links, which are by (N, D + 6) beyond the encoders."""
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

    def forces(self, bent: F64) -> F64:
        """(N, 3) forces of the loads on the base, along its axes.

        Args:
            bent: (N, R) of the links beyond the encoders [rad or m].
        """
        return self._loads(self._moved(bent @ self.found.moves.T))[:, self._shifts]

    def _torques(self, bent: F64, further: F64 | None = None) -> F64:
        """(N, R) torques of parts by these, where the base's frame is (N, 3) further off [m]."""
        beyond = bent @ self.found.moves.T
        if further is not None:
            beyond[:, self._shifts] += further
        tau = self._loads(self._moved(beyond))
        return np.asarray(tau @ self.found.moves[: tau.shape[1]])

    def _loads(self, moved: Trajectory) -> F64:
        """(N, D or D + 6) loads of joints, and of the base's hinges, by what the joints carry."""
        base = self.found.base
        return loads_of(self.tree, self.state, self.g, self.gravity, moved, self._bodies, base=base)

    def _under(self, bent: F64, basis: F64) -> tuple[F64, F64]:
        """Torques of parts (N, R, P) and forces on the base (N, 3, P) per unit of each load."""
        tree, found = self.tree, self.found
        moves, moved = found.moves, self._moved(bent @ found.moves.T)
        torques = np.empty((len(moved.q), len(found.parts), len(basis)))
        forces = np.zeros((len(moved.q), 3, len(basis)))
        for Y, at in regressors(tree, self.state, self.g, self.gravity, moved, base=found.base):
            torques[at] = moves[: Y.shape[1]].T @ Y @ basis.T
            if found.base:
                forces[at] = Y[:, self._shifts] @ basis.T
        return torques, forces

    def _bent(self, bent: F64, tau: F64) -> F64:
        """(N, R) deflections by loads, where they are late by others.

        Args:
            bent: (N, R) deflections that the loads go with [rad or m].
            tau: (N, R) torques.
        """
        rates, a = (of(bent, self.log.rate) for of in (first_derivative, second_derivative))
        found = self.found
        by_springs = (tau + a @ found.inertia_of_parts) @ found.compliance
        return np.asarray(-by_springs - rates * found.late @ found.damped)

    def _write_base(self, out: F64, tau: F64, a: F64) -> None:
        """Write what the base's cross compliances and its own inertia do into loads.

        Args:
            out: (N, R, S) the loads.
            tau: (N, R) what loads the springs.
            a: (N, R) the parts' accelerations.
        """
        found, base = self.found, self.found.of_base
        C, root = found.compliance[:, base], np.sqrt(np.diag(found.compliance))
        for n, (i, j) in enumerate(found.crosses, found.of_crosses.start):
            for one, other in ((i, j), (j, i)):
                out[:, one, n] = -root[one] * root[other] * tau[:, other]
        by_inertia = np.einsum(
            "nj,kji,ri->nrk", a[:, base], found.inertia_by_numbers, C, optimize=True
        )
        out[:, :, found.of_inertia] = -by_inertia

    def _deeper(self, axis: int, robot: F64, force: F64, bent: F64) -> F64:
        """(N, R) loads per metre that the base turns about a point further off along an axis.

        The lever of the forces is longer, and the frame shifts more, which moves all links.

        Args:
            axis: x, y or z.
            robot: (N, R) what the robot loads the springs with.
            force: (N, 3) what it pushes the frame with.
            bent: (N, R) of the links beyond the encoders.
        """
        unit = skew(np.eye(3)[axis])
        loads = self._torques(bent, bent[:, -3:] @ unit) - robot
        loads[:, -3:] += force @ unit.T
        return np.asarray(loads)
