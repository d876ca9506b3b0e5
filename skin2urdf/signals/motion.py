"""The robot's motion on the common grid: positions, derivatives, resolution of the encoders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import comb

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record, frozen
from skin2urdf.errors import InsufficientDataError
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.signals.filters import Grid, filtered, first_derivative, low_pass, sample
from skin2urdf.signals.filters import second_derivative as second
from skin2urdf.signals.turns import unwrapped

GRID_RATE = 125.0
"""Rate of the common grid [Hz]; patterns are a few Hz."""
SMOOTH = GRID_RATE / 5
"""Cutoff of the low-pass that positions go through before they are differentiated [Hz]."""
_FEWEST = 8
"""Samples that a curve goes through, at least."""
_SLOWEST = 2.0
"""Time between two positions beyond which they tell of no move in between [s]: hours of such a
stream would be a grid of millions of samples. A move takes a second or two."""
STILL = 1e-3
"""Travel [rad or m] that is none: it turns gravity by less than 0.01 m/s^2."""
_CREEP = 6.0
"""Travel in steps of the encoder that is none: held joints creep by up to 4 steps and round to the
next on either side (an iCub's leg)."""
_ORDERS = (3, 6, 12, 24)
"""Differences by which noise is told from motion: with the third alone a pattern of 4 Hz in a
stream of 25 Hz is taken for twenty times the noise, with the twelfth for none."""


@dataclass(frozen=True, eq=False)
class Motion(Record):
    """Joint motion of one log on a uniform grid of N samples.

    Attributes:
        grid: the times.
        dof_names: D joint names.
        q: (N, D) positions [rad or m].
        qd: (N, D) velocities.
        qdd: (N, D) accelerations.
        valid: (N,) False where a joint stream has a gap.
        resolution: (D,) smallest step an encoder makes [rad or m]; 0 where it has none.
        noise: (D,) standard deviation of one raw position sample [rad or m].
        raw_rate: (D,) samples per second of the raw streams [Hz].
        stamp_noise: (D,) scatter of the stamps that their times were made from [s].
        named: (D,) False for joints that the log lacks; their ``q`` is 0.
        wraps: (D,) True where the log wraps the position into one turn; ``q`` does not.
        publisher: (D,) number of the publisher whose messages hold the joint: joints with one
            number have the same stamps; -1 for joints that the log lacks.
        effort: (N, D) measured torques [N m or N], NaN for joints of which the log does not hold
            them all along; (0, 0) where it holds none.
    """

    grid: Grid
    dof_names: tuple[str, ...]
    q: F64
    qd: F64
    qdd: F64
    valid: Bool
    resolution: F64
    noise: F64
    raw_rate: F64
    stamp_noise: F64
    named: Bool
    wraps: Bool
    publisher: Int = field(default_factory=lambda: np.zeros((), dtype=np.int64))
    effort: F64 = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        super().__post_init__()
        publisher = np.broadcast_to(self.publisher, (len(self.dof_names),))
        object.__setattr__(self, "publisher", frozen(publisher, np.int64))

    @property
    def moved(self) -> Bool:
        """(D,) False for joints that kept still: all they did is what encoders do at rest."""
        return np.asarray(travel(self) > self.creep)

    @property
    def noise_density(self) -> F64:
        """(D,) one-sided spectral density of the positions' noise [rad^2/Hz or m^2/Hz].

        That of white samples, up to half the rate of the raw streams.
        """
        return np.asarray(2 * self.noise**2 / self.raw_rate)

    @property
    def creep(self) -> F64:
        """(D,) how far the position of a joint at rest may seem to go [rad or m]."""
        encoder = np.maximum(_CREEP * self.resolution, 2 * _CREEP * self.noise)
        return np.asarray(np.maximum(STILL, encoder))


def travel(motion: Motion) -> F64:
    """(D,) how far each joint goes in all, where the log is whole [rad or m]."""
    q = motion.q[motion.valid]
    return np.ptp(q, axis=0) if len(q) else np.zeros(q.shape[1])


def _tells_of_moves(joint: JointStream) -> bool:
    """Whether positions are many, and follow each other closely enough to show moves."""
    time = joint.time
    return time.size >= _FEWEST and bool(np.median(np.diff(time)) <= _SLOWEST)


def joint_motion(recording: Recording, dof_names: Sequence[str] | None = None) -> Motion:
    """Sample all joint streams of a recording on one grid and differentiate them.

    Args:
        recording: the log.
        dof_names: which joints, in which order; all of the log by default. A joint the log lacks
            rests somewhere; its position is set to 0.

    Raises:
        InsufficientDataError: no joint stream has enough samples, or they do not overlap.
    """
    names = tuple(dof_names) if dof_names is not None else tuple(j.name for j in recording.joints)
    found = {j.name: unwrapped(j) for j in recording.joints if _tells_of_moves(j)}
    streams = {name: stream for name, (stream, _) in found.items()}
    if not streams:
        raise InsufficientDataError(
            f"{recording.source}: no joint has more than a few position samples, or one in "
            f"{_SLOWEST:g} s",
            "record the joint states at 50 Hz or more while the robot moves",
            lacks="samples",
        )
    start = max(j.time[0] for j in streams.values())
    end = min(j.time[-1] for j in streams.values())
    if end - start < 2.0:
        raise InsufficientDataError(
            f"{recording.source}: the joint streams overlap for {max(0.0, end - start):.1f} s only",
            "record all joints over the whole experiment",
            lacks="overlap",
        )
    grid = Grid(float(start), GRID_RATE, int((end - start) * GRID_RATE) + 1)
    q = np.zeros((grid.size, len(names)))
    valid = np.ones(grid.size, dtype=bool)
    resolution, noise, stamps = (np.zeros(len(names)) for _ in range(3))
    rate, publisher = np.ones(len(names)), np.full(len(names), -1)
    together: dict[tuple[int, float, float], list[int]] = {}
    for d, name in enumerate(names):
        if name in streams:
            t = streams[name].time
            key = (t.size, float(t[0]), float(t[-1]))
            if key in together and not np.array_equal(t, streams[names[together[key][0]]].time):
                key = (-d, 0.0, 0.0)
            together.setdefault(key, []).append(d)
    heads: list[F64] = []
    for members in sorted(together.values(), key=lambda m: -streams[names[m[0]]].time.size):
        publisher[members] = _publisher(heads, streams[names[members[0]]].time)
        same = [streams[names[d]] for d in members]
        values, ok = sample(same[0].time, np.stack([j.position for j in same], axis=1), grid)
        q[:, members] = _bridged(values, ok)
        valid &= ok
        for d, stream in zip(members, same, strict=True):
            resolution[d], noise[d] = encoder_noise(stream)
            stamps[d] = stream.stamp_noise
            rate[d] = 1 / float(np.median(np.diff(stream.time)))
    smooth = filtered(q, low_pass(SMOOTH, GRID_RATE))
    named = np.array([name in found for name in names])
    wraps = np.array([name in found and found[name][1] for name in names])
    return Motion(
        grid, names, q, first_derivative(smooth, GRID_RATE), second(smooth, GRID_RATE),
        valid, resolution, noise, rate, stamps, named, wraps, publisher,
        _efforts(streams, names, grid, valid),
    )  # fmt: skip


def _efforts(
    streams: Mapping[str, JointStream], names: Sequence[str], grid: Grid, valid: Bool
) -> F64:
    """(N, D) efforts on the grid, NaN for joints that lack any where positions are whole.

    Args:
        streams: joints by name.
        names: D names.
        grid: the times.
        valid: (N,) where the positions of all joints are whole.
    """
    effort = np.full((grid.size, len(names)), np.nan)
    for d, name in enumerate(names):
        stream = streams.get(name)
        if stream is None or stream.effort is None:
            continue
        there = np.isfinite(stream.effort)
        if there.sum() < _FEWEST:
            continue
        values, ok = sample(stream.time[there], stream.effort[there, None], grid)
        if not (valid & ~ok).any():
            effort[:, [d]] = _bridged(values, ok)
    return effort if np.isfinite(effort).any() else np.zeros((0, 0))


def publishers_beyond_first(publisher: Int, moves: Bool) -> list[Int]:
    """Joints of each publisher but the one that most moving joints have, by number.

    Joints that keep still show no clock.

    Args:
        publisher: (D,) number of each joint's publisher, -1 for none.
        moves: (D,) joints that move.
    """
    numbers, counts = np.unique(publisher[moves & (publisher >= 0)], return_counts=True)
    if len(numbers) < 2:
        return []
    first = numbers[counts.argmax()]
    return [np.flatnonzero(publisher == number) for number in numbers if number != first]


def _publisher(heads: list[F64], time: F64) -> int:
    """Number of the publisher that stamps as some earlier one did; of a new one where none did.

    A joint may lack values in messages that hold those of others.
    """
    for number, other in enumerate(heads):
        if np.isin(time, other).all():
            return number
    heads.append(time)
    return len(heads) - 1


def _bridged(values: F64, ok: Bool) -> F64:
    """Positions (N, C) with straight lines across gaps, which stay between what was measured."""
    there = np.flatnonzero(ok)
    missing = np.flatnonzero(~ok)
    inside = missing[(missing > there[0]) & (missing < there[-1])] if there.size else missing[:0]
    if inside.size:
        values = values.copy()
        for column in values.T:
            column[inside] = np.interp(inside, there, column[there])
    return values


def encoder_noise(stream: JointStream) -> tuple[float, float]:
    """Smallest step of an encoder and the standard deviation of its error.

    The error is that of rounding to the step, or the scatter about what is smooth where that is
    larger (an analogue sensor). Differences of every order show the same white noise once they are
    divided by the root of the sum of their squared weights; what they hold of the motion beside it
    is less the higher the order, so that the least is nearest.
    """
    x = stream.position
    changes = np.abs(np.diff(x))
    moves = changes[changes > 0]
    if not moves.size:
        return 0.0, 0.0
    step = float(np.quantile(moves, 0.02))
    multiples = moves / step
    regular = np.median(np.abs(multiples - np.round(multiples))) < 0.02
    rounding = step / np.sqrt(12) if regular else 0.0
    scatter = min(
        float(np.median(np.abs(np.diff(x, order)))) / 0.6745 / np.sqrt(comb(2 * order, order))
        for order in _ORDERS
        if order < len(x)
    )
    return (step if regular else 0.0), max(rounding, scatter)
