"""Rests that were recorded one by one: means alone, held, with nothing between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from simulated import sampled_of, simulation

from skin2urdf.arrays import F64
from skin2urdf.calibration.pipeline import calibrate


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
