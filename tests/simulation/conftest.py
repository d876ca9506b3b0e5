"""Small robots and recordings that several tests look at."""

from __future__ import annotations

from pathlib import Path

import pytest

from skin2urdf.simulation import Simulation, SimulationSettings, load_robot, simulate

GANTRY = """<?xml version="1.0"?>
<robot name="gantry">
  <link name="rail"/>
  <link name="carriage"><inertial><origin xyz="0.1 0 0.05"/><mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0 0.2 0"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <link name="left"/><link name="right"/>
  <joint name="slide" type="prismatic">
    <origin xyz="0 0 0.3" rpy="0 1.5707963267948966 0.4"/>
    <parent link="rail"/><child link="carriage"/><axis xyz="0 1 0"/>
    <limit lower="-0.2" upper="0.6" effort="100" velocity="1"/>
  </joint>
  <joint name="swing" type="continuous">
    <origin xyz="0.1 0 0" rpy="0.3 0 0"/>
    <parent link="carriage"/><child link="arm"/><axis xyz="1 0 0"/>
  </joint>
  <joint name="grip_left" type="prismatic">
    <origin xyz="0 0.4 0" rpy="0.2 0 0"/>
    <parent link="arm"/><child link="left"/><axis xyz="0 0 1"/>
    <limit lower="0.01" upper="0.05" effort="10" velocity="1"/>
  </joint>
  <joint name="grip_right" type="revolute">
    <origin xyz="0 0.4 0.1" rpy="0 0.5 0"/>
    <parent link="arm"/><child link="right"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="10" velocity="1"/>
    <mimic joint="grip_left"/>
  </joint>
</robot>
"""
"""A tree with a prismatic, a continuous and a mimic joint."""


@pytest.fixture
def gantry(tmp_path: Path) -> Path:
    path = tmp_path / "gantry.urdf"
    path.write_text(GANTRY)
    return path


@pytest.fixture(scope="session")
def panda_one() -> Simulation:
    """Three poses of the Panda, one DoF after the other, with the default realism."""
    return simulate(load_robot("panda"), SimulationSettings(n_poses=3, seed=3))


@pytest.fixture(scope="session")
def panda_exact() -> Simulation:
    """Two poses of the Panda, all DoFs at once, through perfect sensors on a common clock."""
    settings = SimulationSettings(
        n_poses=2,
        excite="all",
        grade="ideal",
        encoder_bits=None,
        jitter=0.0,
        stagger=False,
        seed=4,
    )
    return simulate(load_robot("panda"), settings)
