"""Motion of the base, made of what SUs on it feel.

All that an SU on the base feels beside gravity, ``s`` in the base's frame, is felt by every SU,
whether the base is pushed or tilted. What turns is felt to accelerate besides, the more the further
away from the SU on the base, at ``r``. A base that tilts about a point h below the SU is felt to
tilt and to be pushed at once, ``s = g e + h w^2 e`` at the angular frequency w, so that it turns by
``e = s / (g + h w^2)``; one that is pushed alone does not turn at all. So a base turns by shares of
what few such points would have it turn by, one for each axis of both, and of what the loads of a
robot to which its base yields would, where any are known. Where it turns, gravity's ``f`` turns in
it, and its frame moves so that the SU feels what it feels:

    d'' = s + cross(e, f) - cross(e'', r).

What of `s` is motion and not noise is told by its power, and by the loads of a robot to which its
base yields, where any are known: these go with the motion of its links, of which nothing is noise.
What hides in the noise of a turn that goes with the links would be taken for their lengths.

Few numbers make its motion: these shares, the place r, how much later the SU was read than the
others, and what its sensor makes of ``s``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.coarser import on_grid
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, shift, turn
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.filters import first_derivative, noise_bandwidth
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

UNIT = 1e-2
"""Standard deviation of each number before the readings are asked: that of what is wanted to be
known of, in :func:`~skin2urdf.estimation.trajectory.slack.lacking`."""
_LEAST = 0.05
"""Gain of the low-pass below which it is not undone."""
_HEARD = 0.5
"""Gain of the low-pass from which a frequency tells how much of what is felt is noise."""
_BAND = 0.4
"""Width of the bands that are compared for that [Hz]: of a log of a minute it holds some fifty
independent values, so that their mean is right to a seventh."""
_LATE = 0.05
"""Standard deviation of the time by which an SU on the base is read later than others [s]."""
_DEPTHS = (0.0, 0.3, 1.5)
"""How far below may be what a base tilts about [m]: of any point between, mixtures of the turns
about these are right to a few hundredths."""
_ROCKS = 0.2
"""Frequency above which a base turns as it is shifted, about a point far away [Hz]: what turns more
slowly is felt by how gravity turns, as the acceleration by a lever of 1 m is a sixth of that."""
_PER_SHIFT = 2.0
"""Standard deviation of such turns by shifts [rad/m]: those of a base that rocks on feet, or on
wheels, half a metre away."""
_LEVER = 0.5
"""Standard deviation of the place of an SU on the base, along each axis [m]."""
_LEAST_ERROR = 1e-3
"""Error of a sensor at least, as a part of what it feels, where it is said to have none."""
_PER_CUTOFF = 7.0
"""Samples per second over the cutoff that motions are worked out at, as those of what bends are."""


N_TURNS = len(_DEPTHS) + 2
"""K, kinds of turns: about points below, about one far away, and by loads."""


@dataclass(frozen=True, eq=False)
class Felt(Record):
    """What is felt on the base along one log, beside gravity.

    Attributes:
        s: (M, 3) in the base's frame, low-passed once [m/s^2].
        likeliest: (M, 3) what of it is motion and not noise, as far as loads and power tell
            [m/s^2].
        by_loads: (M, 3) turns that loads make [rad]; zero where none are known.
        rate: samples per second [Hz].
        step: grid samples of the log from one to the next.
        size: grid samples of the log.
        f: (3,) what is felt of gravity [m/s^2].
    """

    s: F64
    likeliest: F64
    by_loads: F64
    rate: float
    step: int
    size: int
    f: F64

    @property
    def shifted(self) -> F64:
        """(M, 3) what it shifts by."""
        return integral(self.s, self.rate, 2)

    @property
    def more(self) -> F64:
        """(M, 3) what it shifts by if the sensor has errors."""
        return integral(self.likeliest, self.rate, 2)

    @property
    def later(self) -> tuple[F64, F64]:
        """Twice (M, 3): what it shifts by if it was felt later, and ever later along the log."""
        s, rate = self.likeliest, self.rate
        since = np.linspace(-1.0, 1.0, len(s))[:, None]
        return integral(s, rate, 1), integral(since * first_derivative(s, rate), rate, 2)

    @property
    def turns(self) -> F64:
        """(M, 3 K) what it may turn by, kind by kind."""
        gravity = float(np.linalg.norm(self.f))
        return np.hstack([*_turns(self.likeliest, self.rate, gravity), self.by_loads])

    @property
    def later_turns(self) -> tuple[F64, F64]:
        """Twice (M, 3 K): what it may turn by if it was felt later, and ever later in the log.

        Loads are not felt, and so no later.
        """
        later = first_derivative(self.turns, self.rate)
        later[:, -3:] = 0.0
        return later, np.linspace(-1.0, 1.0, len(later))[:, None] * later

    def turns_read(self, late: F64) -> F64:
        """(M, 3 K) what it may turn by if it was felt later by such times, as in `Numbers` [s]."""
        once, ever = self.later_turns
        return np.asarray(self.turns + late[0] * once + late[1] * ever)


def felt_on_the_base(
    logs: Sequence[Trajectory],
    places: State,
    gravity: float,
    asked: Int,
    by_loads: Sequence[tuple[F64, F64]] | None = None,
) -> list[Felt]:
    """What SUs on the base feel, log by log, in the mean of them.

    Args:
        logs: trajectories.
        places: how they are turned.
        gravity: its magnitude [m/s^2].
        asked: (B,) which SUs.
        by_loads: per log (N, 3) what would be felt of a base that yields to the robot's loads
            alone, and (N, 3) what it turns by, as :func:`felt_as_it_yields` has them; None where
            that is not known.
    """
    matrix = np.linalg.inv(places.sensor_matrix()[asked])
    into_base = places.T_joint_su[asked, :3, :3] @ matrix
    out = []
    for g, log in enumerate(logs):
        step = max(1, int(log.rate / (_PER_CUTOFF * noise_bandwidth(log.taps, log.rate))))
        s = np.mean([x @ R.T for x, R in zip(_changes(log, asked), into_base, strict=True)], axis=0)
        f = places.up[g] * gravity
        made = turned = np.zeros_like(s)
        if by_loads is not None:
            made, turned = by_loads[g]
            made = _as_far_as_felt(made, s, log.rate)
        likeliest = made + _without_noise(s - made, log)
        s, likeliest, turned = s[::step], likeliest[::step], turned[::step]
        out.append(Felt(s, likeliest, turned, log.rate / step, step, len(log.q), f))
    return out


def felt_as_it_yields(
    unseen: Unseen, logs: Sequence[Trajectory], state: MotionState, asked: Int
) -> list[tuple[F64, F64]]:
    """What is felt of a known motion of the base, and what it turns by.

    Args:
        unseen: which makes it.
        logs: trajectories.
        state: numbers that make it, and where SUs are.
        asked: (B,) SUs on the base, in the middle of which it is felt.

    Returns:
        Per log (N, 3) specific force beside gravity [m/s^2], and (N, 3) turns [rad], both in the
        base's frame and beside their means.
    """
    out = []
    place = state.placements.T_joint_su[asked, :3, 3].mean(axis=0)
    for g, log in enumerate(logs):
        D = log.q.shape[1]
        moved = unseen.moved(log, g, state.unseen)
        turned, accelerates = moved.q[:, D + 3 :], moved.qdd[:, D:]
        f = state.placements.up[g] * state.gravity
        s = accelerates[:, :3] + np.cross(accelerates[:, 3:], place) - np.cross(turned, f)
        out.append((s - s.mean(axis=0), turned - turned.mean(axis=0)))
    return out


def free_motion(
    tree: KinematicTree, logs: Sequence[Trajectory], gravity: float, asked: Int
) -> Unseen:
    """Motions of the base by what SUs on it feel, of which nothing else is known.

    Args:
        tree: D joints.
        logs: trajectories.
        gravity: its magnitude [m/s^2].
        asked: (B,) SUs on the base.

    Returns:
        Shifts as they feel them, turns as gravity turns, and turns as it is shifted; and the same
        later, which a shake of a few hertz tells from at once by a tenth of what there is.
    """
    columns = []
    for log in logs:
        s = np.hstack(_changes(log, asked))
        shifts = integral(s, log.rate, 2), _LATE * integral(s, log.rate, 1)
        tilts, *_, far = _turns(s, log.rate, gravity)
        later = [_LATE * first_derivative(each, log.rate) for each in (tilts, far)]
        columns.append(np.hstack([*shifts, tilts, far, *later]))
    B = 3 * len(asked)
    kinds = [shift, shift, turn, turn, turn, turn]
    moved = [np.repeat([of(tree, axis) for axis in range(3)], B) for of in kinds]
    column = np.concatenate([np.tile(kind * B + np.arange(B), 3) for kind in range(len(kinds))])
    return Unseen(
        np.concatenate(moved), tuple(columns), column=column, unit=np.full(len(column), 1 / UNIT)
    )


@dataclass(frozen=True, eq=False)
class Numbers(Record):
    """What makes a base's motion of what is felt on it, over what is known of it before.

    Attributes:
        x: (S,) errors of the sensor (9,), two of its clock, shares of turns (9 K,), place (3,).
        spread: (S,) their standard deviations.
    """

    x: F64
    spread: F64

    @staticmethod
    def none(sensors: Priors) -> Numbers:
        """None of a base that is as it feels; spreads by what sensors are known to be."""
        tilt = float(np.hypot(sensors.cross, sensors.bias / sensors.gravity))
        errors = np.full((3, 3), max(tilt, _LEAST_ERROR))
        np.fill_diagonal(errors, max(sensors.scale, _LEAST_ERROR))
        spread = np.concatenate(
            [
                errors.ravel(),
                np.full(2, _LATE),
                np.ones(9 * len(_DEPTHS)),
                np.full(9, _PER_SHIFT),
                np.ones(9),
                np.full(3, _LEVER),
            ]
        )
        return Numbers(np.zeros(len(spread)), spread)

    def at(self, unseen: F64) -> Numbers:
        """Those of which a fit has (S,), each in units of ``UNIT``."""
        return Numbers(self.spread * unseen / UNIT, self.spread)

    @property
    def n_numbers(self) -> int:
        """S."""
        return len(self.x)

    @property
    def sensor(self) -> F64:
        """(3, 3) by how much more it reads along each axis, per unit along another."""
        return self.x[:9].reshape(3, 3)

    @property
    def late(self) -> F64:
        """(2,) by how much later it is read in the middle of a log, and more at its end [s]."""
        return self.x[9:11]

    @property
    def turns(self) -> F64:
        """(3, 3 K) shares of turns about each axis, kind by kind; of those far away [rad/m]."""
        return np.hstack(list(self.x[11:-3].reshape(-1, 3, 3)))

    @property
    def place(self) -> F64:
        """(3,) r [m]."""
        return self.x[-3:]


def motion_of(felt: Felt, numbers: Numbers) -> F64:
    """(M, 6) shifts and turns of the base [m, rad]."""
    late, ever_later = felt.later
    e = felt.turns_read(numbers.late) @ numbers.turns.T
    d = felt.shifted + felt.more @ numbers.sensor.T
    d += numbers.late[0] * late + numbers.late[1] * ever_later
    d += integral(np.cross(e, felt.f), felt.rate, 2) - np.cross(e, numbers.place)
    return np.hstack([d, e])


def about(tree: KinematicTree, felt: Sequence[Felt], numbers: Numbers) -> Unseen:
    """Motions of the base about some numbers, in units that make all as large as ``UNIT``.

    Args:
        tree: D joints.
        felt: log by log.
        numbers: about which.
    """
    by_number = [_slopes(each, numbers) for each in felt]
    moves = np.any([np.abs(each).max(axis=0) > 0 for each in by_number], axis=0)
    # The place of an SU on a base that does not turn yet moves nothing, and has its numbers.
    moves[:3, -3:] = True
    hinge, number = np.nonzero(moves)
    D = tree.n_joints
    moved = [on_grid(motion_of(each, numbers), each.step, each.size) for each in felt]
    return Unseen(
        D + hinge,
        tuple(each[:, hinge, number] / UNIT for each in by_number),
        number=number,
        origin=numbers.x / numbers.spread * UNIT,
        every=tuple(each.step for each in felt),
        settled=tuple(np.hstack([np.zeros((len(each), D)), each]) for each in moved),
    )


def _slopes(felt: Felt, numbers: Numbers) -> F64:
    """(M, 6, S) what the base does by a standard deviation of each number."""
    out = np.zeros((len(felt.s), N_HINGES, len(numbers.x)))
    more, turns = felt.more, felt.turns_read(numbers.late)
    for axis in range(3):
        out[:, axis, 3 * axis : 3 * axis + 3] = more

    def frame(e: F64) -> F64:
        """(M, 3) how the frame moves that turns by e (M, 3)."""
        return integral(np.cross(e, felt.f), felt.rate, 2) - np.cross(e, numbers.place)

    for n, (shifted, turned) in enumerate(zip(felt.later, felt.later_turns, strict=True)):
        e = turned @ numbers.turns.T
        out[:, :3, 9 + n], out[:, 3:, 9 + n] = shifted + frame(e), e
    for kind in range(N_TURNS):
        by = turns[:, 3 * kind : 3 * kind + 3]
        pushed = integral(by, felt.rate, 2)
        for axis, unit in enumerate(np.eye(3)):
            first = 11 + 9 * kind + 3 * axis
            at = slice(first, first + 3)
            out[:, 3 + axis, at] = by
            out[:, :3, at] = (
                np.cross(unit, felt.f)[:, None] * pushed[:, None]
                - np.cross(unit, numbers.place)[:, None] * by[:, None]
            )
    e = turns @ numbers.turns.T
    out[:, :3, -3:] = -np.cross(e[:, None], np.eye(3)).swapaxes(1, 2)
    return np.asarray(out * numbers.spread)


def _changes(log: Trajectory, asked: Int) -> list[F64]:
    """(B, N, 3) what SUs read beside what they do in the mean, low-passed once as motions are."""
    x = log.readings[:, asked].reshape(len(log.readings), -1)
    x = np.where(np.isfinite(x), x, np.nanmean(x, axis=0))
    x = _low_passed_once(x - x.mean(axis=0), log.taps)
    return [x[:, 3 * b : 3 * b + 3] for b in range(len(asked))]


def _low_passed_once(x: F64, taps: F64) -> F64:
    """(N, C) what low-passed twice is x (N, C): readings are, motions are not."""
    gain = _gain(taps, 2 * len(x))
    return _passed(x, gain / (gain**2 + _LEAST**2))


def _as_far_as_felt(made: F64, s: F64, rate: float) -> F64:
    """(N, C) what loads make of a base's motion, as far as what is felt (N, C) goes with it.

    Of what is felt the part that goes with it is told without noise, band by band: none is where a
    base is moved by something else, and loads stand for that at other frequencies.
    """
    of_loads, of_felt = (np.fft.rfft(np.concatenate([x, x[::-1]]), axis=0) for x in (made, s))
    wide = max(1, int(_BAND * 2 * len(s) / rate))
    together, alone = (
        uniform_filter1d((of_loads.conj() * x).real, wide, axis=0, mode="reflect")
        for x in (of_felt, of_loads)
    )
    return _passed(made, (together / np.maximum(alone, 1e-300)).clip(0.0, 1.0))


def _without_noise(s: F64, log: Trajectory) -> F64:
    """(N, C) the likeliest motion of what is felt (N, C), low-passed once, with a sensor's noise.

    Each frequency keeps as much of it as is not noise (Wiener 1949), which is the same at all of
    them: as much as there is where there is least.
    """
    n = 2 * len(s)
    f, gain = np.fft.rfftfreq(n, 1 / log.rate), _gain(log.taps, n)
    power = np.abs(np.fft.rfft(np.concatenate([s, s[::-1]]), axis=0)) ** 2
    band = np.flatnonzero(gain > _HEARD)
    wide = max(1, int(_BAND / f[1]))
    power = uniform_filter1d(power, wide, axis=0, mode="reflect")
    density = power[band] / gain[band, None] ** 2
    noise = density[wide // 2 :: wide].min(axis=0) * gain[:, None] ** 2
    return _passed(s, np.maximum(1 - noise / np.maximum(power, 1e-300), 0.0))


def _gain(taps: F64, n: int) -> F64:
    """(n / 2 + 1,) gain of a low-pass without lag at the frequencies of n samples."""
    padded = np.pad(taps, (0, max(0, n - len(taps))))[:n]
    return np.asarray(np.fft.rfft(np.roll(padded, -(len(taps) // 2))).real)


def _passed(x: F64, gain: F64) -> F64:
    """(N, C) samples through a filter of gains (N + 1,) or (N + 1, C), mirrored at the end."""
    gain = gain if gain.ndim > 1 else gain[:, None]
    spectrum = np.fft.rfft(np.concatenate([x, x[::-1]]), axis=0) * gain
    return np.asarray(np.fft.irfft(spectrum, 2 * len(x), axis=0)[: len(x)])


def integral(s: F64, rate: float, times: int) -> F64:
    """(N, C) integral of samples (N, C), whose derivative of that order they are.

    Where it begins and how fast is nobody's to say, and is not felt.
    """
    from scipy.interpolate import CubicSpline  # only here: it takes 0.1 s to load

    t = np.arange(len(s)) / rate
    x = CubicSpline(t, s).antiderivative(times)(t)
    trend = np.stack([np.ones_like(t), t - t.mean()], axis=1)
    return np.asarray(x - trend @ np.linalg.lstsq(trend, x, rcond=None)[0])


def _turns(s: F64, rate: float, gravity: float) -> list[F64]:
    """K times (N, C): turns of a base that feels s (N, C), about points below, and far away."""
    w2 = (2 * np.pi * np.fft.rfftfreq(2 * len(s), 1 / rate)) ** 2
    # Twice of second order, so that nothing of what is slow is left after two integrations.
    far = -w2 / (w2 + (2 * np.pi * _ROCKS) ** 2) ** 2
    return [_passed(s, gain) for gain in (*(1 / (gravity + h * w2) for h in _DEPTHS), far)]
