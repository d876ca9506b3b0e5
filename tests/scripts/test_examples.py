"""The examples of the Python API do what they say."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from calibrated import calibration, simulation
from examples import compare_with_truth, predict_reading, print_joints

from skin2urdf import compare, save


def test_every_joint_is_printed_with_its_parent_and_place() -> None:
    quality, *lines = print_joints.lines_of(calibration())
    assert quality.startswith(calibration().quality)
    tree = calibration().model.tree
    assert [line.split()[0] for line in lines] == list(tree.joint_names)
    for j, line in enumerate(lines):
        found = [float(x) for x in re.findall(r"-?\d+\.\d{4}", line)[:3]]
        np.testing.assert_allclose(found, calibration().model.T_parent_joint[j, :3, 3], atol=1e-4)


def test_an_estimate_is_compared_with_the_truth(tmp_path: Path) -> None:
    truth = tmp_path / "truth.urdf"
    truth.write_text(simulation().truth.urdf, encoding="utf-8")
    equal, (position, orientation) = compare_with_truth.compare_with(
        calibration(), truth, tmp_path / "robot.urdf"
    )
    assert equal
    expected = compare(tmp_path / "robot.urdf", truth, rng=np.random.default_rng(0))
    assert float(position.split()[2]) == pytest.approx(1e3 * expected.position.rms, abs=1e-3)
    turn = np.rad2deg(expected.orientation.rms)
    assert float(orientation.split()[2]) == pytest.approx(turn, abs=1e-3)


def test_a_calibrated_urdf_predicts_what_was_recorded_at_rest(tmp_path: Path) -> None:
    """Gravity as every pose's features hold it, but for the sensors' own errors."""
    urdf, _ = save(calibration(), tmp_path / "robot.urdf")
    model, features = pin.buildModelFromUrdf(str(urdf)), calibration().features
    dof = [model.joints[model.getJointId(name)] for name in features.dof_names]
    order = list(calibration().model.tree.su_names)
    for u, su in enumerate(features.su_names):
        for p in range(features.n_poses):
            step = np.zeros(model.nv)
            step[[joint.idx_v for joint in dof]] = features.q[p]
            q = pin.integrate(model, pin.neutral(model), step)
            read = features.f0[p, u] - calibration().estimate.state.bias[order.index(su)]
            np.testing.assert_allclose(predict_reading.predict(urdf, su, q), read, atol=0.4)


def test_acceleration_and_the_centripetal_part_are_felt(tmp_path: Path) -> None:
    """An SU 0.3 m off a vertical axis."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        """<robot name="arm"><link name="base"/><link name="arm"/><link name="su"/>
        <joint name="j" type="continuous"><parent link="base"/><child link="arm"/>
        <axis xyz="0 0 1"/></joint>
        <joint name="f" type="fixed"><parent link="arm"/><child link="su"/>
        <origin xyz="0.3 0 0"/></joint></robot>""",
        encoding="utf-8",
    )
    q = pin.neutral(pin.buildModelFromUrdf(str(urdf)))
    read = predict_reading.predict(urdf, "su", q, np.array([2.0]), np.array([5.0]))
    np.testing.assert_allclose(read, [-0.3 * 4.0, 0.3 * 5.0, 9.81], atol=1e-12)
    with pytest.raises(ValueError, match="nowhere"):
        predict_reading.predict(urdf, "nowhere", q)


@pytest.mark.parametrize("example", [print_joints, compare_with_truth, predict_reading])
def test_without_arguments_an_example_says_how_it_is_used(
    example: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert example.main([]) == 2  # type: ignore[attr-defined]
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("usage: ") for line in lines)
