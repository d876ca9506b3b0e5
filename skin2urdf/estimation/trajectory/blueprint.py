"""A robot that is known before: its joints' placements, and how well they and the mount are known.

Lengths are then not to be found, and need no gravity of known size; the base frame is the given
one, so that the direction of gravity in it is what the log has to show. What may deviate does so
with a Gaussian prior: all six coordinates of a placement, since the zero of an encoder (a turn
about the axis) and the place along the axis are what the model says, and no free choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.estimation.problem.state import JOINT_COORDINATES, State
from skin2urdf.geometry.se3 import inverse, log, screw
from skin2urdf.geometry.so3 import frame_with_z, rotation_exp

ALONG_AXIS = (2, 5)
"""Coordinates of a placement that leave its axis where it is: tz and rz, the zero of an encoder."""
N_MOUNT = 2
"""Turns of the first log's gravity [rad]."""


@dataclass(frozen=True, eq=False)
class Blueprint(Record):
    """What is known of D joints before the logs are read.

    Attributes:
        T_parent_joint: (D, 4, 4) expected placements.
        deviations: (D, 6) standard deviations of the twists ``T -> T exp(xi)`` by which they may
            differ [m, rad]; 0 keeps a coordinate.
        up: (3,) expected direction opposite to gravity in the base frame in the first log.
        tilt: standard deviation of it [rad].
        inertials: (10 D,) of what each joint carries, as in :mod:`known_torque`; None where it is
            not known.
    """

    T_parent_joint: F64
    deviations: F64
    up: F64
    tilt: float
    inertials: F64 | None = None

    @property
    def n_coordinates(self) -> int:
        """Number of coordinates beyond those of every fit: the mount's, and two of each joint."""
        return N_MOUNT + len(ALONG_AXIS) * len(self.deviations)

    def free(self) -> tuple[Bool, Bool]:
        """Which of the joints' coordinates (4 D,) and of the further ones may move."""
        may = self.deviations > 0
        further = np.concatenate([[self.tilt > 0] * N_MOUNT, may[:, ALONG_AXIS].ravel()])
        return may[:, JOINT_COORDINATES].ravel(), further

    def information(self, state: State) -> tuple[tuple[F64, F64], tuple[F64, F64]]:
        """Information of the prior and its gradient, of the joints' and the further coordinates.

        Args:
            state: where.

        Returns:
            (4 D,) information and gradient, half the slope of chi-squared with its sign turned, and
            the same of the further coordinates.
        """
        known = np.divide(
            1.0, self.deviations**2, out=np.zeros(self.deviations.shape), where=self.deviations > 0
        )
        pull = -known * self.corrections(state)
        mount = np.full(N_MOUNT, self.tilt**-2.0 if self.tilt > 0 else 0.0)
        turned = turn_axes(state.up[0]).T @ np.cross(self.up, state.up[0])
        return (
            (known[:, JOINT_COORDINATES].ravel(), pull[:, JOINT_COORDINATES].ravel()),
            (
                np.concatenate([mount, known[:, ALONG_AXIS].ravel()]),
                np.concatenate([-mount * turned, pull[:, ALONG_AXIS].ravel()]),
            ),
        )

    def corrections(self, state: State) -> F64:
        """(D, 6) twists from the expected placements to those of a state [m, rad]."""
        return log(inverse(self.T_parent_joint) @ state.T_parent_joint)


def turn_axes(up: F64) -> F64:
    """(3, 2) axes about which a direction is turned: square to it and to each other."""
    return frame_with_z(up)[:, :2]


def further_moved(state: State, x: F64) -> State:
    """The state after a step of the further coordinates.

    Args:
        state: where it begins.
        x: turns of the first log's gravity, then tz [m] and rz [rad] of each joint.
    """
    along = x[N_MOUNT:].reshape(-1, len(ALONG_AXIS))
    up = np.array(state.up)
    up[0] = rotation_exp(turn_axes(up[0]) @ x[:N_MOUNT]) @ up[0]
    T = state.T_parent_joint @ screw("z", along[:, 1], along[:, 0])
    return replace(state, T_parent_joint=T, up=up)


def further_columns(first: int, chain: Sequence[int], log_number: int) -> list[int]:
    """Which of the further coordinates an SU's readings in a log depend on.

    Args:
        first: column of the first of them.
        chain: the joints before the SU.
        log_number: gravity's turns are those of the first log.
    """
    mount = list(range(first, first + N_MOUNT)) if log_number == 0 else []
    n = len(ALONG_AXIS)
    return mount + [first + N_MOUNT + n * k + i for k in chain for i in range(n)]
