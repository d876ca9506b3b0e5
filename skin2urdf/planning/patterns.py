"""Patterns: every joint swings about a pose with several frequencies of its own, all at once.

One tone can not tell a lever arm from the turning of gravity, nor from the droop of the sensor's
low-pass: position and acceleration are proportional. Tones of all joints differ, so that what an SU
feels can be told apart by joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.planning.records import Limits, PlanSettings
from skin2urdf.planning.trajectory import JointTrajectory

_STEP = 0.04
"""Time between points [s]. Polynomials of fifth order through points of a tone of 2.6 Hz so far
apart leave it by a millionth, and its acceleration by a thousandth."""
_FEW = 10
"""Joints up to which each gets three tones; more have two, or patterns would take too long."""
_DRAWS = 64
"""Random phases of which those with the lowest peaks are taken."""
_ROOM = 0.97
"""Share of a limit that is planned for."""
_SWING = 0.2
"""Largest swing to either side, over the range of positions."""


@dataclass(frozen=True, eq=False)
class Tones(Record):
    """Tones of D joints, T each.

    Attributes:
        frequency: (D, T) [Hz].
        phase: (D, T) [rad].
    """

    frequency: F64
    phase: F64

    @property
    def apart(self) -> float:
        """Time over which tones are linearly independent [s].

        Cosines spaced by f are over 1 / (2 f) or more: the sampling theorem with time and frequency
        exchanged. A fifth is added for the flanks of the window.
        """
        all_ = np.sort(self.frequency.ravel())
        return float(1.2 * 0.5 / np.diff(all_).min()) if len(all_) > 1 else 0.0


def draw_tones(n_joints: int, band: tuple[float, float], rng: np.random.Generator) -> Tones:
    """Frequencies of all joints: each gets one from each part of the band, evenly spaced.

    Args:
        n_joints: D.
        band: lowest and highest [Hz].
        rng: decides who gets which, and draws phases.
    """
    each = 3 if n_joints <= _FEW else 2
    grid = np.linspace(*band, each * n_joints).reshape(each, n_joints)
    frequency = np.column_stack([rng.permutation(part) for part in grid])
    phase = np.empty_like(frequency)
    time = np.arange(0.0, 8.0, _STEP)
    for d, own in enumerate(frequency):
        draws = rng.uniform(0.0, 2 * np.pi, (_DRAWS, each))
        waves = np.cos(2 * np.pi * own[:, None] * time + draws[..., None]).sum(axis=1)
        phase[d] = draws[np.abs(waves).max(axis=1).argmin()]
    return Tones(frequency, phase)


def waveform(tones: Tones, time: F64, duration: float, ramp: float) -> tuple[F64, F64, F64]:
    """Offset, speed and acceleration of joints whose tones have an acceleration of 1 each.

    Args:
        tones: of D joints.
        time: (N,) times since the pattern began [s].
        duration: its length [s].
        ramp: duration of either flank of its window [s].

    Returns:
        Three (N, D) arrays, all 0 at both ends.
    """
    w = 2 * np.pi * tones.frequency
    angle = w * time[:, None, None] + tones.phase
    wave = (-np.cos(angle) / w**2).sum(axis=2)
    speed = (np.sin(angle) / w).sum(axis=2)
    force = np.cos(angle).sum(axis=2)
    f, fd, fdd = (x[:, None] for x in _window(time, duration, ramp))
    return (
        f * wave,
        fd * wave + f * speed,
        fdd * wave + 2 * fd * speed + f * force,
    )


def pattern(
    pose: F64, tones: Tones, amplitude: F64, duration: float, ramp: float, limits: Limits
) -> JointTrajectory:
    """A pattern around a pose.

    Args:
        pose: (D,) the pose [rad or m].
        tones: of D joints.
        amplitude: (D,) acceleration of each tone [rad/s^2 or m/s^2]; its sign counts.
        duration: [s].
        ramp: duration of either flank of its window [s].
        limits: whose joints they are.
    """
    n = int(np.ceil(duration / _STEP))
    time = np.linspace(0.0, duration, n + 1)
    q, qd, qdd = (x * amplitude for x in waveform(tones, time, duration, ramp))
    q[-1] = qd[-1] = qdd[-1] = 0.0
    return JointTrajectory(limits.joint_names, time, pose + q, qd, qdd)


def largest_amplitudes(
    tones: Tones, limits: Limits, settings: PlanSettings, duration: float
) -> tuple[F64, F64]:
    """What limits allow of each joint's tones, and how far it then swings.

    Returns:
        (D,) acceleration of each tone [rad/s^2 or m/s^2], and (D,) swing to either side [rad or m],
        however long the pattern lasts.
    """
    zero = np.zeros(limits.n_joints)
    one = pattern(zero, tones, zero + 1.0, duration, settings.ramp, limits)
    _, *rest = (np.abs(x).max(axis=(0, 1)) for x in one.dense())
    q = ((2 * np.pi * tones.frequency) ** -2.0).sum(axis=1)
    room = np.minimum(
        limits.upper - limits.lower,
        2 * np.where(limits.prismatic, settings.half_range[1], settings.half_range[0]),
    )
    most = [_SWING * room / q]
    most += [
        _ROOM * limit / x
        for limit, x in zip((limits.velocity, limits.acceleration, limits.jerk), rest, strict=True)
    ]
    amplitude = np.min(most, axis=0)
    return amplitude, amplitude * q


def _window(time: F64, duration: float, ramp: float) -> tuple[F64, F64, F64]:
    """The window of a pattern and its first two derivatives (N,); C3 everywhere."""
    up = _smooth_step(time / ramp)
    down = _smooth_step((duration - time) / ramp)
    f = up[0] * down[0]
    fd = (up[1] * down[0] - up[0] * down[1]) / ramp
    fdd = (up[2] * down[0] - 2 * up[1] * down[1] + up[0] * down[2]) / ramp**2
    return f, fd, fdd


def _smooth_step(x: F64) -> tuple[F64, F64, F64]:
    """Step 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7 from 0 to 1 and its first two derivatives."""
    x = np.clip(x, 0.0, 1.0)
    y = 1.0 - x
    return (
        x**4 * (35.0 + x * (-84.0 + x * (70.0 - 20.0 * x))),
        140.0 * x**3 * y**3,
        420.0 * x**2 * y**2 * (1.0 - 2.0 * x),
    )
