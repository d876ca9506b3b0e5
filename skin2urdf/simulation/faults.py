"""Faults of SUs put into simulated recordings, to see whether a calibration finds them.

Each fault is a function of a simulated recording and a generator that draws whom it strikes, when,
and how hard; :data:`FAULTS` has them all by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.simulation.robots import RobotSpec
from skin2urdf.simulation.sensors import Sensor
from skin2urdf.simulation.settings import SimulationSettings
from skin2urdf.simulation.simulate import Simulation
from skin2urdf.simulation.streams import Draw, record_sus, shift_clock

_WHEN = (0.3, 0.7)
"""Part of a recording in which a fault that comes at some time comes."""


@dataclass(frozen=True, eq=False)
class Sound:
    """A simulated recording without a fault, and what it was made from.

    Attributes:
        robot: the robot.
        settings: the settings.
        simulation: the recording and its truth.
    """

    robot: RobotSpec
    settings: SimulationSettings
    simulation: Simulation

    @property
    def recording(self) -> Recording:
        """The recording."""
        return self.simulation.recording


@dataclass(frozen=True, eq=False)
class Faulty:
    """Recordings with one fault.

    Attributes:
        recordings: one log, or several of the same robot.
        kind: the kind that a calibration should name.
        subjects: the SUs or joints that have it.
        words: what was done to them.
    """

    recordings: tuple[Recording, ...]
    kind: str
    subjects: tuple[str, ...]
    words: str


Injection = Callable[[Sound, np.random.Generator], Faulty]


def dead(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU that reads zero all the time."""
    su = _one_of(sound, rng)
    new = replace(su, specific_force=np.zeros_like(su.specific_force))
    return _with(sound, new, "dead", "zeros")


