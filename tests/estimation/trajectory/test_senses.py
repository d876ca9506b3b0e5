"""A vertical joint alone is found in its own sense, from a start in either."""

from __future__ import annotations

import numpy as np
import pytest
from joint_paths import FINE, JointPath
from mujoco_robot import random_arm, record, upright
from synthetic import RATE, sampled_trajectory, stays

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.senses import mirrored, turned_round
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.structure.records import KinematicTree

_LEVERS = np.array([[0.04, 0.0, 0.1], [-0.01, 0.05, 0.1]])
_PLACES = np.array([[-0.8], [0.9], [-0.2], [1.2], [-1.1], [0.4]])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_what_pulls_towards_the_axis_tells_which_way_a_vertical_joint_turns(side: float) -> None:
    rng = np.random.default_rng(5)
    q = stays(_PLACES, 100, 80)
    qd = np.gradient(q[:, 0], 1 / RATE)
    qdd = np.gradient(qd, 1 / RATE)
    # Seen from the link, which turns about z: along the tangent, towards the axis, and gravity.
    tangent = np.cross((0.0, 0.0, 1.0), _LEVERS)
    towards = -_LEVERS * (1.0, 1.0, 0.0)
    read = qdd[:, None, None] * tangent + (qd**2)[:, None, None] * towards
    read = read + (0.0, 0.0, 9.81) + 7e-3 * rng.standard_normal(read.shape)
    tree = KinematicTree(("pan",), np.array([-1]), ("revolute",), ("one", "two"), np.array([0, 0]))
    start = np.tile(np.eye(4), (2, 1, 1))
    start[:, :3, 3] = side * _LEVERS
    axis = np.diag([1.0, side, side, 1.0])
    if side < 0:
        start[:, 1:3, :3] *= -1.0
        start[:, :2, 3] *= (1.0, -1.0)
    begin = State(
        axis[None], start, np.array([[0.0, 0.0, 1.0]]), np.zeros((2, 3)), np.zeros((2, 6))
    )
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    log = sampled_trajectory(q, read, still_below=1e-3)
    found = estimate_along([log], tree, begin, priors, np.zeros(2)).fitted.state.placements
    sense = found.T_parent_joint[0, 2, 2]
    assert sense == pytest.approx(1.0, abs=1e-2)
    levers = np.einsum("uji,uj->ui", found.T_joint_su[:, :3, :3], found.T_joint_su[:, :3, 3])
    assert levers[:, :2] == pytest.approx(_LEVERS[:, :2], abs=2e-3)


@pytest.mark.parametrize("as_mirror_image", [False, True])
def test_slow_moves_tell_which_way_a_first_joint_turns_that_carries_others(
    as_mirror_image: bool,
) -> None:
    rng = np.random.default_rng(3)
    arm = upright(random_arm(3, 3))
    t = np.arange(0.0, 40.0, 1 / FINE)[:, None]
    waves = [
        rng.uniform(0.2, 0.5, 3) * np.sin(rng.uniform(0.3, 1.6, 3) * t + rng.uniform(0, 6, 3))
        for _ in range(3)
    ]
    path = JointPath([0.0] * 3).follow(sum(waves) * np.minimum(1.0, t / 4) ** 2)
    names = [f"skin_{n}" for n in range(4)], [f"motor_{n}" for n in range(3)]
    along = calibrate(record(arm, path, *names, rng)).along
    assert along is not None
    tree, logs = along.problem.tree, along.problem.logs
    q = np.concatenate([log.q for log in logs]).mean(axis=0)
    start = turned_round(tree, along.state, (0,), q)
    if as_mirror_image:
        start = mirrored(tree, along.state, 0, logs)
    found = estimate_along(logs, tree, start, along.problem.priors, np.zeros(4))
    assert not found.causes
    senses = [each.state.T_parent_joint[0, :3, 2] for each in (along, found)]
    assert senses[0] @ senses[1] > 0.99
    assert are_plausible(found.state).all()
