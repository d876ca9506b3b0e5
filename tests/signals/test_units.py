"""Joints whose positions are in another unit than rad and m."""

from __future__ import annotations

import numpy as np
import pytest
from joint_paths import JointPath

from skin2urdf.errors import InsufficientDataError
from skin2urdf.notes import of_kind
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.signals.sampling import Sampled, sample_recording

NAMES = ("turns", "slides", "bends")


def sampled(units: tuple[float, float, float]) -> Sampled:
    """A log of three joints, each in so many units a rad or m."""
    path = JointPath([0.0] * 3).rest(1.0)
    for at in ((0.9, 0.1, -0.5), (-0.6, -0.2, 0.7), (0.3, 0.2, 0.1)):
        path.move(at).rest(1.0)
    time = np.arange(0.0, path.time[-1], 0.01)
    joints = tuple(
        JointStream(name, time, unit * position)
        for name, unit, position in zip(NAMES, units, path.at(time).T, strict=True)
    )
    noise = 0.01 * np.random.default_rng(0).standard_normal((len(time), 3))
    su = SuStream("su", time, noise + np.array([0.0, 0.0, 9.81]), "/su")
    return sample_recording(Recording(joints, (su,), source="log"), NAMES, ["su"])


@pytest.mark.parametrize(
    ("units", "odd"),
    [
        ((1.0, 1.0, 1.0), ()),
        ((1.0, 1000.0, 1.0), ("slides",)),
        ((1.0, 1.0, 180.0 / np.pi), ("bends",)),
    ],
)
def test_a_joint_in_another_unit_is_named(
    units: tuple[float, float, float], odd: tuple[str, ...]
) -> None:
    notes = of_kind(sampled(units).notes, "odd unit")
    assert tuple(joint for note in notes for joint in note.joints) == odd


def test_most_joints_in_degrees_are_no_log_of_a_robot() -> None:
    with pytest.raises(InsufficientDataError) as caught:
        sampled((180.0 / np.pi, 1.0, 180.0 / np.pi))
    assert caught.value.lacks == "radians"
