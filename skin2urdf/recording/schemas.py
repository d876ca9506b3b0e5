"""ROS interface definitions of the messages a log is written with (schema encoding "ros2msg").

The definitions of ROS 2's std_msgs, builtin_interfaces, geometry_msgs and sensor_msgs, each
followed by those it refers to (https://mcap.dev/spec/registry#ros2msg).
"""

from __future__ import annotations

from skin2urdf.recording.messages import IMU, JOINT_STATE

_DEFINITIONS = {
    "builtin_interfaces/Time": """\
# Seconds and nanoseconds since the epoch of the clock.
int32 sec
uint32 nanosec
""",
    "std_msgs/Header": """\
builtin_interfaces/Time stamp
# The frame the data belongs to.
string frame_id
""",
    "geometry_msgs/Quaternion": """\
float64 x 0
float64 y 0
float64 z 0
float64 w 1
""",
    "geometry_msgs/Vector3": """\
float64 x
float64 y
float64 z
""",
    "sensor_msgs/JointState": """\
std_msgs/Header header
string[] name
# rad, or m for a prismatic joint
float64[] position
# rad/s or m/s
float64[] velocity
# Nm or N
float64[] effort
""",
    "sensor_msgs/Imu": """\
std_msgs/Header header
geometry_msgs/Quaternion orientation
# A covariance is row-major about x, y, z; -1 in its first element: not measured.
float64[9] orientation_covariance
# rad/s
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
# m/s^2
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
""",
}
_REFERS_TO = {
    JOINT_STATE: ("std_msgs/Header", "builtin_interfaces/Time"),
    IMU: (
        "std_msgs/Header",
        "builtin_interfaces/Time",
        "geometry_msgs/Quaternion",
        "geometry_msgs/Vector3",
    ),
}


def schema_text(ros_type: str) -> bytes:
    """Return the definition of a message type with all it refers to.

    Args:
        ros_type: "sensor_msgs/msg/JointState" or "sensor_msgs/msg/Imu".

    Returns:
        The text of an MCAP schema of encoding "ros2msg".
    """
    separator = "=" * 80
    text = _DEFINITIONS[ros_type.replace("/msg/", "/")]
    for name in _REFERS_TO[ros_type]:
        text += f"{separator}\nMSG: {name}\n{_DEFINITIONS[name]}"
    return text.encode()
