"""What the noise of encoders makes of predictions, which front ends must not be paid to cut off.

Positions are differentiated twice, so a prediction shakes by what noise makes of accelerations, the
more the higher the frequency. Least squares then asks for a sensor with a low-pass: readings have
nothing of that noise, and a front end that cuts it off leaves less of it. So of the noise alone a
sensor would seem slow, by as much as the patterns allow, and late by what such a low-pass does to
their phase. With encoders of 12 bits that is 5 Hz and 2 ms.

Predictions with noise ``n`` of variance S behind a front end F leave ``|F|^2 S`` of it, summed over
frequencies. This part of chi-squared is known for every F, and is taken off, so that what is
minimised is what the front end makes of the motion (corrected scores: Stefanski 1985; Nakamura
1990). What noise does to lengths is taken off in the end, see :mod:`encoder_noise`.

Joints that a driver smooths are further by so much of their derivatives, in which the same noise
is: of joint j its numbers leave ``|F G_j|^2 S_j``. Were the front end's share alone taken off, it
would pay to let sensors rise and joints fall. What springs make of it under loads nobody knows is
in :mod:`shaken_springs`: it is paid for neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Complex, Int, Record
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.bending import Bending, bends_among
from skin2urdf.estimation.trajectory.front_end import transfer
from skin2urdf.estimation.trajectory.kinematics import felt_of_joints
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Equations
from skin2urdf.estimation.trajectory.shaken_springs import FREQUENCIES, ShakenSprings
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

EVERY = 10
"""Kept samples of which one stands for all: some three a second, in which a robot hardly turns."""


@dataclass(frozen=True, eq=False)
class Shaken:
    """What encoders' noise makes of the predicted readings of U SUs, before their front ends.

    Attributes:
        of_logs: log by log, where positions are not exact.
    """

    of_logs: tuple[ShakenLog, ...]

    @staticmethod
    def of(
        tree: KinematicTree,
        logs: Sequence[Trajectory],
        state: MotionState,
        weights: Sequence[F64],
        unseen: Unseen | None = None,
    ) -> Shaken:
        """Of logs at a state.

        Args:
            tree: the structure.
            logs: the trajectories.
            state: where.
            weights: per log (K, U, 3) information of each sample [s^4/m^2]; gyroscopes' behind it.
            unseen: motion among which there may be springs.
        """
        return Shaken(
            tuple(
                ShakenLog.of(tree, log, state, w, unseen)
                for log, w in zip(logs, weights, strict=True)
                if log.noise is not None
            )
        )

    def cut_off(self, state: MotionState, unseen: Unseen | None = None) -> float:
        """What is taken of chi-squared by cutting noise off.

        Args:
            state: front ends, and numbers of unseen motion.
            unseen: what these stand for; None where they cut nothing off, or shall not count.
        """
        return sum(each.cut_off(state, unseen) for each in self.of_logs)

    def taken_off(
        self, equations: Equations, problem: MotionProblem, state: MotionState
    ) -> Equations:
        """Normal equations without what is gained by cutting noise off.

        Args:
            equations: of the samples.
            problem: whose coordinates they are in.
            state: where.
        """
        joint, su = self.pull(problem, state)
        return replace(
            equations,
            joint_gradient=equations.joint_gradient + joint,
            su_gradient=equations.su_gradient + su,
        )

    def pull(self, problem: MotionProblem, state: MotionState) -> tuple[F64, F64]:
        """(J,) and (U, n) that part of the gradient, at a state of a problem."""
        layout = problem.layout
        joint, su = np.zeros(layout.n_joint), np.zeros((len(state.front), layout.n_su))
        for each in self.of_logs:
            to_numbers, to_fronts = each.pull(state, problem.unseen)
            joint[layout.unseen] += to_numbers
            su[:, layout.front] += to_fronts
        return joint, su


@dataclass(frozen=True, eq=False)
class ShakenLog(Record):
    """The same of one log, frequency by frequency.

    Attributes:
        w: (F,) angular frequencies [rad/s].
        power: (F, D) mean squares of what noise of each encoder makes of accelerations there.
        times: (F, D) what positions are times, by what was added of their derivatives.
        counts: (U, D) by how much chi-squared grows with such a square.
        chi2: (F, U) by how much chi-squared is larger for the noise.
        springs: what springs make of it; None where there are none.
    """

    w: F64
    power: F64
    times: Complex
    counts: F64
    chi2: F64
    springs: ShakenSprings | None = None

    @staticmethod
    def of(
        tree: KinematicTree,
        log: Trajectory,
        state: MotionState,
        weights: F64,
        unseen: Unseen | None = None,
    ) -> ShakenLog:
        """Of a log at a state, with weights (K, U, 3) of its samples."""
        w, power = log.noise_spectrum()
        bends = [each for each, _ in bends_among(unseen)]
        if bends:
            w, power = _in_bands(w, power, FREQUENCIES)
        felt, shaken = _felt_of_some(tree, log, state.placements), log.shaken[::EVERY]
        counts = EVERY * np.einsum(
            "ku,kd,udk->ud", weights[::EVERY, :, 0], shaken, felt, optimize=True
        )
        springs = None
        if bends:
            springs = ShakenSprings.of(bends, tree, log, state.placements, weights[..., 0], w)
        return ShakenLog(w, power, log.times(w), counts, power @ counts.T, springs)

    def cut_off(self, state: MotionState, unseen: Unseen | None) -> float:
        """What is taken of chi-squared, as above."""
        H, _ = transfer(self.w, state.front)
        left = self._left(unseen, state.unseen)
        kept = np.abs(H) ** 2 * (1.0 if left is None else left.share)
        return float((_kept_less(kept)[0] * self.chi2).sum())

    def pull(self, state: MotionState, unseen: Unseen | None) -> tuple[F64, F64]:
        """(S,) and (U, 2) parts of the gradient in numbers and front ends."""
        H, slopes = transfer(self.w, state.front)
        of_front, by_front = np.abs(H) ** 2, (H.conj() * slopes).real
        left = self._left(unseen, state.unseen)
        if left is None:
            less = _kept_less(of_front)[1] * self.chi2
            return np.zeros(len(state.unseen)), np.einsum("fu,nfu->un", less, by_front)
        _, less = _kept_less(of_front * left.share)
        to_fronts = np.einsum("fu,nfu->un", less * left.share * self.chi2, by_front)
        return left.pull(less * of_front), to_fronts

    def _left(self, unseen: Unseen | None, x: F64) -> _Left | None:
        """What numbers x (S,) leave of the noise; None where none of them does anything to it."""
        filters = _Filters.of(unseen, self, x)
        bends = bends_among(unseen)
        if self.springs is None or not bends:
            return None if filters is None else _Left(self, filters, self.counts[None], len(x))
        kinds, at = zip(*bends, strict=True)
        numbers = tuple(x[each] for each in at)
        # Some samples stand for all.
        of_rigid = self.springs.of_rigid
        more = self.chi2 / np.maximum(self.power @ of_rigid.T, 1e-300)
        counts = more[..., None] * self.springs.counts(kinds, numbers)
        return _Left(self, filters, counts, len(x), _Bent(self.springs, kinds, numbers, at, more))


@dataclass(frozen=True, eq=False)
class _Bent:
    """Springs that swing along.

    Attributes:
        springs: what they make of noise.
        kinds: the springs, by kind.
        numbers: (S,) the numbers of each, and
        at: which of all numbers these are.
        more: (F, U) by how much all samples count more than those at which springs are asked.
    """

    springs: ShakenSprings
    kinds: tuple[Bending, ...]
    numbers: tuple[F64, ...]
    at: tuple[slice, ...]
    more: F64


@dataclass(frozen=True, eq=False)
class _Left:
    """What numbers of unseen motion leave of encoders' noise.

    Attributes:
        of: the noise.
        filters: what they make of that of each joint; None where nothing.
        counts: (F or 1, U, D) by how much chi-squared grows with a mean square of that.
        n_numbers: S.
        bent: springs that swing along; None where there are none.
    """

    of: ShakenLog
    filters: _Filters | None
    counts: F64
    n_numbers: int
    bent: _Bent | None = None

    @cached_property
    def share(self) -> F64:
        """(F, U) of the noise."""
        left = np.einsum("fd,fud->fu", self._power, np.broadcast_to(self.counts, self._shape))
        return np.asarray(left / np.where(self.of.chi2 > 0, self.of.chi2, 1.0))

    def pull(self, share: F64) -> F64:
        """(S,) half of by how much what is left grows with each number, where (F, U) counts."""
        out = np.zeros(self.n_numbers)
        if self.filters is not None:
            counts = np.broadcast_to(self.counts, self._shape)
            out += self.filters.pull(self.of.power * np.einsum("fu,fud->fd", share, counts))
        if (bent := self.bent) is not None:
            pulls = bent.springs.pull(bent.kinds, bent.numbers, self._power, share * bent.more)
            for at, pull in zip(bent.at, pulls, strict=True):
                out[at] += pull
        return out

    @property
    def _power(self) -> F64:
        """(F, D) of the noise, behind filters."""
        gain = 1.0 if self.filters is None else np.abs(self.filters.gain) ** 2
        return np.asarray(self.of.power * gain)

    @property
    def _shape(self) -> tuple[int, int, int]:
        return (len(self.of.w), *self.of.counts.shape)


@dataclass(frozen=True, eq=False)
class _Filters:
    """What numbers of unseen motion make of encoders' noise that is in it.

    Attributes:
        gain: (F, D) what is left of each joint's noise.
        joint: (E,) joints that numbers filter, and
        number: (E,) the numbers, of S, and
        slope: (F, E) by how much gains grow with these.
        n_numbers: S.
    """

    gain: Complex
    joint: Int
    number: Int
    slope: Complex
    n_numbers: int

    @staticmethod
    def of(unseen: Unseen | None, log: ShakenLog, x: F64) -> _Filters | None:
        """Of numbers x (S,); None where none is a filter's."""
        if unseen is None or not unseen.derivative.any():
            return None
        some = np.flatnonzero(unseen.derivatives)
        joint, number = unseen.joint[some], unseen.number[some]
        slope = unseen.units[some] * (1j * log.w[:, None]) ** unseen.derivatives[some]
        slope = slope / log.times[:, joint]
        gain = np.ones(log.power.shape, dtype=np.complex128)
        np.add.at(gain.T, joint, (slope * x[number]).T)
        return _Filters(gain, joint, number, slope, unseen.n_numbers)

    def pull(self, noise: F64) -> F64:
        """(S,) half the slope of noise (F, D) that is left, with its sign turned."""
        each = noise[:, self.joint] * (self.gain[:, self.joint].conj() * self.slope).real
        out = np.zeros(self.n_numbers)
        np.add.at(out, self.number, each.sum(axis=0))
        return out