def silent(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU that sends nothing from some time on."""
    su = _one_of(sound, rng)
    n = _sample(su, rng)
    new = su.at(slice(n))
    return _with(sound, new, "dead", f"silent from {su.time[n]:.1f} s on")


def frozen(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU that repeats its last value from some time on."""
    su = _one_of(sound, rng)
    n = _sample(su, rng)
    return _with(sound, _held(su, n, len(su.time)), "frozen", f"from {su.time[n]:.1f} s on")


def stuck(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU that repeats one value for 5 to 20 s."""
    su = _one_of(sound, rng)
    begin = _sample(su, rng)
    end = int(np.searchsorted(su.time, su.time[begin] + rng.uniform(5.0, 20.0)))
    words = f"for {su.time[min(end, len(su.time) - 1)] - su.time[begin]:.1f} s"
    return _with(sound, _held(su, begin, end), "frozen", words)


def saturated(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU on a moving segment whose range ends where 1 to 8 % of its samples lie beyond."""
    su = _one_of(sound, rng, moving=True)
    size = np.abs(su.specific_force).max(axis=1)
    end = float(np.quantile(size, 1 - rng.uniform(0.01, 0.08)))
    new = replace(su, specific_force=np.clip(su.specific_force, -end, end))
    return _with(sound, new, "saturated", f"at {end / GRAVITY:.2f} g")


def dropouts(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU that loses 20 to 50 % of its samples at random."""
    su = _one_of(sound, rng)
    share = rng.uniform(0.2, 0.5)
    kept = rng.random(len(su.time)) > share
    return _with(sound, _only(su, kept), "intermittent", f"{100 * share:.0f} % lost at random")


def gaps(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU that again and again sends nothing for 0.05 to 0.5 s, 10 to 30 % of the time."""
    su = _one_of(sound, rng)
    share = rng.uniform(0.1, 0.3)
    kept = np.ones(len(su.time), dtype=bool)
    t = float(su.time[0])
    while t < su.time[-1]:
        length = rng.uniform(0.05, 0.5)
        t += rng.exponential(0.275 * (1 - share) / share)
        kept &= (su.time < t) | (su.time >= t + length)
        t += length
    words = f"{100 * (1 - kept.mean()):.0f} % lost in gaps"
    return _with(sound, _only(su, kept), "intermittent", words)


def noisy(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU with ten times the noise of the others."""
    su = _one_of(sound, rng)
    sd = 10 * max(sound.settings.sensor_grade.noise_rms, 1e-4) * GRAVITY
    noise = sd * rng.standard_normal(su.specific_force.shape)
    new = replace(su, specific_force=su.specific_force + noise)
    return _with(sound, new, "noisy", f"{sd:.2f} m/s^2")


def unattached(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU of a moving segment that something else turns by 0.2 to 1 rad about two axes."""
    from scipy.spatial.transform import Rotation

    su = _one_of(sound, rng, moving=True)
    size, hertz, phase = rng.uniform([[0.2], [0.1], [0.0]], [[1.0], [0.6], [2 * np.pi]], (3, 2))
    angle = size * np.sin(2 * np.pi * hertz * su.time[:, None] + phase)
    turn = Rotation.random(random_state=rng) * Rotation.from_euler("zx", angle)
    noise = max(sound.settings.sensor_grade.noise_rms, 1e-4) * GRAVITY
    felt = turn.apply([0.0, 0.0, GRAVITY], inverse=True)
    felt += noise * rng.standard_normal(felt.shape)
    words = f"turns by {size.max():.2f} rad"
    return _with(sound, replace(su, specific_force=felt), "unattached", words)


def loose(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU on a moving segment that slips by 3 to 20 mm and 1 to 5 deg at some time."""
    su = _one_of(sound, rng, moving=True)
    distance, angle = rng.uniform(3e-3, 20e-3), np.deg2rad(rng.uniform(1.0, 5.0))
    slip = _slip(distance, angle, rng)
    moved = recorded_after(sound, su.name, slip)
    n = _sample(su, rng)
    both = _joined(su, n, moved, n)
    words = f"{1e3 * distance:.1f} mm, {np.rad2deg(angle):.1f} deg at {su.time[n]:.1f} s"
    return _with(sound, replace(both, time=su.time), "loose", words)


def stepped(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU on a moving segment whose bias steps by 20 to 60 mg at some time."""
    su = _one_of(sound, rng, moving=True)
    step = rng.standard_normal(3)
    step *= rng.uniform(20e-3, 60e-3) / np.linalg.norm(step)
    n = _sample(su, rng)
    force = su.specific_force.copy()
    force[n:] += step * GRAVITY
    words = f"{1e3 * np.linalg.norm(step):.1f} mg at {su.time[n]:.1f} s"
    return _with(sound, replace(su, specific_force=force), "bias step", words)


def swapped(sound: Sound, rng: np.random.Generator) -> Faulty:
    """Two SUs whose names are exchanged in the second of two logs."""
    logs = in_two(sound)
    names = [su.name for su in sound.recording.sus]
    a, b = rng.choice(len(names), 2, replace=False)
    other = {names[a]: names[b], names[b]: names[a]}
    renamed = tuple(
        sorted(
            (replace(su, name=other.get(su.name, su.name)) for su in logs[1].sus),
            key=lambda su: su.name,
        )
    )
    logs = (logs[0], replace(logs[1], sus=renamed))
    return Faulty(logs, "swapped", (names[a], names[b]), f"{names[a]} and {names[b]}")


def renamed(sound: Sound, rng: np.random.Generator) -> Faulty:
    """Two SUs whose names are exchanged at some time."""
    sus = sound.recording.sus
    a, b = (sus[i] for i in rng.choice(len(sus), 2, replace=False))
    at = rng.uniform(*_WHEN) * sound.recording.duration

    def joined(first: SuStream, then: SuStream) -> SuStream:
        n, m = (int(np.searchsorted(su.time, at)) for su in (first, then))
        return _joined(first, n, then, m)

    new = {a.name: joined(a, b), b.name: joined(b, a)}
    recording = replace(sound.recording, sus=tuple(new.get(su.name, su) for su in sus))
    words = f"{a.name} and {b.name} from {at:.1f} s on"
    return Faulty((recording,), "swapped", (a.name, b.name), words)


def mirrored(sound: Sound, rng: np.random.Generator) -> Faulty:
    """An SU on a moving segment that is negated, or left-handed by one axis or two exchanged."""
    su = _one_of(sound, rng, moving=True)
    matrices = {
        "negated": -np.eye(3),
        "z negated": np.diag([1.0, 1.0, -1.0]),
        "x and y exchanged": np.eye(3)[[1, 0, 2]],
    }
    words = str(rng.choice(list(matrices)))
    new = replace(su, specific_force=su.specific_force @ matrices[words].T)
    return _with(sound, new, "mirrored", words)


FAULTS: Mapping[str, Injection] = MappingProxyType(
    {
        function.__name__: function
        for function in (
            dead, silent, frozen, stuck, saturated, dropouts, gaps, noisy, unattached, loose,
            stepped, swapped, renamed, mirrored,
        )
    }
)  # fmt: skip
"""All faults by name."""


def in_two(sound: Sound) -> tuple[Recording, Recording]:
    """The recording as two logs, parted at the rest that is nearest to its middle."""
    truth, recording = sound.simulation.truth, sound.recording
    rests = [p for p in truth.phases if p.kind == "rest" and p.end - p.start > 0.2]
    middles = np.array([0.5 * (p.start + p.end) for p in rests]) - truth.start
    cut = float(middles[np.argmin(np.abs(middles - 0.5 * recording.duration))])
    return (_between(recording, -np.inf, cut), _between(recording, cut, np.inf))


def _between(recording: Recording, begin: float, end: float) -> Recording:
    """The part of a recording between two times, on a clock of its own."""
    start = max(begin, 0.0)

    def part(stream: JointStream | SuStream) -> tuple[F64, slice]:
        a, b = np.searchsorted(stream.time, [begin, end])
        return stream.time[a:b] - start, slice(int(a), int(b))

    joints, sus = [], []
    for joint in recording.joints:
        time, rows = part(joint)
        effort = None if joint.effort is None else joint.effort[rows]
        joints.append(replace(joint, time=time, position=joint.position[rows], effort=effort))
    for su in recording.sus:
        time, rows = part(su)
        sus.append(replace(su.at(rows), time=time))
    return replace(recording, joints=tuple(joints), sus=tuple(sus), start=recording.start + start)


def _one_of(sound: Sound, rng: np.random.Generator, moving: bool = False) -> SuStream:
    """An SU drawn from all of them, or from those on moving segments."""
    on_rs = {su.name for su in sound.simulation.truth.sus if su.joint < 0}
    sus = [su for su in sound.recording.sus if not (moving and su.name in on_rs)]
    return sus[int(rng.integers(len(sus)))]


def _sample(su: SuStream, rng: np.random.Generator) -> int:
    """Number of the sample at which a fault begins."""
    return int(rng.uniform(*_WHEN) * len(su.time))


def _joined(first: SuStream, n: int, then: SuStream, m: int) -> SuStream:
    """The first n samples of a stream, and another one's from its m-th on."""
    rates = first.angular_velocity, then.angular_velocity
    return replace(
        first,
        time=np.concatenate([first.time[:n], then.time[m:]]),
        specific_force=np.concatenate([first.specific_force[:n], then.specific_force[m:]]),
        angular_velocity=None
        if rates[0] is None or rates[1] is None
        else np.concatenate([rates[0][:n], rates[1][m:]]),
    )


def _held(su: SuStream, begin: int, end: int) -> SuStream:
    """The stream with the samples from ``begin`` to ``end`` like the one before."""
    force = np.array(su.specific_force)
    force[begin:end] = force[begin - 1]
    return replace(su, specific_force=force)


def _only(su: SuStream, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> SuStream:
    return su.at(kept)


def _with(sound: Sound, su: SuStream, kind: str, words: str) -> Faulty:
    """The recording with one SU's stream replaced."""
    sus = tuple(su if old.name == su.name else old for old in sound.recording.sus)
    return Faulty((replace(sound.recording, sus=sus),), kind, (su.name,), words)


def _slip(distance: float, angle: float, rng: np.random.Generator) -> F64:
    """(4, 4) transform by a distance [m] and an angle [rad] in random directions."""
    import pinocchio as pin

    along, about = rng.standard_normal((2, 3))
    T = np.eye(4)
    T[:3, :3] = pin.exp3(angle * about / np.linalg.norm(about))
    T[:3, 3] = distance * along / np.linalg.norm(along)
    return T


def recorded_after(sound: Sound, name: str, slip: F64) -> SuStream:
    """What an SU would have recorded, had it slipped before; its stamps and noise are the same.

    Args:
        sound: the recording.
        name: the SU.
        slip: (4, 4) its frame after the slip, seen in the one before.
    """
    truth, settings, moved = sound.simulation.truth, sound.settings, sound.simulation.moved
    sus = tuple(
        replace(su, T_joint_su=su.T_joint_su @ slip, T_link_su=su.T_link_su @ slip)
        if su.name == name
        else su
        for su in moved.sus
    )
    sensors = [
        Sensor(settings.sensor_grade, matrix, bias)
        for matrix, bias in zip(truth.sensor_matrix, truth.bias, strict=True)
    ]
    streams = record_sus(
        moved.mechanism,
        moved.motion,
        sus,
        sensors,
        truth.lag,
        settings,
        Draw(settings.seed),
        truth.gyros,
    )
    (stream,) = shift_clock([s for s in streams if s.name == name], -truth.start)
    return stream
