"""Features of simulated recordings against Pinocchio's frame Jacobians of the original URDF."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated import (
    changed_sus,
    features_of,
    read_features,
    sampled_of,
    simulation,
    true_features,
)

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.specific_force import beyond_first_order
from skin2urdf.pipeline import calibrate
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.features import extract_features, sample_recording
from skin2urdf.signals.records import Features
from skin2urdf.simulation import Simulation
from skin2urdf.structure.records import KinematicTree

CASES: tuple[dict[str, Any], ...] = (
    {},
    {"excite": "all"},
    {"grade": "bma150", "upright": True},
)


def true_curvature(sim: Simulation, features: Features) -> Any:
    """What readings hold beyond first order, predicted with the true robot."""
    import pinocchio as pin

    pin_model = pin.buildModelFromXML(sim.truth.urdf)
    names = tuple(pin_model.names)[1:]
    world = pin.SE3.Identity()
    frames = [pin_model.frames[pin_model.getFrameId(n)] for n in features.su_names]
    axes = [_axis_to_z(joint.shortname()) for joint in list(pin_model.joints)[1:]]
    placements = list(pin_model.jointPlacements)[1:]
    parents = np.array(list(pin_model.parents)[1:]) - 1
    # Joints of the package turn about z; Pinocchio's about x, y or z.
    fixed = [(axes[p].T if p >= 0 else np.eye(3)) for p in parents]
    T = []
    for j, M in enumerate(placements):
        A = np.eye(4)
        A[:3, :3] = fixed[j]
        B = np.eye(4)
        B[:3, :3] = axes[j]
        T.append(A @ M.homogeneous @ B)
    su_joint = np.array([f.parentJoint - 1 for f in frames])
    T_su = []
    for f, j in zip(frames, su_joint, strict=True):
        A = np.eye(4)
        A[:3, :3] = axes[j].T if j >= 0 else np.eye(3)
        T_su.append(A @ (f.placement if j >= 0 else world * f.placement).homogeneous)
    tree = KinematicTree(
        names, parents, ("revolute",) * len(names), features.su_names, su_joint
    )
    model = KinematicModel(tree, np.array(T), np.array(T_su))
    dof = [features.dof_names.index(n) for n in names]
    order = [[su.name for su in sim.truth.sus].index(n) for n in features.su_names]
    M = sim.truth.sensor_matrix[order]

    def predict(q: F64, dq: F64, qd: F64, qdd: F64, log: int) -> F64:
        del log
        beyond = beyond_first_order(
            model, q[dof], dq[:, dof], qd[:, dof], qdd[:, dof], -sim.truth.gravity_base
        )
        return np.einsum("uij,nuj->nui", M, beyond)

    return predict


def _axis_to_z(kind: str) -> F64:
    """Rotation that takes z to the axis of a Pinocchio joint."""
    if kind.endswith("Z"):
        return np.eye(3)
    if kind.endswith("Y"):
        return np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]).T[[0, 2, 1]] @ np.eye(3)
    raise NotImplementedError(kind)


def z_scores(sim: Simulation, features: Features) -> dict[str, F64]:
    """Errors over standard deviations of all coefficients that were measured, by kind."""
    truth = read_features(sim, features)
    D = features.n_dofs
    covariance = np.linalg.pinv(features.information, rcond=1e-9, hermitian=True)
    variance = np.einsum("puii->pui", covariance)[..., None] * features.noise[:, :, None] ** 2
    slope2 = truth[:, :, 1 : 1 + D] ** 2
    variance[:, :, 0] += np.einsum("pudi,pd->pui", slope2, features.position_sd**2)
    measured = np.einsum("puii->pui", features.information) > 0
    z = (features.coefficients - truth) / np.sqrt(np.where(variance > 0, variance, 1.0))
    rows = {"f0": slice(0, 1), "s": slice(1, 1 + D), "tau": slice(1 + D, None)}
    return {name: z[:, :, at][measured[:, :, at]] for name, at in rows.items()}


def rms(x: F64) -> float:
    return float(np.sqrt(np.mean(x**2)))


@pytest.mark.parametrize("options", CASES, ids=str)
def test_coefficients_agree_with_the_truth_within_their_deviations(options: dict[str, Any]) -> None:
    """With everything beyond first order predicted, errors are what the covariances say."""
    sim = simulation("panda", **options)
    features = calibrate(sim.recording).features
    for name, z in z_scores(sim, features).items():
        assert 0.75 < rms(z) < 1.35, name
        assert np.quantile(abs(z), 0.99) < 4.0, name
        assert abs(np.mean(z)) < 0.2, name
