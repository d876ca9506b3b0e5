"""Covariances of joint placements, brought from the estimation's frames to those of a model."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import JOINT_COORDINATES
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.observability import Observability
from skin2urdf.geometry.se3 import adjoint


def joint_placement_covariance(estimate: Estimate, found: Observability, T_model_joint: F64) -> F64:
    """Covariances of the joints' placements in the frames of a model.

    The estimation's frame of a joint lies elsewhere on the same axis, and is turned about it; a
    tilt of the axis moves the model's origin by the tilt times that distance.

    Args:
        estimate: the estimate.
        found: what it determines.
        T_model_joint: (D, 4, 4) the estimation's joint frames in those of a model that has other
            frames on the same axes, such as those of extended DH.

    Returns:
        (D, 6, 6) of twists (linear [m], angular [rad]) in the model's frame of each joint,
        ``T_parent_joint exp(xi)``. Sliding along the axis and turning about it are conventions and
        have none; nor has the place of an axis on the RS, or of a prismatic one.
    """
    placed = estimate.free.joints[:, 0]
    moved = adjoint(T_model_joint)
    moved[:, :3, 3:] *= placed[:, None, None]
    columns = moved[..., JOINT_COORDINATES]
    return np.asarray(columns @ found.joint_covariance @ np.swapaxes(columns, 1, 2))
