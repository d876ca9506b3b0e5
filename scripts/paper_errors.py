"""Errors, bounds and statistics of `reproduce_paper.py`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import N_SU, State, Step, identifiable, moved
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.geometry.se3 import screw
from skin2urdf.geometry.so3 import rotation_log
from skin2urdf.model.records import KinematicModel
from skin2urdf.paper.case import N_DOFS, TRUE_LINKS, TRUE_SUS, PaperTraining
from skin2urdf.paper.method import PaperResult
from skin2urdf.paper.model import link_transform, su_transform
from skin2urdf.paper.placements import DhTable, dh_table
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import JointType, KinematicTree

_REVOLUTE: JointType = "revolute"
TREE = KinematicTree(
    tuple(f"DoF-{n + 1}" for n in range(N_DOFS)),
    np.arange(-1, N_DOFS - 1),
    (_REVOLUTE,) * N_DOFS,
    tuple(f"SU-{n + 1}" for n in range(N_DOFS)),
    np.arange(N_DOFS),
)
THETA0_1, D_1 = (float(v) for v in TRUE_LINKS[0, :2])
"""The arbitrary two parameters (paper II-C.5), set to the true ones in every table."""

LINK_NAMES = ("theta0", "d", "a", "alpha")
SU_NAMES = (*LINK_NAMES, "theta_acc", "d_acc")
LENGTHS = {"d", "a", "d_acc"}


def model_of(links: F64, sus: F64, tilt: float) -> KinematicModel:
    """Robot of DH parameters links (6, 4) and sus (7, 6), axis 1 tilted by ``tilt`` [rad]."""
    first = screw("x", tilt, 0.0)[None]
    return KinematicModel(TREE, np.concatenate([first, link_transform(links)]), su_transform(sus))


def in_true_gauge(model: KinematicModel) -> DhTable:
    """Parameters of a model with theta0_1 and d_1 as in the truth."""
    return dh_table(model, THETA0_1, D_1)


def wrapped(angle: F64) -> F64:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


@dataclass(frozen=True)
class Parameter:
    """One gauge-free parameter whose error is judged.

    Attributes:
        name: where it is and what it is.
        length: True for a length, False for an angle.
        link: True for links, False for SU placements.
    """

    name: str
    length: bool
    link: bool


def parameters() -> tuple[Parameter, ...]:
    """The parameters that accelerometers determine, in the order of :func:`errors`."""
    links = [
        Parameter(f"DoF {n + 1}-{n + 2} {name}", name in LENGTHS, True)
        for n in range(N_DOFS - 1)
        for name in LINK_NAMES
        if n or name not in ("theta0", "d")
    ]
    sus = [
        Parameter(f"SU {n + 1} {kind} {axis}", kind == "position", False)
        for kind in ("position", "turn")
        for n in range(N_DOFS)
        for axis in "xyz"
        if (n, kind, axis) != (0, "position", "z")
    ]
    return (*links, *sus)


def su_errors(table: DhTable, truth: DhTable) -> tuple[F64, F64]:
    """Errors of SU placements in the frames of their DoFs.

    Returns:
        (7, 3) positions [m], z of SU 1 set to 0 since nothing in the data tells it, and (7, 3)
        rotation vectors [rad].
    """
    T, T_true = table.model.T_joint_su, truth.model.T_joint_su
    shift = T[:, :3, 3] - T_true[:, :3, 3]
    shift[0, 2] = 0.0
    return shift, rotation_log(T[:, :3, :3] @ np.swapaxes(T_true[:, :3, :3], 1, 2))


def errors(table: DhTable, truth: DhTable) -> F64:
    """(63,) errors of all parameters of :func:`parameters` [m and rad]."""
    link = table.links[1:] - truth.links[1:]
    link[:, [0, 3]] = wrapped(link[:, [0, 3]])
    position, turn = su_errors(table, truth)
    return np.concatenate([link.ravel()[2:], np.delete(position.ravel(), 2), turn.ravel()])


class Bounds:
    """Cramer-Rao bounds of all parameters, from the weighted Jacobian at the truth."""

    def __init__(self, tilt: float, intrinsics: bool) -> None:
        """Differentiate the parameters at the truth.

        Args:
            tilt: angle between axis 1 and the vertical [rad].
            intrinsics: count bias, scale and cross-axis terms of the SUs as unknown, with the
                default method's priors.
        """
        true_model, U = model_of(TRUE_LINKS, TRUE_SUS, tilt), N_DOFS
        up, none = np.array([[0.0, 0.0, 1.0]]), np.zeros((U, 3))
        placements = true_model.T_parent_joint, true_model.T_joint_su
        self._state = State(*placements, up, none, np.zeros((U, 6)))
        allowed = identifiable(TREE, 1, intrinsics)
        coordinates = (allowed.joints, allowed.logs, allowed.sus)
        self._free = np.flatnonzero(np.concatenate([c.ravel() for c in coordinates]))
        truth, size = in_true_gauge(true_model), 1e-6
        zero = Step(np.zeros(allowed.joints.shape), np.zeros((0, 2)), np.zeros(allowed.sus.shape))
        self._by_coordinate = np.zeros((len(parameters()), len(self._free)))
        for column, coordinate in enumerate(self._free):
            for sign in (1.0, -1.0):
                flat = zero.flat()
                flat[coordinate] = sign * size
                table = in_true_gauge(moved(self._state, zero.like(flat)).model(TREE))
                self._by_coordinate[:, column] += sign * errors(table, truth) / (2 * size)

    def of(self, features: Features) -> F64:
        """(63,) bounds [m and rad] of a training set: its poses and noise, not its readings."""
        cost = Cost(TREE, feature_blocks(features, TREE), Priors())
        equations = cost.at(self._state).normal_equations()
        J = len(equations.joint)
        H = np.zeros((J + N_SU * N_DOFS, J + N_SU * N_DOFS))
        H[:J, :J] = equations.joint
        for u in range(N_DOFS):
            at = slice(J + N_SU * u, J + N_SU * (u + 1))
            H[at, at] = equations.su[u]
            np.add.at(H[at, :J].T, equations.columns[u], equations.mixed[u].T)
            H[:J, at] = H[at, :J].T
        H = H[np.ix_(self._free, self._free)]
        scale = 1 / np.sqrt(np.diag(H))
        values, V = np.linalg.eigh(H * scale[:, None] * scale)
        known = values > 1e-9 * values[-1]
        root = (self._by_coordinate * scale) @ V[:, known] / np.sqrt(values[known])
        return np.asarray(np.sqrt(np.sum(root**2, axis=1)))


OPTIMUM = 1.2
"""Cost per degree of freedom below which the default method is at the global optimum.

