"""Figures that both the summary and the JSON give of a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.estimation.uncertainty.placements import joint_placement_covariance
from skin2urdf.report.branches import between_branches
from skin2urdf.report.limbs import OpenLimb, open_limbs
from skin2urdf.report.verdict import Doubt, doubts, verdict
from skin2urdf.report.words import (
    NO_POSITIONS,
    NO_POSITIONS_OF_PATTERNS,
    Unknown,
    unknowns,
)

_CONFIGURATIONS = 50


@dataclass(frozen=True, eq=False)
class Findings(Record):
    """What is worth telling of a calibration with D joints and U SUs.

    Standard deviations are NaN for what does not exist or is not observable.

    Attributes:
        verdict: the outcome in one line.
        doubts: what speaks against the result, and what is missing of it.
        joint_covariance: (D, 6, 6) of each joint's placement in the URDF, twists (linear, angular)
            in the joint's own frame [m, rad]; see :func:`joint_placement_covariance`.
        axis_position_sd: (D,) of each axis at the joint's origin, square to it [m].
        axis_direction_sd: (D,) of each axis' direction [rad].
        su_position_sd: (U,) of each SU's position on its joint, observable directions only [m].
        su_orientation_sd: (U,) of its orientation, turns that errors of sensors hide included
            [rad].
        expected_position: rms error of SU positions to expect over the joints' ranges, once the
            base frames are aligned; of the SUs that are determined, NaN without any [m].
        expected_orientation: the same of SU orientations [rad].
        worst_position: the largest of any of these [m].
        worst_orientation: the same of SU orientations [rad].
        positions_open: why no position shows of any SU on any joint that turns it, None where one
            does; then that is told once, and not of every SU and branch.
        unknown: per SU what the log does not tell.
        between_branches: what the log does not tell of branches relative to each other.
        open_limbs: limbs of which it does not tell where they are relative to the largest one.
    """

    verdict: str
    doubts: tuple[Doubt, ...]
    joint_covariance: F64
    axis_position_sd: F64
    axis_direction_sd: F64
    su_position_sd: F64
    su_orientation_sd: F64
    expected_position: float
    expected_orientation: float
    worst_position: float
    worst_orientation: float
    positions_open: Unknown | None
    unknown: tuple[tuple[Unknown, ...], ...]
    between_branches: tuple[Unknown, ...]
    open_limbs: tuple[OpenLimb, ...]


def findings(calibration: Calibration) -> Findings:
    """Work the figures out, once for each calibration: URDF, JSON and words ask for them."""
    known = _KNOWN.get(calibration)
    if known is None:
        known = _KNOWN[calibration] = _findings(calibration)
    return known


_KNOWN: WeakKeyDictionary[Calibration, Findings] = WeakKeyDictionary()


def _findings(calibration: Calibration) -> Findings:
    """The figures."""
    found, state = calibration.observability, calibration.estimate.state
    tree = calibration.model.tree
    su_sd = np.sqrt(np.einsum("uii->ui", found.su_covariance).clip(min=0.0))
    nothing = np.array([len(rows) == 6 for rows in found.su_unobservable], dtype=bool)
    # The position of an SU on the RS is never seen.
    unseen = nothing | (tree.su_joint < 0) | np.array([_no_place(r) for r in found.su_unobservable])
    positions_open = None
    if unseen.all():
        of_patterns = calibration.settings.motion == "patterns"
        positions_open = NO_POSITIONS_OF_PATTERNS if of_patterns else NO_POSITIONS
    covariance = joint_placement_covariance(
        calibration.estimate, found, calibration.T_canonical_joint
    )
    variance = np.einsum("dii->di", covariance).clip(min=0.0)
    # Where an axis on the RS passes is a free choice, where a prismatic one passes means nothing.
    anywhere = (tree.parent < 0) | tree.prismatic | bool(unseen.all())
    (position, orientation), worst = _expected(calibration)
    limbs = open_limbs(calibration)
    against = doubts(calibration, limbs)
    return Findings(
        verdict=verdict(calibration, *worst, against),
        doubts=against,
        joint_covariance=covariance,
        axis_position_sd=np.where(anywhere, np.nan, np.sqrt(variance[:, :3].sum(axis=1))),
        axis_direction_sd=np.sqrt(variance[:, 3:].sum(axis=1)),
        su_position_sd=np.where(unseen, np.nan, np.linalg.norm(su_sd[:, :3], axis=1)),
        su_orientation_sd=np.where(
            nothing, np.nan, np.hypot(np.linalg.norm(su_sd[:, 3:], axis=1), found.su_hidden_turn)
        ),
        expected_position=position,
        expected_orientation=orientation,
        worst_position=worst[0],
        worst_orientation=worst[1],
        positions_open=positions_open,
        unknown=unknowns(
            calibration.model,
            [_turns(r) for r in found.su_unobservable] if positions_open else found.su_unobservable,
            state.up,
        ),
        between_branches=between_branches(calibration.model, calibration.open_directions, state.up),
        open_limbs=limbs,
    )


def is_to_repair(calibration: Calibration) -> bool:
    """Whether something has to be set right before the result is of use: most SUs, or one."""
    found = findings(calibration)
    # A log of rests alone leaves all positions open, and nothing is wrong with it where it tells
    # how most SUs are turned; nor is it known to be one where its moves were not to count.
    turned = [not open_ for open_ in found.unknown]
    all_sus = len(turned) + len(calibration.without_a_place)
    of_use = found.positions_open == NO_POSITIONS and 2 * sum(turned) >= all_sus
    missing = calibration.mostly_open and not of_use
    faulty = any(fault.to_repair for fault in calibration.faults)
    wrong = calibration.implausible or calibration.not_of_this_model or calibration.wrong_ratios
    untold = calibration.open_orders or calibration.moved_alike
    return missing or faulty or bool(wrong or untold)


def _no_place(rows: F64) -> bool:
    """Whether unobservable twists (k, 6) hold every shift."""
    return bool(np.linalg.matrix_rank(rows[:, :3], tol=0.5) == 3)


def _turns(rows: F64) -> F64:
    """(k, 6) orthonormal twists that only turn, of the span of unobservable ones."""
    if not _no_place(rows) or len(rows) == 6:
        return rows
    _, size, turns = np.linalg.svd(rows[:, 3:], full_matrices=False)
    turns = turns[size > 0.5]
    return np.concatenate([np.zeros_like(turns), turns], axis=1)


def _expected(calibration: Calibration) -> tuple[tuple[float, float], tuple[float, float]]:
    """Expected rms errors of SU positions [m] and orientations [rad] over the joints' ranges.

    Returns:
        Of the SUs that are determined together, and of the worst of them.
    """
    low, high = calibration.limits.T
    seen = calibration.observability
    rng = np.random.default_rng(0)
    q = low + (high - low) * rng.random((_CONFIGURATIONS, len(low)))
    position, orientation = aligned_deviations(calibration.estimate, seen, q)
    determined = np.array([v == "determined" for v in seen.su_verdict], dtype=bool)
    return (
        (_rms(position[determined]), _rms(orientation[determined])),
        (_largest(position[determined]), _largest(orientation[determined])),
    )


def _largest(values: F64) -> float:
    """Largest of the finite values, NaN where there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else float("nan")


def _rms(values: F64) -> float:
    """Root mean square of the finite values, NaN where there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")
