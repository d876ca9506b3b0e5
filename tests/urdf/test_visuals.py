"""Rods lead to where the parts are, and three boxes are a hexagon."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skin2urdf.geometry.se3 import inverse
from skin2urdf.model.records import KinematicModel
from skin2urdf.urdf.visuals import COLOURS, link_shapes, su_shapes, thickness


def test_rods_lead_from_the_joint_to_all_it_carries(
    random_robot: Callable[..., KinematicModel],
) -> None:
    model = random_robot(np.random.default_rng(0))
    tree = model.tree
    for joint in range(-1, tree.n_joints):
        shapes = link_shapes(model, joint, thickness(model))
        rods = shapes[1:] if joint >= 0 else shapes
        half = [np.array([0, 0, rod.size[1] / 2]) for rod in rods]
        ends = [
            np.stack([rod.T_link_shape[:3, 3] + s * rod.T_link_shape[:3, :3] @ h for s in (-1, 1)])
            for rod, h in zip(rods, half, strict=True)
        ]
        carried = [*model.T_parent_joint[tree.parent == joint]]
        carried += [*model.T_joint_su[tree.su_joint == joint]]
        assert len(ends) == len(carried)
        children = int(np.sum(tree.parent == joint))
        bones = [np.linspace(start, end, 2001) for start, end in ends[:children]]
        skeleton = np.vstack([np.zeros((1, 3)), *bones])
        for i, ((start, end), T) in enumerate(zip(ends, carried, strict=True)):
            np.testing.assert_allclose(end, T[:3, 3], atol=1e-12)
            if i < children:
                np.testing.assert_allclose(start, 0, atol=1e-12)
            else:  # a stalk comes the shortest way
                gaps = np.linalg.norm(skeleton - end, axis=1)
                assert np.linalg.norm(end - start) <= gaps.min() + 1e-9
                assert np.linalg.norm(skeleton - start, axis=1).min() < 1e-3
        for rod in rods:
            np.testing.assert_allclose(np.linalg.det(rod.T_link_shape), 1)


def test_three_boxes_are_a_hexagon() -> None:
    side = 0.02
    points = np.random.default_rng(1).uniform(-0.025, 0.025, (4000, 3))
    points[:, 2] = 0
    boxed = np.zeros(len(points), bool)
    for box in su_shapes(side):
        assert box.colour in COLOURS
        T = inverse(box.T_link_shape)
        local = points @ T[:3, :3].T + T[:3, 3]
        boxed |= (np.abs(local) <= box.size / 2).all(axis=1)
    turns = np.deg2rad(30 + 60 * np.arange(6))
    normals = np.stack([np.cos(turns), np.sin(turns), np.zeros(6)])
    hexagon = (points @ normals <= side * np.sqrt(3) / 2).all(axis=1)
    np.testing.assert_array_equal(boxed, hexagon)


def test_thickness_fits_the_robot(random_robot: Callable[..., KinematicModel]) -> None:
    model = random_robot(np.random.default_rng(2))
    assert 0.004 <= thickness(model) <= 0.04
    point = random_robot(np.random.default_rng(2), parent=(), su_joint=())
    assert thickness(point) == 0.02
