"""The ROS message types a log is read from, and what of them is used."""

from __future__ import annotations

from typing import Literal, TypeAlias

Role: TypeAlias = Literal["joints", "su", "ignored"]

JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"

# How messages are turned into bytes: by ROS 2 and by ROS 1.
ENCODINGS = ("cdr", "ros1")

# Bytes from the first component of the acceleration to the end of the message. Everything behind
# the header of these types has a fixed size (ROS interface definitions, sensor_msgs and
# geometry_msgs): doubles of 8 bytes, 3 to a vector, 9 or 36 to a covariance.
ACCELERATION_TAIL: dict[str, int] = {
    IMU: 8 * (3 + 9),
    "geometry_msgs/msg/AccelStamped": 8 * (3 + 3),
    "geometry_msgs/msg/AccelWithCovarianceStamped": 8 * (3 + 3 + 36),
    "geometry_msgs/msg/Vector3Stamped": 8 * 3,
}

# Bytes between the header and the acceleration: an Imu carries orientation and angular velocity
# with their covariances first.
ACCELERATION_LEAD: dict[str, int] = {IMU: 8 * (4 + 9 + 3 + 9)}


# Bytes between the header and the angular velocity, which its covariance follows.
ANGULAR_VELOCITY_LEAD: dict[str, int] = {IMU: 8 * (4 + 9)}


def canonical_type(name: str) -> str:
    """Return a message type as ``package/msg/Type``; some writers leave the middle out."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


def role_of(ros_type: str) -> Role:
    """Tell what a topic of this type is used as.

    Args:
        ros_type: message type as ``package/msg/Type``.

    Returns:
        "joints", "su" or "ignored".
    """
    if ros_type == JOINT_STATE:
        return "joints"
    return "su" if ros_type in ACCELERATION_TAIL else "ignored"
