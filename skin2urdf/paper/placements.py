"""The paper's parameters as placements, and any model as the paper's parameters.

The parameters leave open how each limb's first DoF sits on the reference segment, and yaw and
offset along that DoF (II-C.5). Placements need a choice, and two lists of parameters can be
compared only after the same choice was made for both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.start.orientation import su_orientation
from skin2urdf.geometry.dh import dh_of_placement
from skin2urdf.geometry.se3 import inverse, placement, screw
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.model.canonical import canonical
from skin2urdf.model.records import KinematicModel
from skin2urdf.paper.model import link_transform, su_transform
from skin2urdf.structure.records import KinematicTree

_DETERMINED_SINE = 1e-6
"""Sine of the angle between gravity and an axis below which the yaw about it is left at 0."""
_PARALLEL_SINE = 1e-9
"""Only axes parallel to rounding leave the paper's form of the parameters."""


@dataclass(frozen=True, eq=False)
class DhTable(Record):
    """A robot as the paper prints it (Fig. 6).

    Attributes:
        model: the robot in the frames of these parameters.
        links: (D, 4) theta0, d, a, alpha from each joint's parent joint to it (eq. 5), a >= 0;
            zeros for joints on the RS.
        sus: (U, 6) theta0, d, a, alpha, theta_acc, d_acc (eq. 5, 7), a >= 0.
    """

    model: KinematicModel
    links: F64
    sus: F64


def dh_table(model: KinematicModel, theta0: float = 0.0, d: float = 0.0) -> DhTable:
    """Extended DH parameters of a model, with the arbitrary two of every limb given.

    Args:
        model: the robot.
        theta0: what theta0_1 shall be: that of the first joint behind each first DoF [rad].
        d: what d_1 shall be [m].
    """
    tree, model = model.tree, canonical(model, _PARALLEL_SINE)
    T_joint, T_su = np.array(model.T_parent_joint), np.array(model.T_joint_su)
    for root in np.flatnonzero(tree.parent < 0):
        behind = np.flatnonzero(tree.parent == root)
        if not behind.size:
            continue
        first = dh_of_placement(T_joint[behind[0]], _PARALLEL_SINE)
        shift = screw("z", theta0 - first.theta0, d - first.d)
        on_root = tree.su_joint == root
        T_joint[behind], T_su[on_root] = shift @ T_joint[behind], shift @ T_su[on_root]
        T_joint[root] = T_joint[root] @ inverse(shift)
    joints, sus = dh_of_placement(T_joint, _PARALLEL_SINE), dh_of_placement(T_su, _PARALLEL_SINE)
    links = np.stack([joints.theta0, joints.d, joints.a, joints.alpha], axis=1)
    links[tree.parent < 0] = 0.0
    return DhTable(
        replace(model, T_parent_joint=T_joint, T_joint_su=T_su),
        links,
        np.stack([sus.theta0, sus.d, sus.a, sus.alpha, sus.turn, sus.shift], axis=1),
    )


def placements(
    tree: KinematicTree,
    blocks: FeatureBlocks,
    links: F64,
    sus: F64,
    gravity: F64,
    gravity_size: float,
) -> State:
    """Parameters of the paper as placements below a base whose z axis is up.

    Args:
        tree: D joints and U SUs.
        blocks: features; readings of SUs on the RS give their orientation.
        links: (D, 4) parameters of the links, of any value for joints on the RS.
        sus: (U, 6) parameters of the SUs, of any value for SUs on the RS.
        gravity: (U, G, 3) mean gravity of each SU in reference coordinates per log (eq. 16); NaN
            where an SU has no readings.
        gravity_size: magnitude of gravity [m/s^2].

    Returns:
        A state in which the yaws about each limb's first DoF are such that gravity has the same
        direction for all SUs.
    """
    T_joint, T_su = link_transform(links), su_transform(sus)
    ups: list[F64] = []
    for root in np.flatnonzero(tree.parent < 0):
        # On the first segment sit SUs and the joints that carry everything else.
        own, behind = np.flatnonzero(tree.su_joint == root), np.flatnonzero(tree.parent == root)
        groups = [[int(u)] for u in own] + [_sus_behind(tree, int(j)) for j in behind]
        means = np.array([_mean_of_known(gravity[group]) for group in groups])
        weights = np.array([float(len(group)) for group in groups])
        reference, yaws = _aligned(means, weights)
        turns = screw("z", yaws, 0.0)
        T_su[own] = turns[: len(own)] @ T_su[own]
        T_joint[behind] = turns[len(own) :] @ T_joint[behind]
        R_base_first = frame_with_z(reference[0]).T
        T_joint[root] = placement(R_base_first, np.zeros(3))
        ups.append(reference @ R_base_first.T)
    n_logs = gravity.shape[1]
    up = np.mean(ups, axis=0) if ups else np.tile([0.0, 0.0, 1.0], (n_logs, 1))
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    for su in np.flatnonzero(tree.su_joint < 0):
        no_axes, priors = np.zeros((0, 3)), Priors(gravity=gravity_size)
        R, *_ = su_orientation(blocks, int(su), no_axes, np.zeros(0, bool), up, priors)
        T_su[su] = placement(R, np.zeros(3))
    U = tree.n_sus
    return State(T_joint, T_su, up, np.zeros((U, 3)), np.zeros((U, 6)))


def _sus_behind(tree: KinematicTree, joint: int) -> list[int]:
    """SUs that a joint moves."""
    return [u for u, j in enumerate(tree.su_joint) if joint in tree.chain(int(j))]


def _mean_of_known(vectors: F64) -> F64:
    """(G, 3) mean of vectors (n, G, 3) over those without NaN; NaN where there are none."""
    known = np.isfinite(vectors).all(axis=-1, keepdims=True)
    count = known.sum(axis=0)
    total = np.where(known, vectors, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _aligned(means: F64, weights: F64) -> tuple[F64, F64]:
    """Turn mean gravities about the first DoF's axis z onto each other.

    Args:
        means: (n, G, 3) mean gravity of each group and log; NaN where a group has none.
        weights: (n,) number of SUs in each group.

    Returns:
        (G, 3) unit vectors of the common gravity and (n,) turns about z [rad]; 0 where gravity
        lies along the axis and leaves the turn open.
    """
    sine = np.linalg.norm(means[..., :2], axis=-1)
    log = int(np.argmax(np.where(np.isfinite(sine), sine, 0.0).mean(axis=0)))
    flat = means[:, log]
    open_ = ~(sine[:, log] > _DETERMINED_SINE)
    yaws = np.where(open_, 0.0, -np.arctan2(flat[:, 1], flat[:, 0]))
    turned = (screw("z", yaws, 0.0)[:, None, :3, :3] @ means[..., None])[..., 0]
    common = np.nansum(turned * weights[:, None, None], axis=0)
    return common / np.linalg.norm(common, axis=1, keepdims=True), yaws
