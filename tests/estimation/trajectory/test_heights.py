"""A robot rises as a whole along its first axis."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from synthetic import random_state, serial_tree

from skin2urdf.estimation.problem.state import Step, moved
from skin2urdf.estimation.trajectory.heights import rise
from skin2urdf.model.kinematics import to_pinocchio


@pytest.mark.parametrize(("seed", "prismatic"), [(1, ()), (2, (1,)), (3, (2,))])
def test_all_that_joints_carry_rises_alike(seed: int, prismatic: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    tree = serial_tree(4, prismatic)
    state = random_state(rng, tree)
    joints, sus = rise(tree, state)
    assert np.linalg.norm(joints) == pytest.approx(1.0)
    far = 0.2
    step = np.zeros((tree.n_sus, 15))
    step[:, :3] = far * sus
    up = moved(state, Step(far * joints, np.zeros((0, 2)), step))
    shifts = []
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, tree.n_joints)
        places = []
        for each in (state, up):
            model = to_pinocchio(each.model(tree))
            data = model.createData()
            pin.framesForwardKinematics(model, data, q)
            places.append([data.oMf[model.getFrameId(su)].translation for su in tree.su_names])
        shifts.append(np.array(places[1]) - np.array(places[0]))
    along = state.T_parent_joint[0, :3, 2]
    size = float(np.linalg.norm(shifts[0][0]))
    assert size >= far
    expected = np.broadcast_to(size * along, (3, tree.n_sus, 3))
    np.testing.assert_allclose(shifts, expected, atol=1e-9)
