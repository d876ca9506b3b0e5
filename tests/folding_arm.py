"""An arm of three joints and boxes that can touch, with a URDF of its own."""

from __future__ import annotations

from itertools import pairwise

_LINK = """
<link name="{name}">
  <inertial><origin xyz="0 0 0.15"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 0 {middle}"/><geometry><box size="0.06 0.06 {length}"/></geometry>
  </collision>
</link>"""
_JOINT = """
<joint name="{name}" type="revolute">
  <parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/>
  <axis xyz="0 1 0"/>
  <limit lower="-2.9" upper="2.9" velocity="2" effort="50"/>
</joint>"""


def folding_arm(last_turn: str = "0 0 0") -> str:
    """URDF of an arm that can fold onto its own base.

    Args:
        last_turn: roll, pitch, yaw of its last joint on the one before [rad].
    """
    lengths = {"base": 0.3, "upper": 0.3, "fore": 0.3, "hand": 0.2}
    text = "<robot name='folding'>"
    for name, length in lengths.items():
        text += _LINK.format(name=name, middle=length / 2, length=length - 0.1)
    names = list(lengths)
    turns = ("0 0 0", "0 0 0.4", last_turn)
    for i, (parent, child) in enumerate(pairwise(names)):
        xyz = f"0 0 {lengths[parent]}"
        text += _JOINT.format(name=f"j{i}", parent=parent, child=child, xyz=xyz, rpy=turns[i])
    return text + "</robot>"
