"""Random robots and an independent forward kinematics for the tests of URDF in and out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skin2urdf.model.records import KinematicModel
from skin2urdf.structure.records import KinematicTree


def _transforms(rng: np.random.Generator, n: int) -> np.ndarray:
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.random(n, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-0.3, 0.3, (n, 3))
    return T


@pytest.fixture(scope="session")
def random_robot() -> Callable[..., KinematicModel]:
    """A function (rng, parents, SU joints, prismatic joints) -> robot with random placements."""

    def make(
        rng: np.random.Generator,
        parent: tuple[int, ...] = (-1, 0, 1, 2, 2),
        su_joint: tuple[int, ...] = (-1, 0, 1, 2, 3, 4, 4),
        prismatic: tuple[int, ...] = (2,),
    ) -> KinematicModel:
        n = len(parent)
        tree = KinematicTree(
            joint_names=tuple(f"joint_{j}" for j in range(n)),
            parent=np.array(parent),
            joint_types=tuple("prismatic" if j in prismatic else "revolute" for j in range(n)),
            su_names=tuple(f"su_{u}" for u in range(len(su_joint))),
            su_joint=np.array(su_joint),
        )
        return KinematicModel(tree, _transforms(rng, n), _transforms(rng, len(su_joint)))

    return make


@pytest.fixture(scope="session")
def su_poses() -> Callable[[KinematicModel, np.ndarray], np.ndarray]:
    """A function (model, q) -> (U, 4, 4) SU poses in the base frame, by plain products."""

    def poses(model: KinematicModel, q: np.ndarray) -> np.ndarray:
        T_base_joint = []
        for j, parent in enumerate(model.tree.parent):
            motion = np.eye(4)
            if model.tree.joint_types[j] == "prismatic":
                motion[2, 3] = q[j]
            else:
                motion[:3, :3] = Rotation.from_rotvec([0, 0, q[j]]).as_matrix()
            T_base_parent = np.eye(4) if parent < 0 else T_base_joint[parent]
            T_base_joint.append(T_base_parent @ model.T_parent_joint[j] @ motion)
        T_base_joint.append(np.eye(4))
        return np.stack([T_base_joint[j] for j in model.tree.su_joint]) @ model.T_joint_su

    return poses
