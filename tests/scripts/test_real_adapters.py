"""Adapters of public recordings: values and stamps of a small folder of the same form."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

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


def test_an_adapter_says_what_it_can_not_read(tmp_path: Path) -> None:
    for script in ("icub_leg.py", "panda_rests.py"):
        run = adapt(script, tmp_path, tmp_path / "log.mcap")
        assert run.returncode == 2
        assert "Traceback" not in run.stderr
        assert not (tmp_path / "log.mcap").exists()
