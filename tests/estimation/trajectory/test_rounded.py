"""What encoders round off, drawn anew, is as large as what they do round off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from random_robots import Joint, robot_of

from skin2urdf import calibrate
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.rounded import DRAWS, rounded_off_again
from skin2urdf.estimation.trajectory.unsure import unsure
from skin2urdf.recording.records import Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.filters import Grid, filtered, sample, second_derivative
from skin2urdf.simulation import SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout

ARM = (
    Joint("first", -1, "revolute", rpy=(1.2, 0.3, 0.0)),
    Joint("second", 0, "revolute", xyz=(0.3, 0.0, 0.1), rpy=(1.4, 0.0, 0.0)),
)


@pytest.mark.usefixtures("through_the_patterns_band")
@pytest.mark.parametrize("joint_rate", [50.0, 500.0])
def test_draws_shake_as_much_as_rounding_does(tmp_path: Path, joint_rate: float) -> None:
    robot = robot_of(ARM, tmp_path, SkinLayout(sus_per_segment=1, sus_on_base=0))

    def recording(encoder_bits: int | None) -> Recording:
        plain = SimulationSettings(
            n_poses=4, seed=8, excite="all", joint_rate=joint_rate, encoder_bits=encoder_bits
        )
        return retimed(simulate(robot, plain).recording)

    rounded, exact = recording(13), recording(None)
    along = calibrate(rounded, CalibrationSettings(gravity_deviation=0.0)).along
    assert along is not None
    (log,) = along.problem.logs
    grid = Grid(float(rounded.joints[0].time[0]), log.rate, len(log.q))
    streams = {joint.name: joint for joint in exact.joints}
    true = np.stack(
        [
            sample(streams[name].time, streams[name].position[:, None], grid)[0][:, 0]
            for name in along.problem.tree.joint_names
        ],
        axis=1,
    )
    again = rounded_off_again([log])
    assert again is not None
    (kept,) = again.at_kept([log])
    off = second_derivative(log.q - filtered(true, log.taps), log.rate)
    there = np.sqrt(np.mean(filtered(off, log.taps)[log.kept] ** 2, axis=0))
    here = np.sqrt(np.mean(kept[2].reshape(DRAWS, 2, -1) ** 2, axis=2))
    assert here.mean(axis=0) == pytest.approx(there, rel=0.25)
    # What is taken off for it is that of white noise, and known as well as it is white here.
    of_white = abs(float((there**2).sum() / log.rounding.sum()) - 1)
    (said,) = unsure(along.problem, along.fitted, again, [np.arange(2)])
    assert 0.5 * of_white < said < 0.9


@pytest.mark.parametrize(("encoder_bits", "joint_rate", "imu_rate"), [(14, 25, 50), (13, 25, 500)])
def test_what_slow_encoders_round_off_is_no_defect(
    tmp_path: Path, encoder_bits: int, joint_rate: float, imu_rate: float
) -> None:
    robot = robot_of(ARM, tmp_path, SkinLayout(sus_per_segment=2, sus_on_base=1))
    plain = SimulationSettings(
        n_poses=4, seed=8, excite="all",
        joint_rate=joint_rate, imu_rate=imu_rate, encoder_bits=encoder_bits,
    )  # fmt: skip
    sound = simulate(robot, plain).recording
    along = calibrate(sound, CalibrationSettings(gravity_deviation=0.0)).along
    assert along is not None
    assert along.causes == ()
    assert along.misfit < 1
    # A fit from which noise was taken off has arrived at what it is to be.
    assert not along.ahead.is_most
