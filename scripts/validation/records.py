"""What a run found."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from batch.figures import rms
from batch.records import Record

from validation.cases import Case


@dataclass(frozen=True)
class SuFigures:
    """Errors of one SU next to their Cramer-Rao bounds; None where the log can not tell.

    All are root mean squares over random configurations after alignment of the limb, with the
    directions left out that are not observable.

    Attributes:
        name: the SU.
        verdict: what the calibration says of its placement.
        n_unobservable: how many of its 6 directions are left out.
        position_mm: position error [mm].
        position_bound_mm: its bound [mm].
        orientation_deg: orientation error [deg].
        orientation_bound_deg: its bound without the floor [deg].
        floor_deg: rotation in the sensor's cross-axis errors, which no log can tell from a
            rotation of the sensor [deg].
        orientation_beside_floor_deg: orientation error against the truth turned by that rotation.
    """

    name: str
    verdict: str
    n_unobservable: int
    position_mm: float | None
    position_bound_mm: float | None
    orientation_deg: float | None
    orientation_bound_deg: float | None
    floor_deg: float
    orientation_beside_floor_deg: float | None


@dataclass(frozen=True)
class Over:
    """Root mean squares over a set of SUs; their squares are the mean squares.

    Attributes:
        n: number of SUs in the set.
        position_mm: position error [mm].
        position_bound_mm: its bound, over the same SUs [mm].
        orientation_deg: orientation error [deg].
        orientation_bound_deg: its bound, with the floor [deg].
        orientation_beside_floor_deg: orientation error with the floor taken out [deg].
        orientation_bound_beside_floor_deg: the bound of that, without the floor [deg].
    """

    n: int
    position_mm: float | None
    position_bound_mm: float | None
    orientation_deg: float | None
    orientation_bound_deg: float | None
    orientation_beside_floor_deg: float | None
    orientation_bound_beside_floor_deg: float | None

    @classmethod
    def of(cls, sus: Iterable[SuFigures]) -> Over:
        """Figures over SUs; each error goes in with its bound or not at all."""
        sus = tuple(sus)
        place = [
            (su.position_mm, su.position_bound_mm)
            for su in sus
            if su.position_mm is not None and su.position_bound_mm is not None
        ]
        turn = [
            (su.orientation_deg, su.orientation_bound_deg, su.floor_deg)
            for su in sus
            if su.orientation_deg is not None and su.orientation_bound_deg is not None
        ]
        beside = [
            (su.orientation_beside_floor_deg, su.orientation_bound_deg)
            for su in sus
            if su.orientation_beside_floor_deg is not None and su.orientation_bound_deg is not None
        ]
        return cls(
            len(sus),
            rms(error for error, _ in place),
            rms(bound for _, bound in place),
            rms(error for error, _, _ in turn),
            rms(math.hypot(bound, floor) for _, bound, floor in turn),
            rms(error for error, _ in beside),
            rms(bound for _, bound in beside),
        )


@dataclass(frozen=True)
class Figures:
    """What a finished calibration comes to.

    Attributes:
        tree_right: every joint that moves and every SU is in the tree, at its place, of its type.
        tree_differences: where not, in words.
        types_right: all joints have the right type.
        cost_per_dof: chi-squared per degree of freedom.
        n_dofs: joints of the true robot that move.
        n_poses: poses that were found.
        hypotheses: chi-squared of every start that was followed.
        axis_angle_deg: joint axes, rms over joints and configurations [deg].
        axis_distance_mm: their lines, likewise [mm].
        determined: over the SUs whose placement is determined.
        every: over all SUs, as far as observable.
        sus: each SU.
        n_open: directions of the joints that the log leaves open beyond the base's freedoms.
        joint_verdicts: verdict on each joint.
        seconds: time of every stage [s].
        notes: what the calibration says it mended or left out.
    """

    tree_right: bool
    tree_differences: tuple[str, ...]
    types_right: bool
    cost_per_dof: float | None
    n_dofs: int
    n_poses: int
    hypotheses: tuple[float | None, ...]
    axis_angle_deg: float | None
    axis_distance_mm: float | None
    determined: Over
    every: Over
    sus: tuple[SuFigures, ...]
    n_open: int
    joint_verdicts: Mapping[str, str]
    seconds: Mapping[str, float]
    notes: tuple[str, ...]

    @property
    def calibration_seconds(self) -> float:
        """Time of the calibration alone [s]."""
        return sum(s for stage, s in self.seconds.items() if stage not in ("simulate", "compare"))


Run = Record[Case, Figures]
"""One line of the output."""
