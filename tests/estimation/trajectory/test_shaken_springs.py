"""What springs make of the noise of encoders is what it does to their motion."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from random_robots import Joint, robot_of

from skin2urdf import calibrate
from skin2urdf.arrays import F64
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.balance import balanced, bending
from skin2urdf.estimation.trajectory.bending import Bending
from skin2urdf.estimation.trajectory.fit import Fitted, held, shaken_by
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.rounded import drawn_anew
from skin2urdf.estimation.trajectory.slack import with_unseen
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout

ARM = (
    Joint("first", -1, "revolute", rpy=(1.2, 0.3, 0.0)),
    Joint("second", 0, "revolute", xyz=(0.3, 0.0, 0.1), rpy=(1.4, 0.0, 0.0)),
    Joint("slide", 1, "prismatic", xyz=(0.1, 0.0, 0.0), rpy=(0.9, 0.2, 0.0)),
    Joint("third", 2, "revolute", xyz=(0.4, 0.0, 0.0), rpy=(0.2, 0.5, 0.0)),
)

N_DRAWS = 6


@pytest.fixture(scope="module")
def rigid(tmp_path_factory: pytest.TempPathFactory) -> tuple[MotionProblem, Fitted]:
    """The fit of an arm with coarse encoders and no springs."""
    settings = SimulationSettings(
        n_poses=4, seed=5, excite="all", encoder_bits=13, imu_rate=250.0, joint_rate=125.0
    )
    robot = robot_of(ARM, tmp_path_factory.mktemp("arm"), SkinLayout(1, sus_on_base=0))
    recording = simulate(robot, settings).recording
    along = calibrate(recording, CalibrationSettings(gravity_deviation=0.0)).along
    assert along is not None
    stiff = along.problem.stiff()
    return stiff, held(stiff, replace(along.fitted.state, unseen=np.zeros(0)))


def _bends(problem: MotionProblem, fitted: Fitted, x: F64 | None, *, base: bool) -> Bending:
    """Joints or a base that yield, about numbers drawn at random or these of the loads."""
    state, logs = fitted.state, problem.logs
    bends = bending(problem.tree, logs, state.placements, state.gravity, joints=not base, base=base)
    if x is None:
        drawn = np.random.default_rng(0).normal(size=bends.n_numbers)
        return bends.about(0.05 * bends.spread * drawn)
    numbers = np.zeros(bends.n_numbers)
    numbers[: len(x)] = x
    return bends.about(numbers)


@pytest.mark.parametrize("base", [False, True])
def test_slopes_are_those_of_differences(
    rigid: tuple[MotionProblem, Fitted], *, base: bool
) -> None:
    problem, fitted = rigid
    bends = _bends(problem, fitted, None, base=base)
    S = bends.n_numbers
    still = tuple(np.zeros((len(log.q), S)) for log in problem.logs)
    bends = replace(bends, number=np.arange(S), joint=np.zeros(S, dtype=np.int64), motions=still)
    # One number stands for the scale of all, and is held.
    scale = 3
    all_but = replace(bends, number=np.delete(np.arange(S), scale), joint=np.zeros(S - 1, int))
    x = bends.origin + 0.02 * bends.spread * np.random.default_rng(1).normal(size=S)
    state = replace(fitted.state, unseen=x, front=np.tile([2e-5, 1e-5], (len(ARM), 1)))
    about = with_unseen(problem, bends, 1.0)
    shaken = shaken_by(about, state, fitted.weights)
    slopes = shaken.pull(about, state)[0][about.layout.unseen]
    without = with_unseen(problem, all_but, 1.0)
    assert shaken.pull(without, state)[0][without.layout.unseen][scale] == 0.0
    last = bends.of_inertia.stop
    for n in range(S):
        h = 1e-5 * bends.spread[n] * (np.arange(S) == n)
        ahead, behind = (
            shaken.cut_off(replace(state, unseen=each), bends) for each in (x + h, x - h)
        )
        # Where the base turns about is taken to be known.
        slope = (ahead - behind) / (2 * h[n]) if n < last else 0.0
        assert slopes[n] == pytest.approx(-0.5 * slope, rel=1e-4, abs=1e-6 * np.abs(slopes).max())


@pytest.mark.parametrize("load", [8e-3, -8e-3])
@pytest.mark.parametrize("base", [False, True])
def test_noise_swings_along_as_deflections_do(
    rigid: tuple[MotionProblem, Fitted], load: float, *, base: bool
) -> None:
    """Deflections are in balance with their loads along positions that are rounded anew."""
    problem, fitted = rigid
    bends = _bends(problem, fitted, np.array([load]), base=base)
    (log,), state = problem.logs, replace(fitted.state, unseen=bends.origin)

    def felt(log: Trajectory, *, bent: bool) -> F64:
        """(K, U, 3) what is predicted along positions."""
        if not bent:
            return problem.again(logs=[log]).predict(fitted.state, 0).residual
        places, gravity = state.placements, state.gravity
        there = balanced(bends, problem.tree, [log], places, gravity, bends.origin).deflections
        assert there.holds
        about = MotionProblem(problem.tree, [log], problem.priors, problem.layout.n_knots, there)
        return about.predict(state, 0).residual

    left = np.zeros((2, problem.tree.n_sus))
    for (off,) in islice(drawn_anew([log]), N_DRAWS):
        for which, bent in enumerate((False, True)):
            more = felt(log.with_joints_off(off), bent=bent) - felt(log, bent=bent)
            left[which] += np.einsum("kuc,kuc->u", fitted.weights[0], more**2)
    about = with_unseen(problem, bends, 1.0)
    (of_rigid,) = shaken_by(problem, fitted.state, fitted.weights).of_logs
    (made,) = shaken_by(about, state, fitted.weights).of_logs
    assert made.springs is not None
    counts = made.springs.counts([bends], [bends.origin])
    of_springs = np.einsum("fd,fud->u", made.power, counts)
    of_none = np.einsum("fd,ud->u", made.power, made.springs.of_rigid)
    np.testing.assert_allclose(made.chi2.sum(axis=0), of_rigid.chi2.sum(axis=0))
    # Noise turns links in gravity as well, with springs or without.
    seen = (left[1] - left[0]) / N_DRAWS
    expected = (of_springs / of_none - 1) * made.chi2.sum(axis=0)
    # In patterns the noise of rounding is not that of white noise, which SUs feel alike.
    np.testing.assert_allclose(seen / expected, np.mean(seen / expected), rtol=0.1)
    np.testing.assert_allclose(seen / expected, 1.0, rtol=0.35)
    assert np.abs(seen / made.chi2.sum(axis=0)).max() > 0.1
