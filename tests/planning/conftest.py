"""One arm for all tests of planning: three joints, boxes that can touch, a URDF of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from folding_arm import folding_arm

from skin2urdf.model.records import KinematicModel
from skin2urdf.planning.collisions import CollisionChecker
from skin2urdf.planning.kinematics import kinematic_model, usual_sus
from skin2urdf.planning.limits import Given, complete
from skin2urdf.planning.plan import make_plan
from skin2urdf.planning.records import Limits, Plan, PlanSettings
from skin2urdf.simulation.mechanism import Mechanism, load_mechanism, read_urdf
from skin2urdf.simulation.robots import load_robot


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """URDF of an arm that can fold onto its own base."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(folding_arm(), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def mechanism(arm: Path) -> Mechanism:
    return load_mechanism(load_robot(arm), (0.0, 0.0, 0.0))


@pytest.fixture(scope="session")
def limits(mechanism: Mechanism) -> Limits:
    given = {name: Given(lower=-2.9, upper=2.9, velocity=2.0) for name in mechanism.joint_names}
    return complete(mechanism.joint_names, given)


@pytest.fixture(scope="session")
def checker(arm: Path, mechanism: Mechanism, limits: Limits) -> CollisionChecker:
    xml = read_urdf(load_robot(arm))
    return CollisionChecker(xml, arm, mechanism.joint_names, {}, (limits.lower, limits.upper))


@pytest.fixture(scope="session")
def model(mechanism: Mechanism) -> KinematicModel:
    sus = usual_sus(mechanism.model, [int(p) for p in mechanism.parent])
    return kinematic_model(mechanism.model, list(mechanism.prismatic), np.eye(3), sus)


@pytest.fixture(scope="session")
def plan(limits: Limits, model: KinematicModel, checker: CollisionChecker) -> Plan:
    """A plan of one minute."""
    return make_plan(limits, PlanSettings(minutes=1.0, candidates=40), model, checker)
