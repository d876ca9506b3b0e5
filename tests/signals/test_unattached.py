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
    """A link rings for long after each stop, and an SU on the base has ten times the noise."""
    recording = simulation("panda", n_poses=6).recording
    base, tip = recording.sus[0].name, recording.sus[-1].name
    rng = np.random.default_rng(2)

    def shaken(su: SuStream) -> SuStream:
        size = {base: 0.15, tip: 0.01}.get(su.name, 0.0)
        ringing = 0.1 * np.sin(2 * np.pi * 3.0 * su.time) * (su.name == tip)
        noise = size * rng.standard_normal(su.specific_force.shape)
        return replace(su, specific_force=su.specific_force + noise + ringing[:, None])

    assert unattached_in(changed_sus(recording, shaken)) == []
