"""The noise of encoders shortens no lever arms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from random_robots import Joint, robot_of
from simulated import held_against

from skin2urdf import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.encoder_noise import hidden_offsets, without_shortening
from skin2urdf.estimation.trajectory.fit import fit
from skin2urdf.model.canonical import canonical
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout

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
    assert hidden_offsets(known, along.fitted) == []
    logs = [
        replace(log, noise=None if log.noise is None else 1e5 * log.noise) for log in known.logs
    ]
    lost = known.again(logs=logs)
    assert without_shortening(lost, along.fitted) == (along.fitted, ())
    # Most of the accelerations is noise: what is found of offsets says nothing along any axis.
    logs = [replace(log, noise=10 * (log.qdd[log.kept] ** 2).mean(axis=0)) for log in known.logs]
    hidden = hidden_offsets(known.again(logs=logs), along.fitted)
    assert len(hidden) == 3
    beyond = along.problem.tree.su_joint >= 0
    # One along the only axis that turns an SU moves nothing.
    assert (sum(abs(own[beyond, :3]).max(axis=1) for _, own in hidden) > 0).all()


def test_what_coarse_encoders_do_to_lengths_is_taken_off(tmp_path: Path) -> None:
    layout = SkinLayout(sus_per_segment=2, sus_on_base=1)
    settings = SimulationSettings(
        seed=3, excite="none", minutes=1.0, encoder_bits=12, imu_rate=250.0, joint_rate=125.0
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
