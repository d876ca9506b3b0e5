"""Motors and links as masses with springs between them, integrated in time.

Every coordinate x_i of a mechanism is held by a spring at a drive u_i(t): the motor's side of a
gear, which its servo moves, or 0 for a place where a body bends. With Pinocchio's dynamics

    M(x) x'' + h(x, x') = k z(u - x) + c (u' - x')

where z leaves a gap of the width of the gear's play. What is rigid follows its drive exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.simulation.trajectory import JointMotion

STEP = 2e-3
"""Step of the integration [s]; halving it moves a link by 1e-6 rad of the 4e-3 that it twists."""

_GAMMA = 1.0 - 0.5**0.5
"""Of the singly diagonally implicit Runge-Kutta method of two stages, second order and L-stable.

Alexander, SIAM J. Numer. Anal. 14 (1977). Stiff gears of light wrists (some 100 Hz and more) are
settled by it without ringing, what moves at less than 20 Hz is followed to 1e-4.
"""
_ITERATIONS = 50
_TOLERANCE = 1e-5
"""Change of an acceleration at which Newton's method ends [rad/s^2].

It converges by 1e-4 and more with every iteration, since only how gravity and inertia change with
the position within a step is left out of its matrix: what is left is less than 1e-9.
"""


@dataclass(frozen=True, eq=False)
class Springs(Record):
    """Springs between n coordinates and their drives.

    Attributes:
        stiffness: (n,) inf where rigid [N m/rad or N/m].
        damping: (n,) [N m s/rad or N s/m].
        play: (n,) width of the gap [rad or m].
    """

    stiffness: F64
    damping: F64
    play: F64

    @property
    def soft(self) -> Bool:
        """(n,) True where it gives way."""
        return np.isfinite(self.stiffness)


@dataclass(frozen=True, eq=False)
class Swing(Record):
    """What the links do.

    Attributes:
        motion: of the n coordinates.
        velocity: (K, n) at its times [rad/s or m/s].
        torque: (K, n) what holds each coordinate, spring and damper or rigid [N m or N].
    """

    motion: JointMotion
    velocity: F64
    torque: F64


def swing(model: Any, springs: Springs, drive: JointMotion, step: float = STEP) -> Swing:
    """Let links swing on their springs while motors move.

    Args:
        model: ``pinocchio.Model`` of n joints with one position and one velocity each.
        springs: the springs.
        drive: motion (K, n) of the springs' far ends.
        step: step of the integration [s].

    Returns:
        The motion from rest in balance at the first position of the drive, at every step.
    """
    time = np.arange(int(drive.time[-1] / step + 1e-9) + 1, dtype=np.float64) * step
    stages = [drive.at(np.minimum(time + s * step, drive.time[-1])) for s in (_GAMMA, 1.0)]
    positions, velocities, torques = (np.empty((time.size, model.nv)) for _ in range(3))
    stage = _Stage(model, springs, _GAMMA * step)
    rest = (1.0 - _GAMMA) * step
    x = _balance(model, springs, drive.position[0])
    v = np.zeros_like(x)
    a = np.zeros_like(x)
    torque = stage.torque(x, v, a)
    for n in range(time.size):
        positions[n], velocities[n], torques[n] = x, v, torque
        stage.take_inertia(x)
        _, v1, a1, _ = stage.solve(x, v, a, [u[n] for u in stages[0]])
        x, v, a, torque = stage.solve(x + rest * v1, v + rest * a1, a1, [u[n] for u in stages[1]])
    return Swing(JointMotion(time, positions), velocities, torques)


class _Stage:
    """One implicit stage: x = x0 + g v and v = v0 + g a, with forces in balance at its end."""

    def __init__(self, model: Any, springs: Springs, g: float) -> None:
        import pinocchio as pin
        from scipy.linalg.lapack import dpotrf, dpotrs

        self._pin, self._dpotrf, self._dpotrs = pin, dpotrf, dpotrs
        self._model, self._data = model, model.createData()
        soft = np.flatnonzero(springs.soft)
        # A slice makes views, which is several times as fast; rigid robots with hinges need more.
        self._soft: Any = slice(None) if soft.size == model.nv else soft
        self._block: Any = self._soft if soft.size == model.nv else np.ix_(soft, soft)
        self._hard = np.flatnonzero(~springs.soft)
        self._k, self._c = springs.stiffness[soft], springs.damping[soft]
        self._half = 0.5 * springs.play[soft]
        self._tight = self._half == 0
        self._has_play = not self._tight.all()
        self._g = g
        self._M: F64 = np.zeros((soft.size, soft.size))
        self._roots: dict[bytes, F64] = {}

    def torque(self, x: F64, v: F64, a: F64) -> F64:
        """(n,) what must hold the coordinates."""
        return np.array(self._pin.rnea(self._model, self._data, x, v, a))

    def take_inertia(self, x: F64) -> None:
        """Take the inertia of the soft coordinates at x (n,) for the stages that follow."""
        self._pin.crba(self._model, self._data, x)
        self._M = np.array(self._data.M[self._block])  # only the upper triangle is filled
        self._roots.clear()

    def solve(self, x0: F64, v0: F64, a: F64, drive: Sequence[F64]) -> tuple[F64, F64, F64, F64]:
        """Position, velocity, acceleration (n,) at the stage's end, and the torque that holds.

        Args:
            x0: (n,) what is known of the position.
            v0: (n,) what is known of the velocity.
            a: (n,) acceleration to begin with.
            drive: (n,) position, velocity, acceleration of the drives at the stage's end.
        """
        soft, g, k, c, half = self._soft, self._g, self._k, self._c, self._half
        rigid, rnea, solve = self._hard.size > 0, self._pin.rnea, self._dpotrs
        u, u_dot, u_ddot = drive
        far, far_dot = u[soft], u_dot[soft]
        a = a.copy()
        a[self._hard] = u_ddot[self._hard]
        root = None if self._has_play else self._root(np.ones(half.shape, dtype=np.bool_))
        for _ in range(_ITERATIONS):
            v = v0 + g * a
            x = x0 + g * v
            if rigid:
                x[self._hard], v[self._hard] = u[self._hard], u_dot[self._hard]
            torque = rnea(self._model, self._data, x, v, a)
            stretch = far - x[soft]
            if self._has_play:
                stretch -= np.maximum(-half, np.minimum(stretch, half))
                root = self._root((stretch != 0) | self._tight)
            missing = k * stretch + c * (far_dot - v[soft]) - torque[soft]
            change, _ = solve(root, missing)
            a[soft] += change
            if max(map(abs, change.tolist())) < _TOLERANCE:
                break
        v = v0 + g * a
        x = x0 + g * v
        if rigid:
            x[self._hard], v[self._hard] = u[self._hard], u_dot[self._hard]
        return x, v, a, np.array(torque)

    def _root(self, pulls: Bool) -> F64:
        """Upper Cholesky factor of Newton's matrix where some springs (n,) pull."""
        key = pulls.tobytes()
        if key not in self._roots:
            J = self._M.copy()
            J.reshape(-1)[:: len(J) + 1] += self._g * (self._c + self._g * (self._k * pulls))
            self._roots[key] = self._dpotrf(J, clean=0)[0]
        return self._roots[key]


def _balance(model: Any, springs: Springs, drive: F64) -> F64:
    """(n,) where links rest on their springs, at drives (n,)."""
    import pinocchio as pin

    data = model.createData()
    soft = springs.soft
    k, half = springs.stiffness[soft], 0.5 * springs.play[soft]
    x = drive.copy()
    for _ in range(_ITERATIONS):
        load = pin.computeGeneralizedGravity(model, data, x)[soft]
        x[soft] = drive[soft] - load / k - half * np.sign(load)
    return x
