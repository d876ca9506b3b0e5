"""Rests that were recorded one by one: means alone, held, with nothing between them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from simulated import sampled_of, simulation

from skin2urdf.arrays import F64, Bool
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.recording.writing import write
from skin2urdf.survey import explore, survey


def test_means_of_rests_give_the_axes_that_gravity_shows() -> None:
    sim = simulation("ur5", n_poses=8)
    sampled = sampled_of(sim.recording)
    rests = [sampled.rests[0]]
    for rest in sampled.rests[1:]:
        if np.abs(rest.q - rests[-1].q).max() > 0.1:
            rests.append(rest)
    count = 300
    time = np.add.outer(8.0 * np.arange(len(rests)), np.arange(count) / 100).ravel()

    def held(values: F64) -> F64:
        return np.repeat(values, count, axis=0)

    q = np.array([rest.q for rest in rests])
    f = np.array([sampled.readings[r.begin : r.end].mean(axis=0) for r in rests])
    recording = replace(
        sim.recording,
        joints=tuple(
            replace(joint, time=time, position=held(q[:, d]))
            for d, joint in enumerate(sim.recording.joints)
        ),
        sus=tuple(
            replace(su, time=time, specific_force=held(f[:, u]))
            for u, su in enumerate(sim.recording.sus)
        ),
    )
    found = calibrate(recording)
    assert found.model.tree.joint_names == sim.truth.joint_names
    assert not [fault for fault in found.faults if fault.kind in ("intermittent", "dead")]
    # Axes 2, 3 and 4 of a UR5 are parallel, 5 and 6 at right angles to the one before.
    between = np.rad2deg(np.arccos(np.abs(found.model.T_parent_joint[1:, 2, 2])))
    np.testing.assert_allclose(between[1:], [0.0, 0.0, 90.0, 90.0], atol=3.0)


def test_rests_of_a_second_with_gaps_between_them_tell_tree_and_axes(tmp_path: Path) -> None:
    sim = simulation("ur5", n_poses=8)
    sampled = sampled_of(sim.recording)
    grid = sampled.motion.grid
    spans: list[tuple[float, float]] = []
    last = np.full(6, np.inf)
    for rest in sampled.rests:
        if np.abs(rest.q - last).max() > 0.1:
            middle = grid.start + (rest.begin + rest.end) / (2 * grid.rate)
            half = min(0.5, (rest.end - rest.begin) / (2 * grid.rate))
            spans.append((middle - half, middle + half))
            last = rest.q

    def kept(time: F64) -> Bool:
        return np.logical_or.reduce([(time >= a) & (time <= b) for a, b in spans])

    recording = replace(
        sim.recording,
        joints=tuple(
            replace(j, time=j.time[kept(j.time)], position=j.position[kept(j.time)], effort=None)
            for j in sim.recording.joints
        ),
        sus=tuple(su.at(np.flatnonzero(kept(su.time))) for su in sim.recording.sus),
    )
    found = calibrate(recording)
    assert found.model.tree.joint_names == sim.truth.joint_names
    between = np.rad2deg(np.arccos(np.abs(found.model.T_parent_joint[1:, 2, 2])))
    np.testing.assert_allclose(between[1:], [0.0, 0.0, 90.0, 90.0], atol=1.0)
    # What was seen of positions is nothing, and said so.
    assert found.quality == "fair"
    # The other commands see the same.
    write(recording, tmp_path / "rests.mcap")
    explored = explore([tmp_path / "rests.mcap"])
    assert explored.tree is not None
    assert survey(tmp_path / "rests.mcap").features is not None
