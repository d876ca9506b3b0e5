"""Rests and neighbourhoods, found in joint positions made by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from joint_paths import JointPath

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.signals.motion import Motion, joint_motion
from skin2urdf.signals.poses import Neighbourhood, find_neighbourhoods, find_rests
from skin2urdf.signals.sampling import sample_recording

POSES = ([0.2, -0.5, 1.0], [1.1, 0.4, -0.3], [-0.7, 0.9, 0.1])


def visit(poses: tuple[list[float], ...] = POSES, size: float = 0.12) -> JointPath:
    """Rest in each pose and swing every joint there, with rests between."""
    path = JointPath([0.0] * len(poses[0])).rest(1.0)
    for pose in poses:
        path.move(pose).rest(1.0)
        for joint in range(len(pose)):
            path.swing({joint: size}).rest(0.5)
    return path


def found(motion: Motion) -> tuple[Neighbourhood, ...]:
    return find_neighbourhoods(motion, find_rests(motion))


def seconds(pose: Neighbourhood) -> float:
    return sum(b - a for a, b in pose.windows) / 125.0


def encoder(path: JointPath, bits: int) -> F64:
    """Rounding errors to add to a path's samples at 250 Hz."""
    q = path.at(np.arange(0.0, path.time[-1], 1 / 250.0))
    step = 2 * np.pi / 2**bits
    return np.round(q / step) * step - q


def test_rests_lie_where_nothing_moves() -> None:
    path = visit()
    motion = path.motion()
    rests = find_rests(motion)
    assert len(rests) == 1 + len(POSES) * 4
    moving = (np.abs(np.diff(motion.q, axis=0)) > 2e-3 / 125.0 * 40).any(axis=1)
    for rest in rests:
        assert not moving[rest.begin + 1 : rest.end - 1].any()
    lengths = [(r.end - r.begin) / 125.0 for r in rests]
    assert min(lengths) > 0.4
    np.testing.assert_allclose(rests[1].q, POSES[0], atol=2e-3)


@pytest.mark.parametrize("bits", [10, 12, 17])
def test_every_pose_is_found_with_all_that_happens_around_it(bits: int) -> None:
    path = visit()
    poses = found(path.motion(disturbance=encoder(path, bits)))
    assert len(poses) == 1 + len(POSES)
    for pose, expected in zip(poses[1:], POSES, strict=True):
        np.testing.assert_allclose(pose.q, expected, atol=max(3e-3, 2 * np.pi / 2**bits))
        assert len(pose.windows) == 1
        # One second of rest, three patterns of two, three rests of a half; moves left out.
        assert 8.0 < seconds(pose) < 9.6


def test_patterns_on_all_joints_at_once_are_one_window() -> None:
    path = JointPath([0.0, 0.0, 0.0]).rest(1.0)
    for pose in POSES:
        path.move(pose).rest(0.8).swing({0: 0.1, 1: 0.15, 2: -0.1}, seconds=8.0).rest(0.8)
    poses = found(path.motion())
    assert len(poses) == 4
    assert all(9.0 < seconds(pose) < 10.5 for pose in poses[1:])


def test_coming_back_to_a_pose_joins_what_was_there() -> None:
    path = visit((POSES[0], POSES[1], POSES[0], POSES[1]))
    poses = found(path.motion())
    assert len(poses) == 3
    assert [len(p.windows) for p in poses] == [1, 2, 2]
    assert all(16.0 < seconds(p) < 19.0 for p in poses[1:])


def test_only_what_leaves_a_pose_is_a_pattern() -> None:
    """A servo that rings after a move, however clean the encoder, is at rest."""
    assert [pose.left for pose in found(visit().motion())] == [False, True, True, True]
    ringing = JointPath([0.0] * 3).rest(1.0)
    for pose in POSES:
        ringing.move(pose).swing({0: 1e-3}).rest(1.0)
    assert not any(pose.left for pose in found(ringing.motion()))


