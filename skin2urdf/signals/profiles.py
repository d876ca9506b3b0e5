"""The valley around the lowest place of a profile over lags."""

from __future__ import annotations

from skin2urdf.arrays import F64


def valley(profile: F64) -> tuple[int, int]:
    """First and last index of the valley around the lowest place of a profile."""
    a = b = int(profile.argmin())
    while a > 0 and profile[a - 1] >= profile[a]:
        a -= 1
    while b < len(profile) - 1 and profile[b + 1] >= profile[b]:
        b += 1
    return a, b
