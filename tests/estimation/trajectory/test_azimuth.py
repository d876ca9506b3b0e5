"""A robot turns as a whole, with all that stands beside it on its base."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from synthetic import random_state, serial_tree

from skin2urdf.estimation.problem.state import Step, moved
from skin2urdf.estimation.trajectory.azimuth import turned
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.model.kinematics import to_pinocchio


@pytest.mark.parametrize("prismatic", [(), (1,), (2,)])
def test_all_that_stands_on_a_base_turns_alike(prismatic: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    chain = serial_tree(4, prismatic)
    names = (*chain.su_names, "base")
    tree = replace(chain, su_names=names, su_joint=np.append(chain.su_joint, -1))
    state = random_state(rng, tree)
    # The base's frame is on the first axis.
    T = np.array(state.T_parent_joint)
    T[0, :3, 3] = 0.0
    state = replace(state, T_parent_joint=T)
    axis, angle = np.array([0.48, 0.6, 0.64]), 1e-5
    joints, sus = turned(tree, state, axis)
    step = np.zeros((tree.n_sus, 15))
    step[:, :6] = angle * sus
    after = moved(state, Step(angle * joints, np.zeros((0, 2)), step))
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, tree.n_joints)
        frames = []
        for each in (state, after):
            model = to_pinocchio(each.model(tree))
            data = model.createData()
            pin.framesForwardKinematics(model, data, q)
            frames.append([data.oMf[model.getFrameId(su)].homogeneous for su in tree.su_names])
        turn = np.eye(4)
        turn[:3, :3] = rotation_exp(angle * axis)
        np.testing.assert_allclose(frames[1], turn @ np.array(frames[0]), atol=1e-9)
