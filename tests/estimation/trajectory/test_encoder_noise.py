"""The noise of encoders shortens no lever arms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated import calibration
from random_robots import Joint, robot_of
from simulated import held_against
from synthetic import (
    motion_state,
    random_state,
    readings_along,
    sampled_trajectory,
    serial_tree,
    stays,
)

from skin2urdf import calibrate
from skin2urdf.arrays import F64
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.trajectory.ahead import step_along
from skin2urdf.estimation.trajectory.encoder_noise import hidden_lengths, without_shortening
from skin2urdf.estimation.trajectory.fit import fit, held
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import slack, with_unseen
from skin2urdf.model.canonical import canonical
from skin2urdf.signals import sampling
from skin2urdf.signals.band import Cutoffs
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout
from skin2urdf.simulation.settings import Excitation

ARM = (
    Joint("first", -1, "revolute", rpy=(1.2, 0.3, 0.0)),
    Joint("second", 0, "revolute", xyz=(0.3, 0.0, 0.1), rpy=(1.4, 0.0, 0.0)),
)


def test_noise_in_which_motion_is_lost_is_left_alone(tmp_path: Path) -> None:
    layout = SkinLayout(sus_per_segment=1, sus_on_base=1)
    settings = SimulationSettings(n_poses=4, seed=3, excite="all")
    simulation = simulate(robot_of(ARM, tmp_path, layout), settings)
    along = calibrate(simulation.recording).along
    assert along is not None
    known = along.problem
    assert without_shortening(known, along.fitted)[0] is not along.fitted
    assert hidden_lengths(known, along.fitted, along.corrected) == []
    # What steps would not take off is stated.
    assert len(hidden_lengths(known, along.fitted, ())) == 1
    logs = [
        replace(log, noise=None if log.noise is None else 1e5 * log.noise) for log in known.logs
    ]
    lost = known.again(logs=logs)
    assert without_shortening(lost, along.fitted) == (along.fitted, (), None)
    # Most of the accelerations is noise: what is found of offsets says nothing along any axis.
    logs = [replace(log, noise=10 * (log.qdd[log.kept] ** 2).mean(axis=0)) for log in known.logs]
    hidden = hidden_lengths(known.again(logs=logs), along.fitted, along.corrected)
    assert len(hidden) == 3
    beyond = along.problem.tree.su_joint >= 0
    # One along the only axis that turns an SU moves nothing.
    assert (sum(abs(own[beyond, :3]).max(axis=1) for _, own in hidden) > 0).all()


def test_a_step_is_short_along_what_nothing_shows() -> None:
    """A hundredth of what noise makes of a gradient would turn an SU on the base by 25 rad."""
    found = calibration()
    assert found.along is not None
    fitted = found.along.fitted
    told = np.array([verdict == "determined" for verdict in found.observability.su_verdict])
    size = np.sqrt(np.einsum("uii->ui", fitted.equations.su))
    gradient = np.zeros_like(size)
    gradient[:, :6] = 1e-3 * np.random.default_rng(0).standard_normal((len(size), 6)) * size[:, :6]
    none = np.zeros(len(fitted.equations.joint))
    far, near, nearer = (
        np.abs(step_along(fitted, none, gradient, within=within).steps[1][:, :6])
        for within in (np.inf, 0.035, 0.0035)
    )
    assert far[~told].max() > 1.0
    assert near[~told].max() < 0.035
    # What is known better than that takes the same step.
    assert near[told].max() < 1e-4
    np.testing.assert_allclose(near[told], nearer[told], atol=0.02 * near[told].max())


@pytest.mark.parametrize(("excite", "bits"), [("none", 12), ("series", 11)])
def test_what_coarse_encoders_do_to_lengths_is_taken_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, excite: Excitation, bits: int
) -> None:
    """Of 11 bits it is a quarter of what joints accelerate by, and residuals grow by as much.

    So it is through 5 Hz; the band that suits such moves is narrower, and leaves little of it.
    """
    monkeypatch.setattr(sampling, "suitable_cutoffs", lambda *_: Cutoffs(5.0, 5.0))
    layout = SkinLayout(sus_per_segment=2, sus_on_base=1)
    settings = SimulationSettings(
        seed=3, excite=excite, minutes=1.0, encoder_bits=bits, imu_rate=250.0, joint_rate=125.0
    )  # fmt: skip
    simulation = simulate(robot_of(ARM, tmp_path, layout), settings)
    found = calibrate(simulation.recording, CalibrationSettings(gravity_deviation=0.0))
    along = found.along
    assert along is not None
    # From where the fit ended, plain least squares goes back to its own optimum.
    plain = fit(along.problem, along.fitted.state, near=True).state.placements
    shortened = replace(found, model=canonical(plain.model(along.problem.tree)))
    right, wrong = (
        held_against(each, simulation.truth.urdf, tmp_path).position.rms
        for each in (found, shortened)
    )
    assert right < 0.7 * wrong


def test_what_noise_does_to_slack_is_taken_off_as_well() -> None:
    tree = serial_tree(3)
    rng = np.random.default_rng(3)
    truth = replace(random_state(rng, tree, 1, 0.3), up=np.array([[0.0, 0.0, 1.0]]))
    q = stays(rng.uniform(-1.5, 1.5, (8, 3)), 300, 500)
    read = readings_along(tree, truth, q)
    read += 7e-3 * rng.standard_normal(read.shape)
    log = sampled_trajectory(q, read, still_below=1e-3)
    shaken = np.ones_like(log.shaken)
    log = replace(log, noise=np.full(3, 1e-4), shaken=shaken)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    places = slack(tree, [log])
    assert places is not None
    problem = with_unseen(MotionProblem(tree, [log], priors), places, 1e-4)
    state = motion_state(truth, np.zeros(problem.layout.n_unseen), priors.sensors.gravity)
    fitted = held(problem, state)
    parts = without_shortening(problem, fitted)[1]
    assert [part.joints.tolist() for part in parts] == [[0], [1], [2]]

    def gradient(pushed: int, by: float) -> F64:
        qdd = np.array(log.qdd)
        qdd[:, pushed] += by
        about = problem.again(logs=[replace(log, qdd=qdd)])
        predicted = (about.predict(state, 0),)
        return about.equations(state, predicted, fitted.weights).joint_gradient

    # Of half the samples, each of which counts for more, the same comes.
    half = log.thinned(2)
    few, more = problem.again(logs=[half]), 2 * log.independence / half.independence
    fewer = without_shortening(few, held(few, state))[1]
    unseen, size = problem.layout.unseen, np.sqrt(np.diag(fitted.equations.joint))
    for part, of_few in zip(parts, fewer, strict=True):
        off = (more * of_few.joint - part.joint) / size
        assert np.linalg.norm(off) <= 0.1 * np.linalg.norm(part.joint / size)
    for j, part in enumerate(parts):
        # Of noise that is known, what goes with its square is left where both signs are added.
        both = gradient(j, 1.0) + gradient(j, -1.0) - 2 * gradient(j, 0.0)
        expected = -0.5 * 1e-4 * both / size
        for which in (slice(0, unseen.start), unseen):
            one, other = part.joint[which] / size[which], expected[which]
            # Where nothing is expected, as in slack by the last joint, differences leave rounding.
            assert np.linalg.norm(one - other) <= 0.1 * np.linalg.norm(other) + 1e-9
