"""Profiles over lags: how wide the best place is, and when it is certain."""

from __future__ import annotations

from skin2urdf.arrays import F64

CERTAIN = 20.0
"""Logarithm of the likelihood by which the best line is above any elsewhere: 10 for each of its
numbers, offset and drift, which chance does once in 20,000."""


def valley(profile: F64) -> tuple[int, int]:
    """First and last index of the valley around the lowest place of a profile."""
    a = b = int(profile.argmin())
    while a > 0 and profile[a - 1] >= profile[a]:
        a -= 1
    while b < len(profile) - 1 and profile[b + 1] >= profile[b]:
        b += 1
    return a, b
