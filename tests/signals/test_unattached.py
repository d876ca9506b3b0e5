"""SUs that move by themselves are named and left out; what a robot or its base does is neither."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated import changed_sus, simulation

from skin2urdf.recording.records import Recording, SuStream
from skin2urdf.signals.sampling import sampled_together


def unattached_in(recording: Recording) -> list[str]:
    ((sampled,), _) = sampled_together([recording])
    return [fault.subject for fault in sampled.faults if fault.kind == "unattached"]


def of_another_robot(recording: Recording, name: str, delay: float) -> Recording:
    """The log, one SU of which sits on a robot that does something else at other times."""
    other = simulation("ur5", seed=5, excite="series", n_poses=8).recording.sus[-1]

    def read(su: SuStream) -> SuStream:
        at = np.mod(su.time + delay, other.time[-1])
        felt = [np.interp(at, other.time, axis) for axis in other.specific_force.T]
        return replace(su, specific_force=np.stack(felt, axis=1))

    return changed_sus(recording, lambda su: read(su) if su.name == name else su)


@pytest.mark.parametrize("delay", [3.0, 17.0, 31.0])
@pytest.mark.parametrize("u", [0, -1])
def test_an_su_of_another_robot_is_left_out(u: int, delay: float) -> None:
    recording = simulation("panda", n_poses=6).recording
    name = recording.sus[u].name
    assert unattached_in(of_another_robot(recording, name, delay)) == [name]


@pytest.mark.parametrize("excite", ["one", "all", "none"])
def test_sus_of_one_robot_move_with_its_joints(excite: str) -> None:
    more = {"minutes": 1.0} if excite == "none" else {}
    assert unattached_in(simulation("ur5", excite=excite, **more).recording) == []


def test_a_base_that_moves_by_itself_moves_all_sus() -> None:
    """A ship rolls by 3 deg in 5 s, whatever the robot on it does."""
    recording = simulation("panda", n_poses=6).recording

    def rolled(su: SuStream) -> SuStream:
        angle = np.deg2rad(3) * np.sin(2 * np.pi * 0.2 * su.time)
        turn = Rotation.from_rotvec(angle[:, None] * [0.6, 0.0, 0.8])
        return replace(su, specific_force=turn.apply(su.specific_force.copy()))

    assert unattached_in(changed_sus(recording, rolled)) == []


def test_what_shakes_at_rest_by_little_is_on_the_robot() -> None:
    """A first link, which patterns move little, rings on; an SU on the base is far noisier."""
    made = simulation("panda", n_poses=6)
    recording, truth = made.recording, made.truth
    base, link = (next(su.name for su in truth.sus if su.joint == j) for j in (-1, 0))
    rng = np.random.default_rng(2)

    def shaken(su: SuStream) -> SuStream:
        size = {base: 0.15, link: 0.01}.get(su.name, 0.0)
        ringing = 0.1 * np.sin(2 * np.pi * 3.0 * su.time) * (su.name == link)
        noise = size * rng.standard_normal(su.specific_force.shape)
        return replace(su, specific_force=su.specific_force + noise + ringing[:, None])

    assert unattached_in(changed_sus(recording, shaken)) == []


def test_an_su_on_the_base_that_is_shaken_for_a_while_is_on_the_robot() -> None:
    """Somebody takes hold of it for seconds, in one long rest before the robot begins."""
    made = simulation("panda", n_poses=6)
    base = next(su.name for su in made.truth.sus if su.joint < 0)

    def idle(su: SuStream) -> SuStream:
        step = float(np.median(np.diff(su.time)))
        before = np.arange(su.time[0] - 30.0, su.time[0] - step / 2, step)
        felt = np.tile(su.specific_force[:20].mean(axis=0), (len(before), 1))
        noise = 0.005 * np.random.default_rng(1).standard_normal(felt.shape)
        shaken = 2.0 * np.sin(2 * np.pi * 0.4 * before) * (before > before[-1] - 15.0)
        felt += noise + shaken[:, None] * (su.name == base)
        return replace(
            su, time=np.r_[before, su.time], specific_force=np.r_[felt, su.specific_force]
        )

    log = changed_sus(made.recording, idle)
    joints = tuple(
        replace(
            joint,
            time=np.r_[np.arange(-30.0, -0.004, 0.008) + joint.time[0], joint.time],
            position=np.r_[np.full(3750, joint.position[0]), joint.position],
        )
        for joint in log.joints
    )
    assert unattached_in(replace(log, joints=joints)) == []


def test_an_su_on_a_clock_of_its_own_is_on_the_robot() -> None:
    """Patterns last as long as the rests between them, in which it moves by its clock."""
    recording = simulation("ur5", excite="one", n_poses=3).recording

    def early(su: SuStream) -> SuStream:
        return replace(su, time=su.time - 0.5 * (su.name == recording.sus[4].name))

    assert unattached_in(changed_sus(recording, early)) == []
