"""Adapters of public recordings: values and stamps of a small folder of the same form."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skin2urdf.recording.reading import read

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts" / "real"


def adapt(script: str, data: Path, log: Path) -> subprocess.CompletedProcess[str]:
    """Run an adapter."""
    return subprocess.run(  # noqa: S603 - a script of this repository
        [sys.executable, SCRIPTS / script, data, log], capture_output=True, text=True, check=False
    )


def test_icub_leg_keeps_the_dumper_s_stamps_and_the_boards_counts(tmp_path: Path) -> None:
    leg = tmp_path / "right_leg"
    times = 100.0 + 0.01 * np.arange(50)
    (leg / "stateExt:o").mkdir(parents=True)
    (leg / "inertialMTB").mkdir()
    rest = " ".join(["(0.0 0.0 0.0 0.0 0.0 0.0) [ok]"] * 9)
    (leg / "stateExt:o" / "data.log").write_text(
        "".join(
            f"{n} {t:.6f} ({n}.0 5.0 0.0 -10.0 -4.0 -5.0) [ok] {rest}\n"
            for n, t in enumerate(times)
        )
    )
    boards = " ".join(f"{38 + k} 1.0 {k}.0 16384.0 -{k}.0 {k}.0" for k in range(11))
    (leg / "inertialMTB" / "data.log").write_text(
        "".join(f"{n} {t + 0.002:.6f} 12.0 6.0 {boards} 0.0 0.0\n" for n, t in enumerate(times))
    )
    log = tmp_path / "leg.mcap"
    assert adapt("icub_leg.py", leg, log).returncode == 0
    recording = read(log)
    assert len(recording.joints) == 6
    assert len(recording.sus) == 11
    pitch = next(joint for joint in recording.joints if joint.name == "r_hip_pitch")
    np.testing.assert_allclose(pitch.position, np.deg2rad(np.arange(50.0)))
    assert np.isclose(recording.start, 100.0)
    board = next(su for su in recording.sus if su.name == "r_lower_leg_mtb_acc_11b8")
    np.testing.assert_allclose(board.specific_force[0], 5.9855e-4 * np.array([16384.0, -7.0, 7.0]))
    assert np.isclose(board.time[0], 0.002, atol=1e-4)


def test_panda_rests_hold_each_mean_and_leave_out_what_is_no_sensor(tmp_path: Path) -> None:
    positions = np.arange(14.0).reshape(2, 7) / 10
    np.savetxt(tmp_path / "panda_positions.txt", positions)
    (tmp_path / "measured_static_acceleration.txt").write_text(
        "".join(
            f"[INFO] [1592681173.38]: [Pose_{pose}, imu_link{k}] "
            f"Mean Acceleration: ({k}.5 -{pose}.25 9.000)\n"
            for pose in (1, 2)
            for k in range(3)
        )
    )
    log = tmp_path / "rests.mcap"
    assert adapt("panda_rests.py", tmp_path, log).returncode == 0
    recording = read(log)
    assert [su.name for su in recording.sus] == ["imu_link1", "imu_link2"]
    for k, su in enumerate(recording.sus, start=1):
        assert {tuple(row) for row in su.specific_force.tolist()} == {
            (k + 0.5, -1.25, 9.0), (k + 0.5, -2.25, 9.0),
        }  # fmt: skip
    for j, joint in enumerate(recording.joints):
        assert set(joint.position.tolist()) == set(positions[:, j].tolist())
        assert np.max(np.diff(joint.time)) > 1.0


def test_pan_tilt_takes_rests_in_their_order_and_degrees_as_radians(tmp_path: Path) -> None:
    data = tmp_path / "spot" / "data"
    data.mkdir(parents=True)
    for k in (2, 10):  # by name, 10 comes first
        angles = {"angle0": 9.0 * k, "angle1": 90.0, "angle2": 63.0}
        sample = {"acceleration": {"x": 0.5, "y": -9.25, "z": float(k)}, "gyroscope": {"x": 0.0}}
        (data / f"motor_angles_{k}.json").write_text(json.dumps(angles))
        (data / f"frame_imu_{k}.json").write_text(json.dumps(sample))
    log = tmp_path / "tilt.mcap"
    assert adapt("pan_tilt.py", tmp_path / "spot", log).returncode == 0
    recording = read(log)
    pan, *held = sorted(recording.joints, key=lambda joint: joint.name)
    np.testing.assert_allclose(pan.position[[0, -1]], np.deg2rad([18.0, 90.0]))
    assert [joint.name for joint in held] == ["angle1", "angle2"]
    (su,) = recording.sus
    np.testing.assert_allclose(su.specific_force[[0, -1]], [[0.5, -9.25, 2.0], [0.5, -9.25, 10.0]])


def test_mast_rests_stand_before_their_stamps(tmp_path: Path) -> None:
    def rest(time: float) -> dict[str, object]:
        return {
            "time": time,
            "joint_states": [0.25, time / 1000],
            "tilt_sensor_base_accel": [0.0, 0.5, 9.75],
            "tilt_sensor_column_accel": [time / 1000, 0.25, 9.5],
        }

    spaces = {
        "a": {"stationing_measurements": [rest(1008.0)], "evaluation_measurements": []},
        "b": {"stationing_measurements": [], "evaluation_measurements": [rest(1000.0)]},
    }
    data = {
        "joint_names": ["column", "pan"],
        "column_heights": {"low": {"solution_spaces": spaces}},
    }
    (tmp_path / "flat.yaml").write_text(json.dumps(data))  # of which YAML is a superset
    log = tmp_path / "mast.mcap"
    assert adapt("mast_rests.py", tmp_path / "flat.yaml", log).returncode == 0
    recording = read(log)
    assert recording.start == pytest.approx(998.0, abs=0.1)
    pan = next(joint for joint in recording.joints if joint.name == "pan")
    stamps = recording.start + pan.time
    np.testing.assert_allclose(stamps[pan.position == 1.0].max(), 1000.0, atol=1e-6)
    np.testing.assert_allclose(stamps[pan.position == 1.008].max(), 1008.0, atol=1e-6)
    assert {su.name for su in recording.sus} == {"tilt_sensor_base", "tilt_sensor_column"}
    tip = next(su for su in recording.sus if su.name == "tilt_sensor_column")
    assert {tuple(row) for row in tip.specific_force.tolist()} == {
        (1.0, 0.25, 9.5), (1.008, 0.25, 9.5),
    }  # fmt: skip


def test_an_adapter_says_what_it_can_not_read(tmp_path: Path) -> None:
    for script in ("icub_leg.py", "panda_rests.py", "pan_tilt.py", "mast_rests.py"):
        run = adapt(script, tmp_path, tmp_path / "log.mcap")
        assert run.returncode == 2
        assert "Traceback" not in run.stderr
        assert not (tmp_path / "log.mcap").exists()


def test_baxter_hand_keeps_stamps_and_takes_fingers_from_messages_of_their_own(
    tmp_path: Path,
) -> None:
    def messages(**fields: object) -> dict[str, object]:
        return {
            str(n): {"header": {"stamp": {"secs": 100, "nsecs": n * 10_000_000}}, **fields}
            for n in range(30)
        }

    felt = messages(linear_acceleration={"x": 0.5, "y": -0.25, "z": 9.5})
    arm = messages(name=["left_w1", "torso_t0"], position=[0.25, -12.5])
    finger = messages(name=["finger"], position=[0.125])
    arm |= {n: finger[n] for n in map(str, range(0, 30, 3))}
    for kind, stream in (("accel", felt), ("jointstate", arm)):
        (tmp_path / f"baxter_shake_{kind}_blue_1.json").write_text(json.dumps(stream))
    log = tmp_path / "run.mcap"
    assert adapt("baxter_hand.py", tmp_path / "baxter_shake_accel_blue_1.json", log).returncode == 0
    run = read(log)
    assert {joint.name: len(joint.time) for joint in run.joints} == {
        "left_w1": 20, "torso_t0": 20, "finger": 10,
    }  # fmt: skip
    assert np.isclose(run.start, 100.0)
    (hand,) = run.sus
    np.testing.assert_allclose(hand.specific_force[3], (0.5, -0.25, 9.5))
    other = adapt("baxter_hand.py", tmp_path / "baxter_shake_jointstate_blue_1.json", log)
    assert other.returncode == 2
    assert "Traceback" not in other.stderr
