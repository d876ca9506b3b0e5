"""A small robot with a vendor's URDF: what people write into such files is in it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.recording.records import Recording
from skin2urdf.simulation import RobotSpec, SimulationSettings, simulate
from skin2urdf.simulation.robots import SkinLayout
from skin2urdf.vendor.description import origin_transform
from skin2urdf.vendor.source import ModelText

URDF = """\
<?xml version="1.0" ?>\r
<!-- made by hand: </robot> stands in this comment -->\r
<robot name="toy">\r
  <link name="world_link"/>\r
  <joint name="pedestal" type="fixed">\r
    <origin xyz="0 0 0.4" rpy="0 0 0.7"/>\r
    <parent link="world_link"/>\r
    <child link="base"/>\r
  </joint>\r
  <link name="base"><inertial><mass value="4"/><origin xyz="0 0 0"/>\r
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>\r
  <link name="one"><inertial><mass value="2"/><origin xyz="0 0 0.1"/>\r
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>\r
  <link name="two"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>\r
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>\r
  <link name="bracket"/>\r
  <link name="three"><inertial><mass value="1"/><origin xyz="0 0 0.1"/>\r
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>\r
  <link name="finger"><inertial><mass value="0.1"/><origin xyz="0 0 0.01"/>\r
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>\r
  <joint name="turn" type="revolute">\r
    <origin rpy="0 0 0"\txyz='0 0 0.1'/> <!-- the quotes differ -->\r
    <parent link="base"/><child link="one"/>\r
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="3"/>\r
  </joint>\r
  <joint name="lift" type="revolute">\r
    <origin xyz="0.02 0 0.2"/>\r
    <parent link="one"/><child link="two"/>\r
    <axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="9" velocity="3"/>\r
  </joint>\r
  <joint name="plate" type="fixed"><origin xyz="0.3 0.01 0" rpy="0.2 0 0"/>\r
    <parent link="two"/><child link="bracket"/></joint>\r
  <joint name="roll" type="continuous">\r
    <parent link="bracket"/><child link="three"/>\r
    <axis xyz="2 0 1"/><limit effort="9" velocity="3"/>\r
  </joint>\r
  <joint name="grip" type="prismatic"><origin xyz="0.05 0 0.05"/>\r
    <parent link="three"/><child link="finger"/>\r
    <axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="9" velocity="0.1"/></joint>\r
</robot>\r
"""


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording of the robot, and where its SUs sit."""

    recording: Recording
    link: dict[str, str]
    T_link_su: dict[str, F64]


@cache
def recorded(
    folder: Path,
    sus_on_base: int = 0,
    text: str = URDF,
    skin: SkinLayout | None = None,
    **options: Any,
) -> Recorded:
    """Half a minute of ordinary moves with an SU on every moving link; a sliding finger rests."""
    path = folder / "toy.urdf"
    path.write_bytes(text.encode())
    spec = RobotSpec(
        name="toy",
        urdf=path,
        locked={"grip": 0.0} if "prismatic" in text else {},
        skin=skin or SkinLayout(sus_per_segment=1, sus_on_base=sus_on_base),
    )
    settings = {"excite": "none", "minutes": 0.5, "seed": 2, "base_rpy": (0.02, -0.01, 0.0)}
    done = simulate(spec, SimulationSettings(**{**settings, **options}))
    link, T = {}, {}
    for joint in ET.fromstring(done.truth.urdf).findall("joint"):  # noqa: S314 - our own text
        parent, child = joint.find("parent"), joint.find("child")
        assert parent is not None
        assert child is not None
        name = child.get("link", "")
        link[name], T[name] = parent.get("link", ""), origin_transform(joint.find("origin"))
    return Recorded(done.recording, link, T)


def model(text: str = URDF) -> ModelText:
    """The vendor's file."""
    return ModelText(text, "toy.urdf", "urdf", "0" * 64)


def with_zero(joint: str, offset: float) -> str:
    """The vendor's file with another zero of a joint whose origin has no rotation."""
    assert joint == "lift"
    T = np.array([0.0, offset, 0.0])
    rpy = " ".join(map(repr, T.tolist()))
    return URDF.replace('<origin xyz="0.02 0 0.2"/>', f'<origin xyz="0.02 0 0.2" rpy="{rpy}"/>')
