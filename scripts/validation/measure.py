"""One run: simulate, calibrate without the truth, write the URDF, hold it against the truth."""

from __future__ import annotations

import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.solve.estimate import EstimationSettings
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.recording.records import Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.recording.writing import write
from skin2urdf.report.notes import note_words
from skin2urdf.simulation import SimulationSettings, Truth, load_robot, simulate
from skin2urdf.urdf.compare import compare, random_positions
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.loading import load_robot as load_urdf
from skin2urdf.urdf.loading import neutral
from skin2urdf.urdf.records import Comparison, Spread
from skin2urdf.urdf.rpy import rpy_of_rotation
from validation.cases import Case, Circumstance
from validation.records import Figures, Over, SuFigures

CONFIGURATIONS = 200
"""Random configurations of a comparison."""
BOUND_ROWS = 2000
"""About how many SU poses the bound is averaged over; bounds its memory for robots of many SUs."""


def settings_of(case: Case) -> SimulationSettings:
    """The settings of a case's recording."""
    of: Circumstance = case.circumstance
    return SimulationSettings(
        n_poses=of.poses,
        excite=of.excite,
        upright=of.posture == "upright",
        seed=case.seed,
        grade=of.grade,
        tracking=of.tracking,
        encoder_bits=of.encoder_bits,
    )


def perform(case: Case) -> Figures:
    """Everything about one run.

    Raises:
        Exception: whatever the package raises.
    """
    begin = time.perf_counter()
    settings = CalibrationSettings(
        estimation=EstimationSettings(refine=case.circumstance.refine), gravity_deviation=0.0
    )
    with tempfile.TemporaryDirectory() as folder:
        log, truth = _recorded(case, Path(folder))
        simulated = time.perf_counter()
        calibration = calibrate(log, settings)
        calibrated = time.perf_counter()
        figures = _compared(case, calibration, truth, Path(folder))
    seconds = {
        "simulate": simulated - begin,
        **calibration.seconds,
        "compare": time.perf_counter() - calibrated,
    }
    return replace(figures, seconds=seconds)


def _recorded(case: Case, folder: Path) -> tuple[Recording | Path, Truth]:
    """The recording with its times as read from a file, or in a file where asked for; its truth.

    Nothing else of the simulation is left: of a hundred DoFs a recording takes gigabytes.
    """
    simulation = simulate(load_robot(case.robot_or_path), settings_of(case))
    if not case.circumstance.through_mcap:
        return retimed(simulation.recording), simulation.truth
    path = folder / "log.mcap"
    write(simulation.recording, path, joint_order=simulation.joint_order)
    return path, simulation.truth


def _compared(case: Case, found: Calibration, truth: Truth, folder: Path) -> Figures:
    """All figures but the times."""
    tree, seen = found.model.tree, found.observability
    held = _Held.against(case, found, truth, folder)
    comparison, sus = held.figures()
    types = load_urdf(held.true).joint_types
    found_types = dict(zip(tree.joint_names, tree.joint_types, strict=True))
    return Figures(
        tree_right=comparison.tree_equal,
        tree_differences=tuple(each.words for each in comparison.tree_differences),
        types_right=all(types.get(n) == kind for n, kind in found_types.items()),
        cost_per_dof=float(found.estimate.cost_per_dof),
        n_dofs=len(truth.joint_names),
        n_poses=found.features.n_poses if found.features else 0,
        hypotheses=tuple(map(float, found.estimate.hypotheses)),
        axis_angle_deg=_rms(comparison.axis_angle, _DEG),
        axis_distance_mm=_rms(comparison.axis_distance, 1e3),
        determined=Over.of(su for su in sus if su.verdict == "determined"),
        every=Over.of(sus),
        sus=sus,
        n_open=seen.n_open,
        joint_verdicts=dict(zip(tree.joint_names, seen.joint_verdict, strict=True)),
        seconds={},
        notes=tuple(note_words(found.notes)),
    )


_DEG = float(np.rad2deg(1.0))


