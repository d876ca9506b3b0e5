"""Faults of joints put into simulated recordings: wrong encoders, and a joint that is hit.

Like the faults of SUs, each is a function of a simulated recording and a generator that draws which
joint it strikes, when, and how hard; :data:`JOINT_FAULTS` has them all by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.simulation.faults import Faulty, Injection, Sound, in_two
from skin2urdf.simulation.mechanism import load_mechanism
from skin2urdf.simulation.sensors import Sensor
from skin2urdf.simulation.simulate import base_rpy
from skin2urdf.simulation.streams import Draw, record_joints, record_sus, shift_clock
from skin2urdf.simulation.trajectory import JointMotion

_WHEN = (0.3, 0.7)
"""Part of a recording in which an encoder's zero changes."""


def encoder_jump(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An encoder whose zero changes by 1 to 10 deg from one sample to the next."""
    joint, size, begin = _jump(sound, rng)
    words = f"{np.rad2deg(size):.2f} deg at {begin:.2f} s"
    return _misreported(sound, joint, "encoder jump", words, lambda t, x: x + size * (t >= begin))


def encoder_slip(sound: Sound, rng: np.random.Generator) -> Faulty:
    """A coupling that slips by 1 to 10 deg within 0.1 to 1 s, while the robot changes its pose."""
    joint, size, wanted = _jump(sound, rng)
    truth = sound.simulation.truth
    moves = [
        p for p in truth.phases if p.kind == "move" and p.end - truth.start < 0.95 * _end(sound)
    ]
    middle = np.array([(p.start + p.end) / 2 for p in moves]) - truth.start
    at = float(middle[np.argmin(np.abs(middle - wanted))])
    width = rng.uniform(0.02, 0.2)
    words = f"{np.rad2deg(size):.2f} deg around {at:.2f} s"
    return _misreported(
        sound, joint, "encoder jump", words,
        lambda t, x: x + size / (1 + np.exp(-np.clip((t - at) / (width / 2), -50, 50))),
    )  # fmt: skip


def encoder_scale(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An encoder that reports 1.02 to 1.1 times the true motion, or as much less."""
    joint = _one_of(sound, rng)
    factor = rng.uniform(1.02, 1.1) ** rng.choice([-1, 1])
    return _misreported(
        sound, joint, "encoder scale", f"times {factor:.4f}", lambda _, x: factor * x
    )


def gear_ratio(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An encoder that reports half or twice the true motion."""
    joint = _one_of(sound, rng)
    factor = float(rng.choice([0.5, 2.0]))
    return _misreported(sound, joint, "encoder scale", f"times {factor}", lambda _, x: factor * x)


def encoder_sign(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An encoder that counts the other way in the second of two logs."""
    joint = _one_of(sound, rng)
    first, second = in_two(sound)
    joints = tuple(
        replace(j, position=-j.position) if j.name == joint else j for j in second.joints
    )
    return Faulty((first, replace(second, joints=joints)), "encoder sign", (joint,), "in log 2")


def encoder_turn(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An encoder that counts the other way from some time on.

    Its position takes the other sign, or goes on from where it is.
    """
    joint, at = _one_of(sound, rng), float(rng.uniform(*_WHEN) * _end(sound))
    goes_on = bool(rng.integers(2))

    def mirrored(t: F64, x: F64) -> F64:
        begin = int(np.searchsorted(t, at))
        about = x[begin - 1] if goes_on else 0.0
        return np.concatenate([x[:begin], 2 * about - x[begin:]])

    words = f"from {at:.2f} s on{'' if goes_on else ', with its sign'}"
    return _misreported(sound, joint, "encoder sign", words, mirrored)


def contact(sound: Sound, rng: np.random.Generator) -> Faulty:
    """A joint that is hit or pushed during a pattern (a move without any), for 30 to 300 ms.

    It gives way with 0.05 to 0.15 rad/s, and comes back. Its encoder, on the other side of a gear
    that gives way as well, sees up to half of that.
    """
    truth, settings = sound.simulation.truth, sound.settings
    d = int(rng.integers(len(truth.joint_names)))
    wanted = "pattern" if any(p.kind == "pattern" for p in truth.phases) else "move"
    busy = [p for p in truth.phases if p.kind == wanted and p.end - p.start > 0.6]
    phase = busy[int(rng.integers(len(busy)))]
    at = rng.uniform(phase.start + 0.3, phase.end - 0.3)
    length, seen = rng.uniform(0.03, 0.3), rng.uniform(0.0, 0.5)
    size = rng.uniform(0.05, 0.15) * length * rng.choice([-1, 1])

    def hit(motion: JointMotion, joint: int, part: float) -> JointMotion:
        position = np.array(motion.position)
        inside = np.abs(motion.time - at) < length / 2
        angle = np.pi * (motion.time[inside] - at) / length
        position[inside, joint] += part * size * np.cos(angle) ** 4
        return JointMotion(motion.time, position)

    moved = sound.simulation.moved
    sensors = [
        Sensor(settings.sensor_grade, matrix, bias)
        for matrix, bias in zip(truth.sensor_matrix, truth.bias, strict=True)
    ]
    true = hit(moved.motion, int(moved.rows[d]), 1.0)
    reported = hit(moved.motor, d, seen)
    draw = Draw(settings.seed)
    # The same sensors, clocks and noise as without the hit.
    sus = record_sus(moved.mechanism, true, moved.sus, sensors, truth.lag, settings, draw)
    mechanism = load_mechanism(sound.robot, base_rpy(sound.robot, settings))
    joints = record_joints(mechanism, reported, settings, draw)
    recording = replace(
        sound.recording,
        joints=shift_clock(joints, -truth.start),
        sus=shift_clock(sus, -truth.start),
    )
    words = (
        f"{1e3 * length:.0f} ms, {1e3 * abs(size):.1f} mrad at {at - truth.start:.2f} s, "
        f"{100 * seen:.0f} % seen"
    )
    return Faulty((recording,), "contact", (truth.joint_names[d],), words)


JOINT_FAULTS: Mapping[str, Injection] = MappingProxyType(
    {
        function.__name__: function
        for function in (
            encoder_jump, encoder_slip, encoder_scale, gear_ratio, encoder_sign,
            encoder_turn, contact,
        )
    }
)  # fmt: skip
"""All faults of joints by name."""


def _one_of(sound: Sound, rng: np.random.Generator) -> str:
    joints = sound.recording.joints
    return joints[int(rng.integers(len(joints)))].name


def _end(sound: Sound) -> float:
    return sound.recording.duration


def _jump(sound: Sound, rng: np.random.Generator) -> tuple[str, float, float]:
    """A joint, the change of its zero [rad], and when it changes [s]."""
    size = np.deg2rad(rng.uniform(1.0, 10.0)) * rng.choice([-1, 1])
    return _one_of(sound, rng), float(size), float(rng.uniform(*_WHEN) * _end(sound))


def _misreported(
    sound: Sound, name: str, kind: str, words: str, report: Callable[[F64, F64], F64]
) -> Faulty:
    """A recording in which one encoder reports a function of time and position."""

    def wrong(joint: JointStream) -> JointStream:
        if joint.name != name:
            return joint
        return replace(joint, position=report(joint.time, joint.position))

    recording: Recording = sound.recording
    joints = tuple(wrong(joint) for joint in recording.joints)
    return Faulty((replace(recording, joints=joints),), kind, (name,), words)
