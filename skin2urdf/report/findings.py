"""Figures that both the summary and the JSON give of a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, frozen
from skin2urdf.calibration import BAD_FIT, GOOD_FIT, Calibration
from skin2urdf.estimation.observability import aligned_deviations
from skin2urdf.report.branches import between_branches
from skin2urdf.report.words import Unknown, unknowns

_CONFIGURATIONS = 50


@dataclass(frozen=True, eq=False)
class Findings:
    """What is worth telling of a calibration with D joints and U SUs.

    Standard deviations are NaN for what does not exist or is not observable.

    Attributes:
        verdict: the outcome in one line.
        axis_position_sd: (D,) of each axis at the joint's origin, square to it [m].
        axis_direction_sd: (D,) of each axis' direction [rad].
        su_position_sd: (U,) of each SU's position on its joint, observable directions only [m].
        su_orientation_sd: (U,) of its orientation [rad].
        expected_position: rms error of SU positions to expect over the joints' ranges, once the
            base frames are aligned; of the SUs that are observable in all directions [m].
        expected_orientation: the same of SU orientations [rad].
        unknown: per SU what the log does not tell.
        between_branches: what the log does not tell of branches relative to each other.
    """

    verdict: str
    axis_position_sd: F64
    axis_direction_sd: F64
    su_position_sd: F64
    su_orientation_sd: F64
    expected_position: float
    expected_orientation: float
    unknown: tuple[tuple[Unknown, ...], ...]
    between_branches: tuple[Unknown, ...]

    def __post_init__(self) -> None:
        for name in (
            "axis_position_sd",
            "axis_direction_sd",
            "su_position_sd",
            "su_orientation_sd",
        ):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def findings(calibration: Calibration) -> Findings:
    """Work the figures out."""
    found, state = calibration.observability, calibration.estimate.state
    tree = calibration.model.tree
    su_sd = np.sqrt(np.einsum("uii->ui", found.su_covariance).clip(min=0.0))
    nothing = np.array([len(rows) == 6 for rows in found.su_unobservable], dtype=bool)
    unseen = nothing | (tree.su_joint < 0)  # the position of an SU on the RS is never seen
    position, direction = _axis_deviations(calibration)
    expected = _expected(calibration)
    return Findings(
        verdict=_verdict(calibration),
        axis_position_sd=position,
        axis_direction_sd=direction,
        su_position_sd=np.where(unseen, np.nan, np.linalg.norm(su_sd[:, :3], axis=1)),
        su_orientation_sd=np.where(nothing, np.nan, np.linalg.norm(su_sd[:, 3:], axis=1)),
        expected_position=expected[0],
        expected_orientation=expected[1],
        unknown=unknowns(calibration.model, found.su_unobservable, state.up),
        between_branches=between_branches(calibration.model, calibration.open_directions, state.up),
    )


def _verdict(calibration: Calibration) -> str:
    """The outcome in one line that says how far it can be believed."""
    fit, tree = calibration.estimate, calibration.model.tree
    robot = f"{_count(tree.n_joints, 'joint')}, {_count(tree.n_sus, 'SU')}"
    cost = f"cost per degree of freedom {fit.cost_per_dof:.2f}"
    words = {
        "good": f"the model explains the readings ({cost})",
        "fair": f"the model explains the readings in part ({cost}; up to {GOOD_FIT:g} is good)",
        "bad": f"the model does not explain the readings ({cost}; {BAD_FIT:g} is the limit)",
    }[calibration.quality]
    return f"{calibration.quality}: {robot}; {words}"


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _axis_deviations(calibration: Calibration) -> tuple[F64, F64]:
    """(D,) standard deviations of axis positions [m] and directions [rad].

    The covariance speaks of the estimation's joint frames. The origin that the URDF has lies
    elsewhere on the same axis; a tilt of the axis moves it by the tilt times that distance.
    """
    tree = calibration.model.tree
    z = -calibration.T_canonical_joint[:, 2, 3]
    shift = np.zeros((tree.n_joints, 2, 4))  # of the point at z, from tx, ty, rx, ry
    shift[:, 0, 0] = shift[:, 1, 1] = 1.0
    shift[:, 0, 3], shift[:, 1, 2] = z, -z
    covariance = calibration.observability.joint_covariance
    position = np.sqrt(np.einsum("dij,djk,dik->d", shift, covariance, shift).clip(min=0.0))
    direction = np.sqrt(np.einsum("dii->d", covariance[:, 2:, 2:]).clip(min=0.0))
    # Where an axis on the RS passes is a free choice, where a prismatic one passes means nothing.
    free = (tree.parent < 0) | tree.prismatic
    return np.where(free, np.nan, position), direction


def _expected(calibration: Calibration) -> tuple[float, float]:
    """Expected rms errors of SU positions [m] and orientations [rad] over the ranges."""
    low, high = calibration.limits.T
    rng = np.random.default_rng(0)
    q = low + (high - low) * rng.random((_CONFIGURATIONS, len(low)))
    deviations = aligned_deviations(calibration.estimate, calibration.observability, q)
    whole = np.array([not len(rows) for rows in calibration.observability.su_unobservable])
    position, orientation = (_rms(d[whole]) for d in deviations)
    return position, orientation


def _rms(values: F64) -> float:
    """Root mean square of the finite values, NaN where there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")