def _in_bands(w: F64, power: F64, most: int) -> tuple[F64, F64]:
    """Frequencies (F,) and what each has of a noise (F, D), of so many bands at most."""
    first = np.unique(np.linspace(0, len(w), most + 1).astype(np.int64)[:-1])
    summed = np.add.reduceat(power, first)
    of_all = power.sum(axis=1)
    mean = np.add.reduceat(w * of_all, first) / np.maximum(np.add.reduceat(of_all, first), 1e-300)
    return mean, summed


def _kept_less(kept: F64) -> tuple[F64, F64]:
    """How much less of noise is kept than there is, and by how much it falls as more is kept.

    Args:
        kept: parts (F, U) of the noise's squares that front ends keep; more than all where these
            rise. Of what rises the rest can be no more than all: noise that is known too large
            would else pay for sensors that rise without an end.
    """
    rises = kept > 1
    over = np.where(rises, kept, 1.0)
    return np.where(rises, 1 / over - 1, 1 - kept), over**-2.0


def made_by_encoders(tree: KinematicTree, log: Trajectory, places: State) -> F64 | None:
    """(U, K) variance of what encoders' noise makes of an axis of predicted readings [m^2/s^4].

    None where positions are exact.

    Args:
        tree: the structure.
        log: the trajectory.
        places: where joints and SUs are.
    """
    if log.noise is None:
        return None
    shaking = log.shaken[::EVERY] * log.noise
    some = np.einsum("kd,udk->uk", shaking, _felt_of_some(tree, log, places)) / 3
    return np.repeat(some, EVERY, axis=1)[:, : len(log.kept)]


def _felt_of_some(tree: KinematicTree, log: Trajectory, places: State) -> F64:
    """(U, D, k) squares that a unit of acceleration makes of every so manieth sample."""
    return np.asarray(felt_of_joints(tree, places, log.q[log.kept[::EVERY], : tree.n_joints]))
