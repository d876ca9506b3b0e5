"""What is foreseen of a calibration from a plan alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skin2urdf import CalibrationSettings, calibrate
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.geometry.earth import ANOMALY
from skin2urdf.model.records import KinematicModel
from skin2urdf.planning.expected import expected, sensors_of
from skin2urdf.planning.kinematics import PlacedSu, kinematic_model
from skin2urdf.planning.records import Plan
from skin2urdf.simulation import GRADES, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.mechanism import Mechanism


def test_what_is_known_of_gravity_is_no_matter_of_noise(plan: Plan, model: KinematicModel) -> None:
    foreseen = [
        expected(plan.trajectory, model, sensors_of(GRADES["mems"]), seed=seed) for seed in (0, 2)
    ]
    position = np.array([each.position for each in foreseen])
    known = np.isfinite(position).all(axis=0)
    assert known.any()
    ratio = position[0, known] / position[1, known]
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    # Where gravity is not told, lengths are as uncertain as it is: forty times more.
    elsewhere = foreseen[0].position_elsewhere[known]
    assert (position[0, known] < 0.1 * elsewhere).all()


def test_what_is_foreseen_is_what_a_calibration_states(
    plan: Plan, arm: Path, mechanism: Mechanism
) -> None:
    settings = SimulationSettings(plan=plan.trajectory, seed=1, jitter=0.0)
    simulated = simulate(load_robot(arm), settings)
    sus = [PlacedSu(su.name, su.joint, su.T_joint_su) for su in simulated.truth.sus]
    model = kinematic_model(mechanism.model, list(mechanism.prismatic), np.eye(3), sus)
    foreseen = expected(plan.trajectory, model, sensors_of(GRADES["mems"]))

    found = calibrate(simulated.recording, CalibrationSettings(gravity_deviation=ANOMALY))
    low, high = found.limits.T
    q = low + (high - low) * np.random.default_rng(0).random((200, len(low)))
    stated = aligned_deviations(found.estimate, found.observability, q)
    determined = [
        name
        for name, verdict in zip(
            found.model.tree.su_names, found.observability.su_verdict, strict=True
        )
        if verdict == "determined"
    ]
    assert determined
    for mine, theirs in zip((foreseen.position, foreseen.orientation), stated, strict=True):
        of_plan, of_log = (
            np.array([x[tree.su_names.index(name)] for name in determined])
            for x, tree in ((mine, model.tree), (theirs, found.model.tree))
        )
        np.testing.assert_allclose(of_plan, of_log, rtol=0.15)
