"""Read an emitted URDF back, the way its users will, before it replaces an older one."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.model.poses import su_poses
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.names import BASE_LINK, urdf_names

TOLERANCE = 1e-9
"""Largest difference of any entry of an SU's pose [m, 1]."""
_CONFIGURATIONS = 3


class InconsistentUrdfError(Skin2UrdfError):
    """A URDF that does not say what the model says: a defect of this package."""

    def __init__(self, what: str) -> None:
        super().__init__(
            f"the URDF does not hold the robot that was found: {what}",
            "nothing was written; please report this with the log, it is a defect of skin2urdf",
        )


def check_urdf(text: str, model: KinematicModel, rng: np.random.Generator | None = None) -> None:
    """Make sure that a URDF reads back as the model it was made of.

    yourdfpy validates it and Pinocchio loads it. In both, every SU must be where the model has
    it, at random joint positions; the model's own kinematics are products of transforms.

    Args:
        text: the URDF.
        model: what it should hold.
        rng: source of the joint positions; a fixed one by default.

    Raises:
        InconsistentUrdfError: it does not.
    """
    rng = rng or np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, (_CONFIGURATIONS, model.tree.n_joints))
    expected = su_poses(model, q)
    for reader in (_by_pinocchio, _by_yourdfpy):
        name = reader.__name__.removeprefix("_by_")
        try:
            read = reader(text, model, q)
        except InconsistentUrdfError:
            raise
        except Exception as error:
            raise InconsistentUrdfError(f"{name} can not load it ({error})") from error
        error_size = float(np.max(np.abs(np.array(read) - expected), initial=0.0))
        if not error_size <= TOLERANCE:
            raise InconsistentUrdfError(f"{name} has SUs {error_size:.1e} away from the model's")


def _by_pinocchio(text: str, model: KinematicModel, q: F64) -> list[list[Any]]:
    """SU poses (C, U, 4, 4) as Pinocchio reads them."""
    import pinocchio as pin

    loaded = pin.buildModelFromXML(text)
    data = loaded.createData()
    if sorted(loaded.names[1:]) != sorted(model.tree.joint_names):
        raise InconsistentUrdfError("Pinocchio finds other joints")
    joints = [loaded.joints[loaded.getJointId(n)] for n in model.tree.joint_names]
    frames = [loaded.getFrameId(n, pin.FrameType.BODY) for n in urdf_names(model.tree).su_links]
    poses = []
    for row in q:
        configuration = pin.neutral(loaded)
        for joint, position in zip(joints, row, strict=True):
            endless = joint.nq == 2
            value = (np.cos(position), np.sin(position)) if endless else position
            configuration[joint.idx_q : joint.idx_q + joint.nq] = value
        pin.framesForwardKinematics(loaded, data, configuration)
        poses.append([data.oMf[frame].homogeneous for frame in frames])
    return poses


def _by_yourdfpy(text: str, model: KinematicModel, q: F64) -> list[list[Any]]:
    """SU poses (C, U, 4, 4) as yourdfpy reads them, which validates the file as well."""
    from yourdfpy import URDF

    loaded = URDF.load(io.BytesIO(text.encode()), load_meshes=False, build_scene_graph=False)
    if not loaded.validate():
        raise InconsistentUrdfError(f"yourdfpy complains: {'; '.join(map(str, loaded.errors))}")
    sus = urdf_names(model.tree).su_links
    poses: list[list[Any]] = [[] for _ in q]
    for first in range(0, len(sus), _TOGETHER):
        some = sus[first : first + _TOGETHER]
        robot = URDF(_with_some(loaded.robot, set(sus) - set(some)), load_meshes=False)
        for row, found in zip(q, poses, strict=True):
            robot.update_cfg(dict(zip(model.tree.joint_names, map(float, row), strict=True)))
            found += [robot.get_transform(link, BASE_LINK) for link in some]
    return poses


_TOGETHER = 64
"""SUs whose poses are asked for at once: yourdfpy looks through all links for each of them, which
takes 80 s for a thousand at once and 1 s for them in parts."""


def _with_some(robot: Any, without: set[str]) -> Any:
    """A robot of yourdfpy without some links, which carry nothing, and without any shapes."""
    return replace(
        robot,
        links=[
            replace(link, visuals=[], collisions=[])
            for link in robot.links
            if link.name not in without
        ],
        joints=[joint for joint in robot.joints if joint.child not in without],
    )
