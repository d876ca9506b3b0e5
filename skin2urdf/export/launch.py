"""A ROS 2 launch file that publishes where the SUs are, as static transforms."""

from __future__ import annotations

from skin2urdf.export.source import Source, T_link_su, decimal, quaternion

_HEAD = """\
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# parent frame, SU frame, (x, y, z) [m], (qx, qy, qz, qw)
TRANSFORMS = [
"""
_TAIL = """\
]


def generate_launch_description():
    prefix = LaunchConfiguration("prefix")
    nodes = [
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            name=f"skin_transform_{number}",
            arguments=[
                *("--frame-id", [prefix, parent], "--child-frame-id", [prefix, child]),
                *(word for key, value in zip(("x", "y", "z"), xyz) for word in ("--" + key, value)),
                *(
                    word
                    for key, value in zip(("qx", "qy", "qz", "qw"), quaternion)
                    for word in ("--" + key, value)
                ),
            ],
        )
        for number, (parent, child, xyz, quaternion) in enumerate(TRANSFORMS)
    ]
    return LaunchDescription(
        [DeclareLaunchArgument("prefix", default_value="", description="of all frames"), *nodes]
    )
"""


def to_launch(source: Source) -> str:
    """A launch file with a static transform publisher per SU, each frame with one parent.

    It is for robots whose own frames come from elsewhere, such as the vendor's description. Where
    ``robot_state_publisher`` publishes the calibrated URDF the SUs' frames are there already.

    Args:
        source: what to export.

    Returns:
        The text of a Python file.

    Raises:
        UsageError: the log tells of no SU where it sits.
    """
    rows = []
    for su in source.placed_sus():
        T = T_link_su(su)
        w, x, y, z = quaternion(T[:3, :3])
        xyz, turn = (
            "(" + ", ".join(repr(decimal(value)) for value in values) + ")"
            for values in (T[:3, 3], (x, y, z, w))
        )
        rows += [f"    # OPEN: {words}\n" for words in map(_one_line, su.open_words)]
        rows.append(f"    ({su.joint.parent!r}, {su.name!r}, {xyz}, {turn}),\n")
    said = "".join(f"# {_one_line(line)}\n" for line in source.header)
    use = (
        "# Frames of the robot come from elsewhere; where robot_state_publisher has the\n"
        "# calibrated URDF, those of the SUs do as well, and this file must not run beside it.\n"
    )
    return said + use + _HEAD + "".join(rows) + _TAIL


def _one_line(text: str) -> str:
    """Words that can stand in a comment."""
    return " ".join(text.split())
