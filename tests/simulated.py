"""Simulated recordings and the truth about their features, straight from the original URDF.

Shared by tests of features, structure and pipeline. Truth comes from Pinocchio on the URDF that the
simulation was made from, never from the package's own kinematics.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from skin2urdf.arrays import F64
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.signals.features import extract_features
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled, sample_recording
from skin2urdf.simulation import RobotSpec, Simulation, SimulationSettings, load_robot, simulate
from skin2urdf.structure.activity import activity
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.tree import kinematic_tree
from skin2urdf.urdf.compare import compare
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.records import Comparison

PATTERNS = CalibrationSettings(motion="patterns")
"""Settings of tests that look at features, structure or the search for faults, which the fit of all
samples after them does not change."""

SHORT = {"n_poses": 4, "seed": 1, "imu_rate": 125.0, "joint_rate": 100.0}
"""Settings of a short recording; what is not asked of streams costs half as much at these rates."""


def simulation(robot: str = "panda", **options: Any) -> Simulation:
    """A short recording of a robot of the package; the same object for the same settings."""
    return _simulated(robot, SimulationSettings(**{**SHORT, **options}))


@cache
def _simulated(robot: str, settings: SimulationSettings) -> Simulation:
    return simulate(load_robot(robot), settings)


def simulation_of(spec: RobotSpec, **options: Any) -> Simulation:
    """A short recording of any robot."""
    return simulate(spec, SimulationSettings(**{**SHORT, **options}))


def sampled_of(recording: Recording) -> Sampled:
    """A recording on its grid, all DoFs and SUs in the log's order."""
    dofs, sus = [j.name for j in recording.joints], [s.name for s in recording.sus]
    return sample_recording(recording, dofs, sus)


def features_of(recording: Recording) -> Features:
    """Features of a recording, taken once, without any model."""
    return extract_features([sampled_of(recording)], [s.name for s in recording.sus])


def tree_of(features: Features) -> KinematicTree:
    """The tree that features show."""
    return kinematic_tree(activity(features), features)


def changed_sus(recording: Recording, change: Callable[[SuStream], SuStream | None]) -> Recording:
    """The recording with every SU stream changed, or dropped where the change gives None."""
    kept = (change(s) for s in recording.sus)
    return replace(recording, sus=tuple(s for s in kept if s is not None))


def changed_joints(
    recording: Recording, change: Callable[[JointStream], JointStream | None]
) -> Recording:
    """The recording with every joint stream changed, or dropped where the change gives None."""
    kept = (change(j) for j in recording.joints)
    return replace(recording, joints=tuple(j for j in kept if j is not None))


def true_features(truth_urdf: str, gravity_base: F64, features: Features) -> F64:
    """(P, U, 1 + 2 D, 3) what perfect sensors measure around the features' poses.

    Args:
        truth_urdf: robot and SUs, one link for each SU.
        gravity_base: (3,) gravity in the base frame [m/s^2].
        features: poses and names.
    """
    model = pin.buildModelFromXML(truth_urdf)
    data = model.createData()
    joints = [model.joints[model.getJointId(name)] for name in features.dof_names]
    frames = [model.getFrameId(name) for name in features.su_names]
    P, U, D = features.n_poses, features.n_sus, features.n_dofs
    rows = np.zeros((P, U, 1 + 2 * D, 3))
    for p in range(P):
        q = pin.neutral(model)
        for d, joint in enumerate(joints):
            at = features.q[p, d]
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                at if joint.nq == 1 else (np.cos(at), np.sin(at))
            )
        pin.framesForwardKinematics(model, data, q)
        for u, frame in enumerate(frames):
            J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
            f0 = -data.oMf[frame].rotation.T @ gravity_base
            rows[p, u, 0] = f0
            for d, joint in enumerate(joints):
                v, w = J[:3, joint.idx_v], J[3:, joint.idx_v]
                rows[p, u, 1 + d] = np.cross(f0, w)
                rows[p, u, 1 + D + d] = v
    return rows


def read_features(simulation: Simulation, features: Features) -> F64:
    """:func:`true_features` as the simulated sensors, with bias and shape errors, read them."""
    truth = simulation.truth
    rows = true_features(truth.urdf, truth.gravity_base, features)
    order = [[su.name for su in truth.sus].index(name) for name in features.su_names]
    rows = np.einsum("uij,pumj->pumi", truth.sensor_matrix[order], rows)
    rows[:, :, 0] += truth.bias[order]
    return rows


def held_against(
    calibration: Calibration, truth_urdf: str, folder: Path, faulty: Sequence[str] = ()
) -> Comparison:
    """Comparison of a calibration with the truth, unobservable directions left out.

    It is aligned by the SUs that are not faulty.
    """
    estimate, truth = folder / "estimate.urdf", folder / "truth.urdf"
    text = emit(
        calibration.model,
        name="estimate",
        limits=calibration.limits,
        velocity=calibration.velocity,
        continuous=calibration.continuous,
    )
    estimate.write_text(text)
    truth.write_text(truth_urdf)
    seen = calibration.observability
    open_ = dict(zip(calibration.model.tree.su_names, seen.su_unobservable, strict=True))
    rng = np.random.default_rng(0)
    return compare(
        estimate, truth, unobservable=open_, open_directions=calibration.open_directions,
        n_configurations=60, rng=rng,
        anchors=[n for n, rows in open_.items() if n not in faulty and not len(rows)]
        if faulty else None,
    )  # fmt: skip
