"""Many SUs on a link, worked out by a few points of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic import random_state, sampled_trajectory, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Equations
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen

_JOINTS = (1, 2, 1, 2, -1, 2, 2, 2, 2, 2, 2, 2, 0)
"""The joint of each SU: nine on the last link, two on the one before, one on the base."""


def test_an_su_among_many_is_what_it_is_alone() -> None:
    rng = np.random.default_rng(0)
    tree = replace(
        serial_tree(3, prismatic=(1,)),
        su_names=tuple(f"su{u}" for u in range(len(_JOINTS))),
        su_joint=np.array(_JOINTS),
    )
    t = np.arange(600)[:, None] / 125
    q = 0.5 * np.sin(2 * np.pi * np.array([0.7, 1.1, 1.6]) * t + rng.uniform(0, 6, 3))
    U = len(_JOINTS)
    logs = [sampled_trajectory(q + g, rng.standard_normal((600, U, 3))) for g in range(2)]
    state = MotionState(
        placements=random_state(rng, tree, 2),
        gravity=9.8,
        front=np.abs(rng.standard_normal((U, 2))) * [4e-5, 1e-5],
        clock=1e-3 * rng.standard_normal((2, U, 2)) * [1.0, 0.1],
        knots=(rng.standard_normal((3, U, 3)), np.zeros((0, U, 3))),
        unseen=1e-3 * rng.standard_normal(2),
        gyro=np.zeros((U, 0)),
    )
    priors = motion_priors(Priors(), gravity=0.02, front=(np.zeros(2), np.full(2, 6e-5)))
    priors = replace(priors, bias_walk=1e-3, unseen=np.ones(2))
    # What encoders do not see, of a joint and of the base.
    unseen = Unseen(np.array([2, 6]), tuple(q[:, :2] ** 2 for _ in logs))
    all_at_once = MotionProblem(tree, logs, priors, [3, 0], unseen)
    predicted = [all_at_once.predict(state, g) for g in range(2)]
    weights = [rng.uniform(1, 2, p.residual.shape) for p in predicted]
    whole = all_at_once.equations(state, predicted, weights)
    joint, gradient = _of_data(all_at_once, state, whole)
    left = [np.where(p.measured[..., None], p.residual, 0.0) for p in predicted]
    pulls = [w * r for w, r in zip(weights, left, strict=True)]
    ((pulled, _),) = all_at_once.gradients(state, predicted, [pulls])
    seen_by_encoders = np.delete(np.arange(len(gradient)), all_at_once.layout.unseen)
    np.testing.assert_allclose(
        pulled[seen_by_encoders], gradient[seen_by_encoders], atol=1e-9 * np.abs(gradient).max()
    )
    for u in range(U):
        places = state.placements
        mine = replace(
            state,
            placements=replace(
                places,
                T_joint_su=places.T_joint_su[[u]],
                bias=places.bias[[u]],
                shape=places.shape[[u]],
            ),
            front=state.front[[u]],
            clock=state.clock[:, [u]],
            knots=tuple(k[:, [u]] for k in state.knots),
            gyro=np.zeros((1, 0)),
        )
        alone = MotionProblem(
            replace(tree, su_names=tree.su_names[u : u + 1], su_joint=tree.su_joint[[u]]),
            [replace(log, readings=log.readings[:, [u]], valid=log.valid[:, [u]]) for log in logs],
            priors,
            [3, 0],
            unseen,
        )
        seen = [alone.predict(mine, g) for g in range(2)]
        for one, other in zip(seen, predicted, strict=True):
            np.testing.assert_allclose(one.residual[:, 0], other.residual[:, u], atol=1e-9)
        part = alone.equations(mine, seen, [w[:, [u]] for w in weights])
        for name in ("su", "mixed", "su_gradient"):
            expected, found = getattr(part, name)[0], getattr(whole, name)[u]
            assert np.abs(found - expected).max() < 1e-9 * max(np.abs(expected).max(), 1.0)
        of_one, pull = _of_data(alone, mine, part)
        joint -= of_one
        gradient -= pull
    assert np.abs(joint).max() < 1e-9 * np.abs(whole.joint).max()
    assert np.abs(gradient).max() < 1e-9 * np.abs(whole.joint_gradient).max()


def _of_data(problem: MotionProblem, state: MotionState, found: Equations) -> tuple[F64, F64]:
    """(J, J) and (J,) what readings say of the joint part, without what is known before."""
    none = [np.zeros((len(log.kept), problem.tree.n_sus, 3)) for log in problem.logs]
    predicted = [problem.predict(state, g) for g in range(len(problem.logs))]
    before = problem.equations(state, predicted, none)
    return found.joint - before.joint, found.joint_gradient - before.joint_gradient
