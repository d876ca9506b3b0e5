"""Build CDR payloads of one stream as a matrix of bytes, one message a row."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.gather import U8

LITTLE_ENDIAN_CDR = b"\x00\x01\x00\x00"
NOT_MEASURED = [-1.0] + [0.0] * 8


def joint_state_payloads(
    stamp: Int, names: Sequence[str], position: F64, effort: F64 | None = None
) -> U8:
    """Build sensor_msgs/msg/JointState payloads without velocities.

    Args:
        stamp: (N,) header stamps [ns].
        names: J joint names.
        position: (N, J) positions [rad or m].
        effort: (N, J) efforts [N m or N]; None to leave them out.

    Returns:
        (N, L) payloads, little endian.
    """
    body = _padded(_string(b"", ""), 4) + struct.pack("<I", len(names))
    for name in names:
        body = _string(body, name)
    body = _padded(body, 4) + struct.pack("<I", len(names))
    if effort is None:
        return _rows(stamp, _padded(body, 8), position, struct.pack("<II", 0, 0))
    # Doubles are 8 bytes, and so are the two lengths between them: all stay aligned.
    lengths = np.frombuffer(struct.pack("<II", 0, len(names)), "<f8")
    between = np.broadcast_to(lengths, (len(stamp), 1))
    return _rows(stamp, _padded(body, 8), np.hstack([position, between, effort]), b"")


def imu_payloads(
    stamp: Int, frame_id: str, specific_force: F64, angular_velocity: F64 | None = None
) -> U8:
    """Build sensor_msgs/msg/Imu payloads that say that no orientation was measured.

    Args:
        stamp: (N,) header stamps [ns].
        frame_id: frame of the readings.
        specific_force: (N, 3) linear acceleration [m/s^2].
        angular_velocity: (N, 3) readings of a gyroscope [rad/s]; None to say that there is none.

    Returns:
        (N, L) payloads, little endian.
    """
    orientation = [0.0, 0.0, 0.0, 1.0, *NOT_MEASURED]
    if angular_velocity is not None:
        body = _padded(_string(b"", frame_id), 8) + struct.pack("<13d", *orientation)
        # All zeros say of a covariance that it is not known.
        unknown = np.zeros((len(stamp), 9))
        values = np.hstack([angular_velocity, unknown, specific_force, unknown])
        return _rows(stamp, body, values, b"")
    ahead = struct.pack("<25d", *orientation, 0.0, 0.0, 0.0, *NOT_MEASURED)
    behind = struct.pack("<9d", *[0.0] * 9)
    return _rows(stamp, _padded(_string(b"", frame_id), 8) + ahead, specific_force, behind)


def _rows(stamp: Int, ahead: bytes, values: F64, behind: bytes) -> U8:
    """Put stamps and values between what all messages share.

    Args:
        stamp: (N,) header stamps [ns].
        ahead: what lies between the stamp and the values.
        values: (N, C) doubles of each message.
        behind: what lies behind the values.

    Returns:
        (N, L) payloads.
    """
    layout = np.dtype(
        [
            ("encapsulation", np.void, 4),
            ("sec", "<i4"),
            ("nanosec", "<u4"),
            ("ahead", np.void, len(ahead)),
            ("values", "<f8", (values.shape[1],)),
            ("behind", np.void, len(behind)),
        ]
    )
    rows = np.empty(stamp.size, layout)
    rows["encapsulation"] = np.void(LITTLE_ENDIAN_CDR)
    rows["sec"], rows["nanosec"] = np.divmod(stamp, 1_000_000_000)
    rows["ahead"] = np.void(ahead)
    rows["values"] = values
    rows["behind"] = np.void(behind)
    return rows.view(np.uint8).reshape(stamp.size, layout.itemsize)


def _string(body: bytes, text: str) -> bytes:
    """Append a string to a body whose first 8 bytes, the stamp, are left out."""
    encoded = text.encode() + b"\0"
    return _padded(body, 4) + struct.pack("<I", len(encoded)) + encoded


def _padded(body: bytes, size: int) -> bytes:
    """Pad a body (its stamp of 8 bytes left out) so that the next field is aligned."""
    return body + bytes(-len(body) % size)