@dataclass(frozen=True, eq=False)
class _Held:
    """A calibration on disk beside its truth.

    Attributes:
        found: the calibration.
        est: its URDF.
        true: the true URDF.
        turned: the true URDF with every SU turned by what its sensor's errors hold of rotation.
        floors: angle of that rotation, by SU [deg].
        seed: of the random configurations.
    """

    found: Calibration
    est: Path
    true: Path
    turned: Path
    floors: dict[str, float]
    seed: int

    @classmethod
    def against(cls, case: Case, found: Calibration, truth: Truth, folder: Path) -> _Held:
        """Write the files."""
        Q = sensor_rotations(truth.sensor_matrix)
        texts = {
            "estimate": emit(
                found.model,
                name="estimate",
                limits=found.limits,
                velocity=found.velocity,
                continuous=found.continuous,
            ),
            "truth": truth.urdf,
            "turned": truth_as_felt(truth, Q),
        }
        paths = {name: folder / f"{name}.urdf" for name in texts}
        for name, text in texts.items():
            paths[name].write_text(text, encoding="utf-8")
        floors = {su.name: _angle(Q[u]) for u, su in enumerate(truth.sus)}
        return cls(found, paths["estimate"], paths["truth"], paths["turned"], floors, case.seed)

    def figures(self) -> tuple[Comparison, tuple[SuFigures, ...]]:
        """Compare.

        Returns:
            The comparison with the truth, and the figures of the SUs that count in it.
        """
        tree, seen = self.found.model.tree, self.found.observability
        verdicts = dict(zip(tree.su_names, seen.su_verdict, strict=True))
        plain, beside = (
            compare(
                self.est,
                path,
                unobservable=dict(zip(tree.su_names, seen.su_unobservable, strict=True)),
                anchors=[name for name, verdict in verdicts.items() if verdict == "determined"],
                open_directions=self.found.open_directions,
                sus=list(self.floors),
                n_configurations=CONFIGURATIONS,
                rng=np.random.default_rng(self.seed),
            )
            for path in (self.true, self.turned)
        )
        position, orientation = self._bounds()
        felt = {su.name: su for su in beside.sus}
        rows = {name: u for u, name in enumerate(tree.su_names)}
        figures = tuple(
            SuFigures(
                name=su.name,
                verdict=verdicts[su.name],
                n_unobservable=su.n_unobservable,
                position_mm=_rms(su.position, 1e3),
                position_bound_mm=_number(position[rows[su.name]] * 1e3),
                orientation_deg=_rms(su.orientation, _DEG),
                orientation_bound_deg=_number(orientation[rows[su.name]] * _DEG),
                floor_deg=self.floors[su.name],
                orientation_beside_floor_deg=_rms(felt[su.name].orientation, _DEG),
            )
            for su in plain.sus
        )
        return plain, figures

    def _bounds(self) -> tuple[F64, F64]:
        """Cramer-Rao bounds (U,) of position [m] and orientation [rad] in that comparison.

        The calibration states covariances that are never smaller than its weights say. A bound
        must not be too large, so it goes by the level that the residuals really have.
        """
        estimate, seen = self.found.estimate, self.found.observability
        cost = estimate.cost_per_dof
        honest = replace(seen, covariance=seen.covariance.scaled(cost / max(1.0, cost)))
        tree = self.found.model.tree
        q = _configurations(self.est, self.true, tree.joint_names, self.seed)
        rows = max(20, BOUND_ROWS // max(1, tree.n_sus))
        return aligned_deviations(estimate, honest, q[:rows])


def sensor_rotations(sensor_matrix: F64) -> F64:
    """(U, 3, 3) rotations Q in the sensitivities M = S Q, S symmetric (left polar decomposition).

    The estimation knows sensors up to a symmetric matrix: S Q R^T f reads like a sensor of
    sensitivity S that sits turned by Q, so Q is part of the orientation it finds.
    """
    from scipy.linalg import polar

    return np.array([polar(M, side="left")[0] for M in sensor_matrix]).reshape(-1, 3, 3)


def truth_as_felt(truth: Truth, Q: F64) -> str:
    """The true URDF with every SU turned by the rotation (U, 3, 3) inside its cross-axis errors.

    Q R^T turns the base's vectors into what the sensor takes for its own frame, so the frame it
    seems to sit in is R Q^T.
    """
    robot = ET.fromstring(truth.urdf)  # noqa: S314 - our own text
    rows = {su.name: u for u, su in enumerate(truth.sus)}
    for joint in robot.findall("joint"):
        child, origin = joint.find("child"), joint.find("origin")
        u = rows.get(child.get("link", "")) if child is not None else None
        if u is not None and origin is not None:
            R = truth.sus[u].T_link_su[:3, :3] @ Q[u].T
            origin.set("rpy", " ".join(repr(float(angle)) for angle in rpy_of_rotation(R)))
    return ET.tostring(robot, encoding="unicode")


def _configurations(est: Path, true: Path, names: Sequence[str], seed: int) -> F64:
    """(n, D) configurations of the comparison, in the estimate's order of joints [rad or m]."""
    robots = load_urdf(est), load_urdf(true)
    shared = [name for name in robots[0].joint_types if name in robots[1].joint_types]
    rng = np.random.default_rng(seed)
    drawn = random_positions(*robots, shared, CONFIGURATIONS, rng)
    held = neutral(robots[0])
    q = np.empty((CONFIGURATIONS, len(names)))
    for j, name in enumerate(names):
        q[:, j] = drawn[:, shared.index(name)] if name in shared else held[name]
    return q


def _angle(R: F64) -> float:
    """Angle of a rotation (3, 3) [deg], exact for small ones."""
    twice_sine = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.rad2deg(np.arctan2(np.linalg.norm(twice_sine), np.trace(R) - 1.0)))


def _rms(spread: Spread | None, scale: float) -> float | None:
    """Root mean square times ``scale``; None where there is nothing."""
    return None if spread is None or not np.isfinite(spread.rms) else float(spread.rms * scale)


def _number(value: float) -> float | None:
    """The value, None where it is not finite."""
    return float(value) if np.isfinite(value) else None