def test_a_wide_trip_without_a_stop_is_not_taken_for_a_pattern() -> None:
    """Out and back by more than a pattern does: the small-motion model would not hold there."""
    path = JointPath([-1.5, 0.0]).rest(1.0).move([0.5, 0.5]).rest(1.0)
    path.move([1.5, 0.5]).move([0.5, 0.5]).rest(1.0).swing({1: 0.1}).rest(1.0)
    motion = path.motion()
    pose = found(motion)[-1]
    assert len(pose.windows) == 2
    for begin, end in pose.windows:
        assert abs(motion.q[begin:end] - pose.q).max() < 0.15


def test_windows_never_overlap_and_lie_inside_the_grid() -> None:
    motion = visit((POSES[0], POSES[1], POSES[0])).motion()
    windows = sorted(w for pose in found(motion) for w in pose.windows)
    assert windows[0][0] >= 0
    assert windows[-1][1] <= motion.grid.size
    assert all(a[1] <= b[0] for a, b in pairwise(windows))


def test_a_sag_of_a_few_milliradian_between_rests_does_not_part_them() -> None:
    path = JointPath([0.0, 0.0]).rest(1.0).move([0.8, -0.6]).rest(0.8)
    for sag in (3e-3, -4e-3, 5e-3):
        path.swing({0: 0.12}).move([0.8 + sag, -0.6 - sag], 0.3).rest(0.8)
    path.move([-0.6, 0.7]).rest(1.0).swing({1: 0.1}).rest(1.0)
    poses = found(path.motion())
    assert len(poses) == 3
    np.testing.assert_allclose(poses[1].q, [0.8, -0.6], atol=6e-3)


def test_poses_of_a_joint_with_a_small_range_are_told_apart() -> None:
    """A gripper that slides by millimetres has as many poses as an arm."""
    path = JointPath([0.010, 0.0]).rest(1.0)
    for slide, turn in ((0.020, 0.5), (0.032, 0.5), (0.020, -0.4)):
        path.move([slide, turn]).rest(1.0).swing({0: 0.006}).rest(0.6).swing({1: 0.1}).rest(0.6)
    poses = found(path.motion())
    assert len(poses) == 4
    np.testing.assert_allclose([p.q[0] for p in poses], [0.01, 0.02, 0.032, 0.02], atol=5e-4)


def test_a_slow_drift_is_a_move_and_no_rest() -> None:
    path = JointPath([0.0]).rest(1.0).move([1.5], 12.0).rest(1.0)
    rests = find_rests(path.motion())
    between = [r for r in rests if r.begin / 125.0 > 2.5 and r.end / 125.0 < 11.5]
    assert between == []


def test_rests_stay_clear_of_gaps() -> None:
    recording = visit().recording()
    joint = recording.joints[0]
    keep = (joint.time < 2.7) | (joint.time > 3.0)
    torn = JointStream(joint.name, joint.time[keep], joint.position[keep])
    motion = joint_motion(Recording((torn, *recording.joints[1:]), ()))
    for rest in find_rests(motion):
        assert motion.valid[rest.begin : rest.end].all()


def test_a_robot_that_never_rests_is_an_error_in_words() -> None:
    path = JointPath([0.0, 0.0])
    for i in range(8):
        path.swing({0: 0.8, 1: 0.9}, seconds=3.0, hertz=0.9 + 0.1 * i)
    time = np.arange(0.0, path.time[-1], 0.004)
    # The window of a swing is flat at its ends; keep it from being a rest.
    su = SuStream("su", time, np.tile([0.0, 0.0, 9.81], (time.size, 1)))
    drift = np.outer(0.3 * np.sin(2 * np.pi * 0.7 * time), [1.0, 1.0])
    recording = path.recording(sus=[su], disturbance=drift)
    with pytest.raises(InsufficientDataError) as caught:
        sample_recording(recording, ("a", "b"), ("su",))
    assert caught.value.lacks == "rests"
    assert caught.value.remedy
    assert recording.source in str(caught.value)


def test_a_joint_that_moves_in_its_patterns_alone_spoils_no_pose() -> None:
    poses = tuple([*pose, 0.0] for pose in POSES)
    found_poses = found(visit(poses, size=0.2).motion())
    assert len(found_poses) == 1 + len(POSES)
    assert all(seconds(pose) > 10.0 for pose in found_poses[1:])
