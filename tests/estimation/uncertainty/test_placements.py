"""Covariances of joint placements, held against placements that are really moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from calibrated import calibration
from scipy.linalg import logm

from skin2urdf.estimation.problem.state import joint_motion
from skin2urdf.estimation.uncertainty.placements import joint_placement_covariance


def test_a_moved_axis_is_the_twist_that_the_covariance_speaks_of() -> None:
    """A covariance of rank one, ``x x^T``, must become that of the twist which x causes."""
    fit, found, model = (
        calibration().estimate,
        calibration().observability,
        calibration().model,
    )
    D = model.tree.n_joints
    x = 1e-6 * np.random.default_rng(0).standard_normal((D, 4)) * fit.free.joints
    given = np.einsum("di,dj->dij", x, x)
    given_found = replace(found, joint_covariance=given)
    got = joint_placement_covariance(fit, given_found, calibration().T_canonical_joint)
    change, _ = joint_motion(x)
    T_model_estimated = np.eye(4)
    for j in range(D):
        estimated = T_model_estimated @ fit.state.T_parent_joint[j]
        T_model_estimated = np.linalg.solve(model.T_parent_joint[j], estimated)
        moved = np.linalg.solve(model.T_parent_joint[j], estimated @ change[j])
        twist = logm(moved @ np.linalg.inv(T_model_estimated)).real
        xi = np.array([*twist[:3, 3], twist[2, 1], twist[0, 2], twist[1, 0]])
        if not fit.free.joints[j, 0]:
            xi[:3] = 0.0  # the place of an axis on the RS is a free choice
        np.testing.assert_allclose(got[j], np.outer(xi, xi), atol=1e-16)
        assert np.abs(got[j]).max() > 1e-14


def test_sliding_along_and_turning_about_the_axis_have_no_variance() -> None:
    got = joint_placement_covariance(
        calibration().estimate, calibration().observability, calibration().T_canonical_joint
    )
    assert (np.abs(got[:, [2, 5]]) < 1e-15).all()
    assert (np.abs(got[0, :3]) == 0).all()
    assert (np.linalg.eigvalsh(got) > -1e-15).all()
