"""The streams a log would hold: samples of the true motion, through sensors and clocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import pi
from typing import TypeVar

import numpy as np

from skin2urdf.arrays import F64, frozen
from skin2urdf.recording.records import JointStream, SuStream
from skin2urdf.simulation.defects.records import Defect, Felt
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.sensors import Sensor, encode, stamp
from skin2urdf.simulation.settings import SimulationSettings
from skin2urdf.simulation.skins import PlacedSu
from skin2urdf.simulation.specific_force import felt_motions
from skin2urdf.simulation.trajectory import JointMotion

Stream = TypeVar("Stream", JointStream, SuStream)


class Draw:
    """Independent generators by purpose, so that one option does not change what others draw."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def __call__(self, purpose: str) -> np.random.Generator:
        """Return the generator for a purpose, always in the same state."""
        return np.random.default_rng([self._seed, *purpose.encode()])


def draw_for(draw: Draw, defect: Defect, whom: str = "") -> np.random.Generator:
    """The generator for what a defect does to somebody, whatever other defects there are."""
    return draw(f"{type(defect).__name__} {whom}")


def record_joints(
    mechanism: Mechanism,
    motion: JointMotion,
    settings: SimulationSettings,
    draw: Draw,
    torque: Callable[[F64], F64] | None = None,
) -> tuple[JointStream, ...]:
    """Sample the encoders.

    Args:
        mechanism: the robot.
        motion: what its encoders see.
        settings: rate, resolutions, jitter.
        draw: source of the jitter.
        torque: what the gears bear (N, D) at times (N,) of the motion's clock, where that is
            measured [N m or N].

    Returns:
        D streams sorted by name that share one time array, on the motion's clock.
    """
    time = _sample_times(motion, settings.joint_rate)
    resolution = np.zeros(mechanism.n_joints)
    if settings.encoder_bits:
        angular = 2 * pi / 2**settings.encoder_bits
        resolution = np.where(mechanism.prismatic, settings.linear_resolution, angular)
    position = encode(motion.at(time)[0], resolution)
    stamps = frozen(stamp(time, settings.jitter, 0.0, draw("joint clock")))
    by_name = sorted(enumerate(mechanism.joint_names), key=lambda item: item[1])
    if torque is None or settings.torque_noise is None:
        return tuple(JointStream(name, stamps, position[:, d]) for d, name in by_name)
    noise = settings.torque_noise * draw("torque").standard_normal(position.shape)
    effort = torque(time) + noise
    return tuple(
        JointStream(name, stamps, position[:, d], effort=effort[:, d]) for d, name in by_name
    )


def record_sus(
    mechanism: Mechanism,
    motion: JointMotion,
    sus: Sequence[PlacedSu],
    sensors: Sequence[Sensor],
    lag: F64,
    settings: SimulationSettings,
    draw: Draw,
    gyros: Sequence[Sensor] = (),
    tell: Callable[[float], None] = lambda _: None,
) -> tuple[SuStream, ...]:
    """Sample the accelerometers and gyroscopes of all SUs, each SU on its own clock.

    Args:
        mechanism: the robot.
        motion: what its joints do.
        sus: U SUs, of which the robot's joints may be more than those that are recorded.
        sensors: their U accelerometers.
        lag: (U,) lags of their clocks [s].
        settings: rate, jitter, stagger, defects.
        draw: source of phases, noise and jitter.
        gyros: their U gyroscopes; none for SUs without.
        tell: told the share of the work that is done.

    Returns:
        U streams in the order of the SUs, on the motion's clock.
    """
    time = _sample_times(motion, settings.imu_rate)
    forces, turns = felt_motions(mechanism, motion, sus, time, rates=bool(gyros))
    phase = draw("phase").uniform(0.0, float(settings.stagger), len(sus)) / settings.imu_rate
    noise, clock = draw("noise"), draw("SU clock")
    streams = []
    speeds = np.abs(motion.at(time)[1]) if settings.defects else np.empty((0, 0))
    forces.reverse()
    turns.reverse()
    turning = draw("gyroscope noise")
    for u, su in enumerate(sus):
        tell(0.5 + 0.5 * u / len(sus))
        # Of a long recording there is no room for what the SUs feel and what they report.
        defects = [(defect, draw_for(draw, defect, su.name)) for defect in settings.defects]
        force = forces.pop()
        if defects:
            felt = Felt(su.name, time, force, speeds[:, _chain(mechanism, su.joint)].sum(axis=1))
            for defect, rng in defects:
                felt = replace(felt, force=defect.shake(felt, rng))
            for defect, rng in defects:
                felt = replace(felt, force=defect.sense(felt, rng))
            force = felt.force
        sampled, force = _shifted(time, force, phase[u])
        rates = None
        if gyros:
            _, rate = _shifted(time, turns.pop(), phase[u])
            rates = gyros[u].read(rate, turning)
        shown = sampled
        for defect, rng in defects:
            shown = defect.clock(shown, rng)
        stamps = stamp(shown, settings.jitter, lag[u], clock)
        stream = SuStream(su.name, stamps, sensors[u].read(force, noise), su.topic, rates)
        for defect, rng in defects:
            stream = defect.send(stream, rng)
        streams.append(stream)
    return tuple(streams)


def shift_clock(streams: Sequence[Stream], shift: float) -> tuple[Stream, ...]:
    """Add a time to all stamps; streams that share a time array still do [s]."""
    shifted = {id(stream.time): frozen(stream.time + shift) for stream in streams}
    return tuple(replace(stream, time=shifted[id(stream.time)]) for stream in streams)


def _chain(mechanism: Mechanism, joint: int) -> list[int]:
    """A joint and all that carry it; none for -1."""
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = int(mechanism.parent[joint])
    return chain


def _sample_times(motion: JointMotion, rate: float) -> F64:
    """Regular sampling instants over the whole motion [s]."""
    return np.arange(int(motion.time[-1] * rate) + 1) / rate


def _shifted(time: F64, force: F64, phase: float) -> tuple[F64, F64]:
    """Sampling instants moved by less than a period, and what (N - 1, 3) is felt there.

    A quintic spline through the samples is as good as the truth for motion far below the sampling
    rate, and spares a pass through the robot's dynamics for every SU.
    """
    if phase == 0.0:
        return time[:-1], force[:-1]
    from scipy.interpolate import make_interp_spline

    sampled = time[:-1] + phase
    return sampled, np.asarray(make_interp_spline(time, force, k=5)(sampled))
