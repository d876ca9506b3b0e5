"""The reference trajectory: structural moves, rests in random poses, patterns around each pose.

Or none of it: moves from one random pose to the next, as any program of a robot makes them, or all
joints on and on, as for dynamic identification.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from skin2urdf.arrays import F64, Record
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.motion_settings import MotionSettings
from skin2urdf.simulation.pattern import Tones, distinct_time, swing, tone_pairs
from skin2urdf.simulation.settings import Excitation
from skin2urdf.simulation.trajectory import GRID, JointMotion, PathBuilder, Phase

_LIMIT_MARGIN = 0.03
"""Room kept to the limits for sag and overshoot [rad; a tenth of it in m]."""


@dataclass(frozen=True, eq=False)
class Reference(Record):
    """What the robot is commanded to do.

    Attributes:
        motion: the trajectory.
        phases: what it does when, without gaps.
        poses: (P, D) poses in the order visited [rad or m].
    """

    motion: JointMotion
    phases: tuple[Phase, ...]
    poses: F64


def plan_reference(
    mechanism: Mechanism,
    reach: F64,
    settings: MotionSettings,
    n_poses: int,
    excite: Excitation,
    rng: np.random.Generator,
    structural: bool = True,
) -> Reference:
    """Plan the trajectory of a recording with patterns.

    Args:
        mechanism: the robot.
        reach: (D,) longest lever arm of each DoF [m].
        settings: shape and size of the motion.
        n_poses: number P of poses.
        excite: "one" DoF after the other or "all" at once.
        rng: source of poses, steps and signs.
        structural: begin with a move of each DoF alone.

    Returns:
        A C3 trajectory inside the joint limits that starts and ends at rest.
    """
    tones = _tones(mechanism, reach, settings, excite, rng)
    amplitude = np.array([swing(t) for t in tones])
    lower, upper = _pose_range(mechanism, settings, amplitude)
    speed = _move_speed(mechanism, settings)
    home = lower + (upper - lower) * rng.uniform(0.45, 0.55, mechanism.n_joints)
    poses = _visiting_order(home, rng.uniform(lower, upper, (n_poses, mechanism.n_joints)), speed)

    distinct = settings.ramp + distinct_time(mechanism.n_joints, settings.frequency_band)
    path = PathBuilder(home)
    path.rest(settings.rest)
    targets = _structural_targets(mechanism, settings, home, lower, upper, rng)
    if structural:
        _move_one_by_one(path, home, targets, speed, 0.7 * settings.rest)
    for p, pose in enumerate(poses):
        path.move_to(pose, speed, "move")
        path.rest(settings.rest, p)
        signs = rng.choice([-1.0, 1.0], mechanism.n_joints)
        signed = [[(f, sign * a) for f, a in t] for sign, t in zip(signs, tones, strict=True)]
        if excite == "one":
            for joint, own in enumerate(signed):
                path.excite({joint: own}, settings.pattern_time, settings.ramp, p)
        else:
            duration = max(settings.pattern_time_all, distinct)
            path.excite(dict(enumerate(signed)), duration, settings.ramp, p)
        path.rest(0.5 * settings.rest, p)
    return Reference(path.motion(), tuple(path.phases), poses)


def plan_moves(
    mechanism: Mechanism,
    settings: MotionSettings,
    duration: float,
    rng: np.random.Generator,
    structural: bool = False,
) -> Reference:
    """Plan the trajectory of a recording without patterns: all DoFs from pose to pose.

    Args:
        mechanism: the robot.
        settings: speed, acceleration, rests, range.
        duration: how long to go on; the last move is finished [s].
        rng: source of poses, speeds and accelerations.
        structural: begin with a move of each DoF alone.

    Returns:
        A C3 trajectory inside the joint limits that starts and ends at rest.
    """
    lower, upper = _pose_range(mechanism, settings, np.zeros(mechanism.n_joints))
    home = rng.uniform(lower, upper)
    path = PathBuilder(home)
    path.rest(settings.ordinary_rest)
    if structural:
        targets = _structural_targets(mechanism, settings, home, lower, upper, rng)
        speed = _move_speed(mechanism, settings)
        _move_one_by_one(path, home, targets, speed, settings.ordinary_rest)
    scale = np.where(mechanism.prismatic, settings.linear_speed / settings.angular_speed, 1.0)
    poses: list[F64] = []
    while path.end < duration:
        pose = rng.uniform(lower, upper)
        speed_limit = float(np.min(0.9 * mechanism.speed_limit / scale))
        path.cruise_to(
            pose,
            min(rng.uniform(*settings.ordinary_speed), speed_limit),
            rng.uniform(*settings.ordinary_acceleration),
            scale,
        )
        path.rest(settings.ordinary_rest, len(poses))
        poses.append(pose)
    return Reference(path.motion(), tuple(path.phases), np.reshape(poses, (-1, len(home))))


def plan_series(
    mechanism: Mechanism, settings: MotionSettings, duration: float, rng: np.random.Generator
) -> Reference:
    """Plan the trajectory of a robot that never rests: each DoF follows a Fourier series.

    That is how robots are moved to identify their dynamics (Swevers et al. 1997). The log begins on
    the way.

    Args:
        mechanism: the robot.
        settings: frequencies, speed, range.
        duration: length of the trajectory [s].
        rng: source of amplitudes and phases.

    Returns:
        A smooth trajectory inside the joint limits.
    """
    D = mechanism.n_joints
    lower, upper = _pose_range(mechanism, settings, np.zeros(D))
    time = np.arange(0.0, duration + 0.5 * GRID, GRID)
    lowest, highest = settings.series_band
    w = 2 * pi * lowest * np.arange(1, round(highest / lowest) + 1)
    size = rng.standard_normal((D, len(w))) * (w[0] / w) ** 0.7
    phase = rng.uniform(0, 2 * pi, (D, len(w)))
    wave = np.stack([np.sin(np.outer(time, w) + p) @ a for a, p in zip(size, phase, strict=True)])
    middle, reach = 0.5 * (wave.max(axis=1) + wave.min(axis=1)), 0.5 * np.ptp(wave, axis=1)
    speed = np.abs(np.diff(wave, axis=1)).max(axis=1) / GRID
    factor = np.minimum(0.5 * (upper - lower) / reach, _move_speed(mechanism, settings) / speed)
    position = (0.5 * (lower + upper))[:, None] + factor[:, None] * (wave - middle[:, None])
    phases = (Phase("move", 0.0, float(time[-1])),)
    return Reference(JointMotion(time, position.T), phases, np.zeros((0, D)))


def _move_one_by_one(path: PathBuilder, home: F64, targets: F64, speed: F64, rest: float) -> None:
    """Move each DoF alone to its target and back."""
    for joint, target in enumerate(targets):
        away = home.copy()
        away[joint] = target
        for goal in (away, home):
            path.move_to(goal, speed, "structural", joint)
            path.rest(rest)


def _tones(
    mechanism: Mechanism,
    reach: F64,
    settings: MotionSettings,
    excite: Excitation,
    rng: np.random.Generator,
) -> list[Tones]:
    """Frequencies and peak accelerations of every DoF's pattern."""
    lowest, highest = settings.angular_acceleration
    angular = np.clip(settings.tip_acceleration / np.maximum(reach, 1e-3), lowest, highest)
    peak = np.where(mechanism.prismatic, settings.linear_acceleration, angular)
    if excite == "one":
        frequencies = np.full((mechanism.n_joints, 1), settings.frequency)
    else:
        frequencies = tone_pairs(mechanism.n_joints, settings.frequency_band, rng)
        # Accelerations of independent tones add up like the root of their number.
        peak = peak / np.sqrt(2.0 * mechanism.n_joints)
    tones: list[Tones] = []
    room = mechanism.upper - mechanism.lower
    for d, pair in enumerate(frequencies):
        wanted: Tones = [(float(f), float(peak[d])) for f in pair]
        speed = sum(a / (2 * pi * f) for f, a in wanted)
        factor = min(1.0, 0.9 * mechanism.speed_limit[d] / speed, 0.25 * room[d] / swing(wanted))
        tones.append([(f, factor * a) for f, a in wanted])
    return tones


