"""Logs without patterns: what gravity tells, and that it tells no more."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from skin2urdf import calibrate
from skin2urdf.arrays import F64
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.geometry.so3 import axis_rotation, rotation_exp
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.writing import write
from skin2urdf.report.findings import findings, is_to_repair
from skin2urdf.survey import explore

AXES = ((0.5, 0.0, 0.8), (0.0, 1.0, 0.0), (0.6, 0.0, -0.8))
RATE = 50.0


def at_rest(n_joints: int = 3, poses: int = 14, seconds: float = 1.0) -> tuple[Recording, F64]:
    """A chain that rests in poses between slow moves, an SU on every segment, and its axes."""
    rng = np.random.default_rng(0)
    axes = np.array(AXES[:n_joints])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    goals = rng.uniform(-1.2, 1.2, (poses, n_joints))
    x = np.linspace(0, 1, int(2.5 * RATE))[:, None]
    step = x**3 * (10 - 15 * x + 6 * x**2)
    pieces = [np.repeat(goals[:1], int(seconds * RATE), axis=0)]
    for a, b in pairwise(goals):
        pieces += [a + step * (b - a), np.repeat(b[None], int(seconds * RATE), axis=0)]
    q = np.concatenate(pieces)
    t = np.arange(len(q)) / RATE
    R = np.tile(np.eye(3), (len(q), 1, 1))
    sus = []
    for d, axis in enumerate(axes):
        R = R @ axis_rotation(axis, q[:, d])
        R_su = R @ rotation_exp(rng.standard_normal(3))
        felt = R_su.swapaxes(1, 2) @ (0.0, 0.0, GRAVITY)
        sus.append(SuStream(f"su{d}", t, felt + 0.01 * rng.standard_normal(felt.shape)))
    joints = tuple(
        JointStream(f"joint{d}", t, np.round(q[:, d] / 1e-4) * 1e-4) for d in range(n_joints)
    )
    return Recording(joints=joints, sus=tuple(sus), start=0.0, source="rests"), axes


@pytest.mark.parametrize("sus", [[1], [2], [0, 2]], ids=["middle", "tip", "all but one"])
def test_mirrored_sus_are_named_without_patterns(sus: list[int]) -> None:
    """A left-handed frame is a turn of negated readings; which of two kinds is right none tells."""
    recording, _ = at_rest(poses=24)
    streams = list(recording.sus)
    for u in sus:
        streams[u] = replace(
            streams[u], specific_force=streams[u].specific_force * [1.0, -1.0, 1.0]
        )
    found = calibrate(replace(recording, sus=tuple(streams)))
    tree = found.model.tree
    assert [tree.joint_names[j] for j in tree.chain(2)] == ["joint0", "joint1", "joint2"]
    assert tree.su_joint.tolist() == [0, 1, 2]
    named = {fault.subject for fault in found.faults if fault.kind == "mirrored"}
    assert named == ({f"su{u}" for u in sus} if len(sus) == 1 else {"su1"})


def test_rests_show_tree_and_directions_and_leave_positions_open() -> None:
    recording, axes = at_rest()
    found = calibrate(recording, CalibrationSettings(motion="patterns"))
    tree = found.model.tree
    assert [tree.joint_names[j] for j in tree.chain(2)] == ["joint0", "joint1", "joint2"]
    assert tree.su_joint.tolist() == [0, 1, 2]
    for j in (1, 2):
        cosine = found.model.T_parent_joint[j][2, 2]
        assert abs(cosine) == pytest.approx(abs(axes[j - 1] @ axes[j]), abs=0.02)
    assert found.quality == "fair"
    told = findings(found)
    assert told.positions_open
    # Nobody knows what its moves would have shown, which were not to count.
    assert is_to_repair(found)
    assert np.isnan(told.su_position_sd).all()
    assert np.isnan(told.axis_position_sd).all()
    assert (told.axis_direction_sd < np.deg2rad(2.0)).all()


def test_one_joint_is_fair_at_most() -> None:
    recording, _ = at_rest(1, 5)
    found = calibrate(recording)
    assert found.model.tree.joint_names == ("joint0",)
    assert found.quality == "fair"


def test_a_joint_that_holds_still_is_left_out() -> None:
    recording, _ = at_rest(2)
    first, second = recording.joints
    still = replace(first, name="still", position=np.full_like(first.position, 0.3))
    found = calibrate(replace(recording, joints=(first, second, still)))
    assert found.model.tree.joint_names == ("joint0", "joint1")


def test_rests_with_nothing_in_between_need_no_sample_of_moves() -> None:
    recording, axes = at_rest(seconds=4.0)
    q = np.stack([joint.position for joint in recording.joints], axis=1)
    still = (np.abs(np.diff(q, axis=0, prepend=q[:1])) < 1e-9).all(axis=1)
    alone = replace(
        recording,
        sus=tuple(
            replace(su, time=su.time[still], specific_force=su.specific_force[still])
            for su in recording.sus
        ),
    )
    found = calibrate(alone)
    assert found.model.tree.joint_names == ("joint0", "joint1", "joint2")
    assert found.quality == "fair"
    assert abs(found.model.T_parent_joint[1][2, 2]) == pytest.approx(
        abs(axes[0] @ axes[1]), abs=0.02
    )


def test_exploring_such_a_log_finds_the_tree_that_calibrating_does(tmp_path: Path) -> None:
    recording, _ = at_rest()
    write(recording, tmp_path / "log.mcap")
    explored = explore([tmp_path / "log.mcap"])
    assert explored.from_motion
    assert explored.tree is not None
    assert explored.tree.parent.tolist() == [-1, 0, 1]
    assert explored.tree.su_joint.tolist() == [0, 1, 2]
