"""A robot that is known before: derivatives of what may deviate, and the prior on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import RATE, sampled_trajectory

from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.blueprint import Blueprint
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.geometry.se3 import exp
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.structure.records import KinematicTree


@pytest.fixture(scope="module")
def problem() -> tuple[MotionProblem, MotionState]:
    rng = np.random.default_rng(3)
    tree = KinematicTree(
        ("a", "b", "c"),
        np.array([-1, 0, 1]),
        ("revolute", "prismatic", "revolute"),
        ("u", "v"),
        np.array([2, 1]),
    )
    T = exp(rng.normal(0, 0.4, (3, 6)))
    state = State(
        T_parent_joint=T,
        T_joint_su=exp(rng.normal(0, 0.2, (2, 6))),
        up=frame_with_z(np.array([0.1, -0.2, 0.97]) / np.linalg.norm([0.1, -0.2, 0.97]))[
            None, :, 2
        ],
        bias=np.zeros((2, 3)),
        shape=np.zeros((2, 6)),
    )
    t = np.arange(600) / RATE
    q = 0.4 * np.sin(2 * np.pi * np.array([0.2, 0.15, 0.3]) * t[:, None] + np.arange(3))
    nothing = np.zeros((len(t), 2, 3))
    log = sampled_trajectory(q, nothing, rates=nothing)
    deviations = np.full((3, 6), 1e-2)
    expected = Blueprint(T @ exp(rng.normal(0, 1e-3, (3, 6))), deviations, state.up[0], 0.05)
    priors = motion_priors(Priors(), gravity=0.02, front=(np.zeros(2), np.full(2, 6e-5)))
    problem = MotionProblem(tree, [log], replace(priors, blueprint=expected))
    begin = MotionState(
        placements=state, gravity=9.81, front=np.full((2, 2), 3e-5), clock=np.zeros((1, 2, 2)),
        knots=(np.zeros((0, 2, 3)),), unseen=np.zeros(0), gyro=np.zeros((2, 14)),
    )  # fmt: skip
    return problem, begin


def test_what_may_deviate_has_exact_derivatives(
    problem: tuple[MotionProblem, MotionState],
) -> None:
    trouble, state = problem
    layout = trouble.layout
    assert layout.n_further == 8
    predicted = (trouble.predict(state, 0),)
    weights = (np.ones((len(trouble.logs[0].kept), 2, 6)),)
    equations = trouble.equations(state, predicted, weights)
    gradient = equations.joint_gradient
    step = 1e-6
    for i in range(layout.further.start, layout.further.stop):
        x = np.zeros(layout.n_joint)
        x[i] = step
        slope = np.zeros(layout.n_joint)
        up, down = (
            trouble.layout.moved(state, sign * x, np.zeros((2, layout.n_su))) for sign in (1, -1)
        )
        chi2 = [_chi2(trouble, there) for there in (up, down)]
        slope[i] = -(chi2[0] - chi2[1]) / (4 * step)
        # Derivatives take the low-pass of the prediction as exact, as all others do.
        assert gradient[i] == pytest.approx(slope[i], rel=5e-3, abs=1.5)


def test_what_is_kept_does_not_move(problem: tuple[MotionProblem, MotionState]) -> None:
    trouble, _ = problem
    expected = trouble.priors.blueprint
    assert expected is not None
    kept = replace(trouble.priors, blueprint=replace(expected, deviations=np.zeros((3, 6)), tilt=0))
    again = MotionProblem(trouble.tree, trouble.logs, kept)
    layout = again.layout
    assert not again.free_joint[layout.joints].any()
    assert not again.free_joint[layout.further].any()


def _chi2(problem: MotionProblem, state: MotionState) -> float:
    """Sum of squares of what is left of readings and rates, priors included."""
    there = problem.predict(state, 0)
    assert there.turned is not None
    data = float((there.residual**2).sum()) + float((there.turned.residual**2).sum())
    return data + problem.prior_chi2(state)