def _pose_range(mechanism: Mechanism, settings: MotionSettings, amplitude: F64) -> tuple[F64, F64]:
    """(D,) lowest and highest pose from which a pattern stays inside the limits."""
    lower, upper = mechanism.lower, mechanism.upper
    reach = np.where(mechanism.prismatic, settings.half_stroke, settings.half_range)
    # A missing limit stands as far from the other one as the reach allows, or around 0.
    bottom = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, reach))
    bottom = bottom - np.where(np.isfinite(lower), 0.0, 2.0 * reach)
    top = np.where(np.isfinite(upper), upper, bottom + 2.0 * reach)
    room = top - bottom
    margin = np.minimum(np.where(mechanism.prismatic, 0.1, 1.0) * _LIMIT_MARGIN, 0.05 * room)
    half = np.minimum(reach, 0.5 * room - margin - amplitude)
    middle = 0.5 * (bottom + top)
    return middle - half, middle + half


def _move_speed(mechanism: Mechanism, settings: MotionSettings) -> F64:
    """(D,) fastest speed of moves [rad/s or m/s]."""
    wanted = np.where(mechanism.prismatic, settings.linear_speed, settings.angular_speed)
    return np.minimum(wanted, 0.9 * mechanism.speed_limit)


def _structural_targets(
    mechanism: Mechanism,
    settings: MotionSettings,
    home: F64,
    lower: F64,
    upper: F64,
    rng: np.random.Generator,
) -> F64:
    """(D,) where each DoF goes in its structural move, on the side with more room."""
    shortest, longest = settings.step
    relative = rng.uniform(0.4 * shortest / longest, 0.4, mechanism.n_joints) * (upper - lower)
    step = np.where(
        mechanism.prismatic, relative, rng.uniform(shortest, longest, mechanism.n_joints)
    )
    up = upper - home >= home - lower
    step = np.minimum(step, np.where(up, upper - home, home - lower))
    return home + np.where(up, step, -step)


def _visiting_order(home: F64, poses: F64, speed: F64) -> F64:
    """(P, D) the same poses, each time going to the one that is reached soonest."""
    left = list(poses)
    order: list[F64] = []
    here = home
    while left:
        nearest = int(np.argmin([np.max(np.abs(pose - here) / speed) for pose in left]))
        here = left.pop(nearest)
        order.append(here)
    return np.array(order)
