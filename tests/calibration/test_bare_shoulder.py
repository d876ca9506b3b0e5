"""Four SUs on an upright arm, none on its shoulder: single moves, then circles, in a minute."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from simulated import held_against

from skin2urdf.arrays import F64
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.planning.trajectory import JointTrajectory
from skin2urdf.simulation import RobotSpec, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import SuClock
from skin2urdf.simulation.robots import GivenSu, SkinLayout

JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint",
)  # fmt: skip
LINKS = ("upper_arm_link", "forearm_link", "wrist_1_link", "wrist_3_link")
HOME = np.array([0.2, -1.3, 1.6, -1.8, -1.5])
RATE = 50.0


def moves(rng: np.random.Generator) -> JointTrajectory:
    """Each joint by 0.7 rad and back, then three rounds of some decimetres."""
    parts, here = [np.tile(HOME, (100, 1))], HOME
    for j in range(5):
        for size in (0.7, 0.0):
            goal = HOME + size * np.eye(5)[j]
            x = np.linspace(0.0, 1.0, 100, endpoint=False)[:, None]
            parts += [
                here + (goal - here) * (10 * x**3 - 15 * x**4 + 6 * x**5),
                np.tile(goal, (50, 1)),
            ]
            here = goal
    turn = 2 * np.pi * 0.15 / rng.uniform(0.1, 0.25)
    n = round(3 * turn * RATE)
    t = np.arange(n) / RATE
    size, phase = rng.uniform(-0.25, 0.25, 5), rng.uniform(0.0, 2 * np.pi, 5)
    softly = np.minimum(np.minimum(t, t[::-1]), 1.0)[:, None]
    parts.append(HOME + softly * size * np.sin(2 * np.pi * t[:, None] / turn + phase))
    q = gaussian_filter1d(np.concatenate([*parts, np.tile(HOME, (100, 1))]), 4, axis=0)
    qd = np.gradient(q, 1 / RATE, axis=0)
    return JointTrajectory(
        JOINTS, np.arange(len(q)) / RATE, q, qd, np.gradient(qd, 1 / RATE, axis=0)
    )


def arm(rng: np.random.Generator) -> RobotSpec:
    def on(link: str) -> GivenSu:
        x, y, z = rng.uniform(-0.08, 0.08, 3)
        roll, pitch, yaw = rng.uniform(-3.0, 3.0, 3)
        return GivenSu(link, (x, y, z), (roll, pitch, yaw))

    skin = SkinLayout(0, 0, given=tuple(on(link) for link in LINKS))
    return replace(load_robot("ur5"), skin=skin, moving=JOINTS, locked={"wrist_3_joint": 0.0})


def rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("seed", [1, 4])
def test_its_joints_are_in_order_and_errors_as_stated(seed: int, tmp_path: Path) -> None:
    """Rests and moves show different trees, or moves pass for patterns that no tree explains."""
    rng = np.random.default_rng(seed)
    plan = moves(rng)
    settings = SimulationSettings(
        seed=seed, upright=True, imu_rate=100.0, joint_rate=125.0, plan=plan,
        defects=(SuClock(1.3, 60e-6),),
    )  # fmt: skip
    simulation = simulate(arm(rng), settings)
    found = calibrate(simulation.recording)
    assert found.quality != "bad"
    comparison = held_against(found, simulation.truth.urdf, tmp_path)
    assert comparison.tree_equal
    span = np.random.default_rng(0).uniform(size=(60, found.model.tree.n_joints))
    q = found.limits[:, 0] + span * (found.limits[:, 1] - found.limits[:, 0])
    stated, _ = aligned_deviations(found.estimate, found.observability, q)
    true = np.array([su.position.rms for su in comparison.sus if su.position is not None])
    assert rms(true) < 2.0 * rms(stated)
    assert rms(true) < 5e-3