Its standard deviation is 0.03 here; the next local minimum is far above.
"""


@dataclass(frozen=True, eq=False)
class Run:
    """Both methods on one training set.

    Attributes:
        seed: seed of poses, noise and the paper's search.
        training: the training set.
        features: the same as features.
        default: estimate of the default method.
        default_seconds: its time from features to estimate [s].
        default_cpu: the processor time of the same [s].
        default_table: its parameters, with the arbitrary two as in the truth.
        paper: result of the paper's method, if it ran.
        paper_seconds: its time [s], NaN if it did not run.
        paper_table: its parameters.
    """

    seed: int
    training: PaperTraining
    features: Features
    default: Estimate
    default_seconds: float
    default_cpu: float
    default_table: DhTable
    paper: PaperResult | None
    paper_seconds: float
    paper_table: DhTable | None


@dataclass(frozen=True, eq=False)
class Statistics:
    """Errors and times of both methods over N seeds; errors are (63,) in m and rad.

    Attributes:
        seeds: N.
        default_optimum: seeds in which the default method found the global optimum.
        default_seconds: (N,) its times [s].
        default_cpu: (N,) its processor times [s].
        default_rms: its root mean square errors.
        paper_converged: seeds in which the paper's method ended below its stop value.
        paper_seconds: (N,) its times [s].
        paper_rms: its root mean square errors.
        bound: Cramer-Rao bounds for sensors known to be ideal, as those of the case are.
        bound_unknown_sensors: the same with the sensors' bias and shape unknown but for priors,
            which is how the default method takes them.
    """

    seeds: int
    default_optimum: int
    default_seconds: F64
    default_cpu: F64
    default_rms: F64
    paper_converged: int
    paper_seconds: F64
    paper_rms: F64
    bound: F64
    bound_unknown_sensors: F64


def statistics(runs: list[Run], truth: DhTable, tilt: float) -> Statistics:
    """Success, times, rms errors and the rms of the seeds' Cramer-Rao bounds."""

    def rms(values: list[F64]) -> F64:
        if not values:
            return np.full(len(parameters()), np.nan)
        return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))

    ideal, unknown = Bounds(tilt, False), Bounds(tilt, True)
    return Statistics(
        seeds=len(runs),
        default_optimum=sum(r.default.cost_per_dof < OPTIMUM for r in runs),
        default_seconds=np.array([r.default_seconds for r in runs]),
        default_cpu=np.array([r.default_cpu for r in runs]),
        default_rms=rms([errors(r.default_table, truth) for r in runs]),
        paper_converged=sum(r.paper is not None and r.paper.converged for r in runs),
        paper_seconds=np.array([r.paper_seconds for r in runs]),
        paper_rms=rms([errors(r.paper_table, truth) for r in runs if r.paper_table is not None]),
        bound=rms([ideal.of(r.features) for r in runs]),
        bound_unknown_sensors=rms([unknown.of(r.features) for r in runs]),
    )
