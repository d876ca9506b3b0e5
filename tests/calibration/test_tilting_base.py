"""A base that moves by itself is followed, with an SU on it or none, and the error is as stated.

The base stands on two joints that are moved along with the robot's, and of which no log is made:
what SUs feel of it is the physics of the simulation.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench.tilting import Tilting, on_a_tilting_base
from folding_arm import folding_arm
from simulated import held_against

from skin2urdf.arrays import F64
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.uncertainty.observability import aligned_deviations
from skin2urdf.recording.retiming import retimed
from skin2urdf.report.verdict import doubts
from skin2urdf.signals.sampling import sampled_together
from skin2urdf.simulation import RobotSpec, SimulationSettings, simulate
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.simulation.settings import Excitation
from skin2urdf.structure.from_motion import trees_of_both_kinds

_STAND = """
<link name="{parent}"><inertial><mass value="20"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{name}" type="revolute">
  <parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>
  <limit lower="-{most}" upper="{most}" velocity="1" effort="9000"/>
</joint>"""
_ON_BASE = "su_base"


def _robot(folder: Path, most: float, *, on_base: bool) -> RobotSpec:
    """The arm on a stand that tilts by up to an angle [rad] about two axes; on none for 0."""
    roll = _STAND.format(name="roll", parent="ground", child="plate", axis="1 0 0", most=most)
    pitch = _STAND.format(name="pitch", parent="plate", child="base", axis="0 1 0", most=most)
    path = folder / "on_a_stand.urdf"
    text = folding_arm("1.2 0 0").replace("<robot name='folding'>", "")
    stand = roll + pitch if most else ""
    path.write_text(f"<robot name='folding'>{stand}{text}", encoding="utf-8")
    rng = np.random.default_rng(4)
    links = ("base",) * on_base + ("upper", "fore", "fore", "hand", "hand")
    given = tuple(
        GivenSu(link, _three(0.1 * rng.standard_normal(3)), _three(rng.uniform(-3, 3, 3)))
        for link in links
    )
    return RobotSpec("folding", path, moving=("*",), skin=SkinLayout(0, 0, given=given))


def _three(x: F64) -> tuple[float, float, float]:
    return float(x[0]), float(x[1]), float(x[2])


def _calibrated(
    folder: Path, most: float, excite: Excitation, seed: int, *, on_base: bool = True
) -> tuple[Calibration, str]:
    """What a log without the stand's joints says, and the truth of a base that stands still."""
    settings = SimulationSettings(
        excite=excite, minutes=0.5, upright=True, seed=seed, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(_robot(folder, most, on_base=on_base), settings)
    recording = simulation.recording
    arm = tuple(joint for joint in recording.joints if joint.name.startswith("j"))
    truth = simulation.truth.urdf
    for name in ("roll", "pitch"):
        joint = f'<joint name="{name}" type="{{}}"'
        assert joint.format("revolute") in truth
        truth = truth.replace(joint.format("revolute"), joint.format("fixed"))
    return calibrate(replace(recording, joints=arm)), truth


def test_a_base_that_is_carried_on_is_followed_without_an_su_on_it(tmp_path: Path) -> None:
    most = 0.004
    found, truth = _calibrated(tmp_path, most, "none", 4, on_base=False)
    assert found.along is not None
    assert found.along.moving_base is None
    assert "tilts" in found.along.causes
    assert found.quality == "fair"
    assert "moving base" in [doubt.kind for doubt in doubts(found)]
    assert 0.5 * most < found.along.tilt_of_base < 1.2 * most
    assert found.along.base_motion[[0, 1, 2, 5]] == pytest.approx(0.0)
    _hold(found, truth, tmp_path)


@pytest.mark.parametrize(
    ("most", "excite", "seed"),
    [(0.03, "none", 4), (0.01, "series", 3)],
    ids=["carried by more than trees are grown with", "swaying all the time"],
)
def test_an_su_on_the_base_tells_how_it_moves(
    most: float, excite: Excitation, seed: int, tmp_path: Path
) -> None:
    found, truth = _calibrated(tmp_path, most, excite, seed)
    assert found.along is not None
    base = found.along.moving_base
    assert base is not None
    assert len(base.names) == 1
    # A base that is tilted by so much feels that part of gravity in its plane.
    assert 0.3 * most < base.felt[0] / found.along.fitted.state.gravity < 1.5 * most
    assert "moving base" not in [doubt.kind for doubt in doubts(found)]
    _hold(found, truth, tmp_path)


def _hold(found: Calibration, truth: str, folder: Path) -> None:
    """The true errors are no more than twice what is stated, in a tree that is right."""
    compared = held_against(found, truth, folder)
    assert compared.tree_equal
    share = np.random.default_rng(0).uniform(size=(60, found.model.tree.n_joints))
    q = found.limits[:, 0] + share * (found.limits[:, 1] - found.limits[:, 0])
    stated = aligned_deviations(found.estimate, found.observability, q)
    for true, each in zip((compared.position, compared.orientation), stated, strict=True):
        assert true.rms < 2.0 * float(np.sqrt(np.nanmean(each**2)))


def test_patterns_around_poses_are_no_obstacle(tmp_path: Path) -> None:
    settings = SimulationSettings(n_poses=3, upright=True, seed=4, imu_rate=100.0, joint_rate=50.0)
    simulation = simulate(_robot(tmp_path, 0.0, on_base=True), settings)
    found = calibrate(on_a_tilting_base(simulation, Tilting(0.006), seed=7))
    assert found.along is not None
    assert found.along.moving_base is not None
    _hold(found, simulation.truth.urdf, tmp_path)


def test_where_rests_show_that_a_base_tilts_no_moves_are_searched(tmp_path: Path) -> None:
    """What shakes it is no gravity along moves: with ten joints that search took minutes."""
    settings = SimulationSettings(
        excite="none", minutes=1.0, upright=True, seed=3, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(_robot(tmp_path, 0, on_base=True), settings)
    recording = retimed(on_a_tilting_base(simulation, Tilting(2e-2, 8.0), 1))
    logs, _ = sampled_together([recording])
    (of_rests,) = trees_of_both_kinds(logs, [su.name for su in recording.sus])
    tree = of_rests[0].tree
    assert tree.joint_names == ("j0", "j1", "j2")
    assert tree.parent.tolist() == [-1, 0, 1]
    assert sorted(tree.su_joint.tolist()) == [-1, 0, 1, 1, 2, 2]
