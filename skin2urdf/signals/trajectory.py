"""Samples -> Trajectory: the whole motion of a log and all readings along it, low-passed alike.

Between poses nothing is constant, so that no regression can sum the samples up: they are predicted
one by one. What both sides go through is the same: the positions are low-passed before they are
differentiated and the prediction once more after it, the readings twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Bool, Complex, Int, Record
from skin2urdf.recording.shelf import Shelf, room_for_streams
from skin2urdf.signals.digits import rounding
from skin2urdf.signals.filters import (
    Spline,
    eroded,
    filtered,
    first_derivative,
    higher_derivatives,
    low_pass,
    noise_bandwidth,
    second_derivative,
)
from skin2urdf.signals.leaps import Leaps, between_positions
from skin2urdf.signals.sampling import Sampled
from skin2urdf.signals.stillness import MOVING, averaged_share, with_averages, without_toggling
from skin2urdf.threads import do_each, each

_RATE_OVER_CUTOFF = 2.4
"""Samples kept per second over the low-pass' cutoff [Hz]: readings that were low-passed twice hold
1e-7 of their noise beyond 1.2 times the cutoff, and both sides of the comparison alias alike."""
_WIDER = 1.5
"""Cutoff of the low-pass in which deflections and torques are worked out, over that of the log: of
what passes this, it leaves all."""
ENOUGH_MOTION = 10.0
"""Time in motion from which a log tells more than its rests do, however many of these have no
samples to compare [s]: three or four moves, as few as show where an SU sits on a known robot."""
_NOTHING = 1e-6
"""Power of noise, over the largest, below which a frequency has none: 4e-8 of all is left out."""


@dataclass(frozen=True, eq=False)
class Trajectory(Record):
    """One log as a trajectory of N grid samples, of which K are compared with a model.

    Attributes:
        log: number of the log.
        rate: grid samples per second [Hz].
        taps: the low-pass that a prediction on the grid has to go through.
        q: (N, D) joint positions, low-passed once [rad or m], and their derivatives
        qd: (N, D) and
        qdd: (N, D).
        readings: (N, U, 3) low-passed twice [m/s^2].
        kept: (K,) grid samples that are compared.
        valid: (K, U) where the readings are whole.
        moving: (K, D) where a joint moves.
        shaken: (K, D) share of ``noise`` that is in the prediction: of encoders that round, what is
            left around a rest beside what averages take, at most; of others, where a joint moves.
        independence: independent measurements in one kept sample, at most 1.
        rates: (N, U, 3) what gyroscopes read, low-passed twice [rad/s]; None without any.
        turning: (K, U) where those are whole.
        noise: (D,) variance of what encoders' noise makes of an acceleration, low-passed twice,
            while a joint moves [rad^2/s^4, or m]; None where positions are exact.
        leaps: what sampling leaves open where motion leaps; None where it does not.
        digits: (U, 2) size of an SU's digits, and what averages leave of them, rms [m/s^2]; (0, 2)
            where they leave nothing.
        publisher: (D,) number of the publisher whose messages hold each joint, as in
            :class:`~skin2urdf.signals.motion.Motion`; (0,) where all have one.
        positions: (N, D) joint positions as they were before the low-pass; (0, 0) where they are
            not known [rad or m].
        beyond: (K, U, 3) what readings hold beyond those of the low-passed motion, with gyroscopes
            (K, U, 6), theirs last, see :mod:`~skin2urdf.estimation.trajectory.products`; None where
            that is not known [m/s^2, rad/s].
        resolution: (D,) smallest step of each encoder [rad or m], 0 for none; (0,) where all have
            none.
        raw_rate: (D,) samples per second of each encoder [Hz], of which the grid holds low-passed
            ones; (0,) where they are the grid's own.
        averaged: (N, D) what averages took off positions of joints that stay, low-passed once
            [rad or m]; (0, 0) where they took nothing.
        left_out: (N, E) positions of joints that move and are none of these; (0, 0) for none.
        further: (O, D) how much of their second and higher derivatives was added to positions, in
            which their noise is as well [s^2, s^3, ...]; (0, 0) for none.
        smoothed: (N, D) positions before that, low-passed once; (0, 0) for none [rad or m].
        effort: (N, D) measured torques, low-passed once [N m or N], NaN for joints of which the log
            does not hold them; (0, 0) where it holds none.
        motion_cutoff: of a low-pass that keeps all of the joints' motion [Hz]; 0 where that is the
            log's own.
        thin: of the samples that hold all that the low-pass lets through, one in so many is kept.
        known: what was made of readings, and the readings; of the same ones nothing is made anew.
    """

    log: int
    rate: float
    taps: F64
    q: F64
    qd: F64
    qdd: F64
    readings: F64
    kept: Int
    valid: Bool
    moving: Bool
    shaken: F64
    independence: float
    rates: F64 | None = None
    turning: Bool | None = None
    noise: F64 | None = None
    leaps: Leaps | None = None
    digits: F64 = field(default_factory=lambda: np.zeros((0, 2)))
    publisher: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    positions: F64 = field(default_factory=lambda: np.zeros((0, 0)))
    beyond: F64 | None = None
    resolution: F64 = field(default_factory=lambda: np.zeros(0))
    raw_rate: F64 = field(default_factory=lambda: np.zeros(0))
    averaged: F64 = field(default_factory=lambda: np.zeros((0, 0)))
    left_out: F64 = field(default_factory=lambda: np.zeros((0, 0)))
    further: F64 = field(default_factory=lambda: np.zeros((0, 0)))
    smoothed: F64 = field(default_factory=lambda: np.zeros((0, 0)))
    effort: F64 = field(default_factory=lambda: np.zeros((0, 0)))
    motion_cutoff: float = 0.0
    thin: int = 1
    known: dict[str, tuple[F64, tuple[Spline, ...]]] = field(default_factory=dict, repr=False)

    @property
    def time(self) -> F64:
        """(K,) times of the kept samples since the log's first one [s]."""
        return np.asarray(self.kept / self.rate)

    @property
    def in_motion(self) -> float:
        """Time for which readings are compared while joints move [s]."""
        compared = self.valid.any(axis=1) & self.moving.any(axis=1)
        apart = float(np.median(np.diff(self.time))) if len(self.kept) > 1 else 0.0
        return apart * float(compared.sum())

    @property
    def splines(self) -> tuple[Spline, ...]:
        """The readings of each of the U SUs, to be taken at fractional positions on the grid."""
        return self._splines("readings", self.readings, Shelf())

    @property
    def rate_splines(self) -> tuple[Spline, ...]:
        """The same of gyroscopes; none where there are none."""
        return () if self.rates is None else self._splines("rates", self.rates)

    def _splines(self, name: str, values: F64, shelf: Shelf | None = None) -> tuple[Spline, ...]:
        """Splines through values (N, U, 3); logs that differ in other things share them."""
        of, splines = self.known.get(name, (None, ()))
        if of is not values:
            columns = values.swapaxes(0, 1)
            splines = tuple(each(lambda x: Spline(x, shelf), columns, len(columns)))
            self.known[name] = values, splines
        return splines

    @cached_property
    def between_positions(self) -> F64:
        """(K, D) variance of accelerations that positions leave open between those read."""
        if not len(self.raw_rate):
            return np.zeros((len(self.kept), self.q.shape[1]))
        return between_positions(self.q, self.rate, self.raw_rate, self.taps)[self.kept]

    @property
    def since_middle(self) -> F64:
        """(N,) times of all grid samples since the middle of those that are compared [s]."""
        return np.asarray(np.arange(len(self.q)) / self.rate - 0.5 * (self.time[0] + self.time[-1]))

    def noise_spectrum(self) -> tuple[F64, F64]:
        """Angular frequencies (F,) [rad/s], and what each has of ``noise`` (F, D)."""
        w, gain = _passed_twice(self.taps, self.rate)
        power = (gain * w**4)[:, None] * np.abs(self.times(w)) ** 2
        some = (power > _NOTHING * power.max(axis=0)).any(axis=1)
        noise = np.zeros(self.q.shape[1]) if self.noise is None else self.noise
        return w[some], noise * power[some] / power[some].sum(axis=0)

    def times(self, w: F64) -> Complex:
        """(F, D) what positions are times, by what was added of their derivatives.

        Args:
            w: (F,) angular frequencies [rad/s].
        """
        return _set_further(w, self.further, self.q.shape[1])

    @property
    def rounding(self) -> F64:
        """(D,) the part of ``noise`` that rounding makes, if that is white [rad^2/s^4, or m]."""
        if not len(self.resolution):
            return np.zeros(self.q.shape[1])
        raw = self.raw_rate if len(self.raw_rate) else np.full(self.q.shape[1], self.rate)
        white = _of_accelerations(self.resolution**2 / 12, raw, self.taps, self.rate)
        return white * _louder(self.further, self.taps, self.rate, len(white))

    def as_sampled(self, several: Iterable[F64]) -> Iterator[F64]:
        """Positions (N, D), each as those that are read: averages where joints stay, low-passed."""
        share = np.zeros(self.q.shape)
        if len(self.resolution):
            share = averaged_share(np.abs(self.qd), self.resolution, self.rate)
        for q in several:
            passed = filtered(with_averages(q, share, self.rate), self.taps)
            yield passed + self._of_derivatives(passed, self.further)

    def with_joints_off(self, off: F64) -> Trajectory:
        """The same with positions (N, D) that are off by so much, low-passed as they are."""
        return replace(
            self,
            q=self.q + off,
            qd=self.qd + first_derivative(off, self.rate),
            qdd=self.qdd + second_derivative(off, self.rate),
        )

    def with_joints_further(self, numbers: F64) -> Trajectory:
        """The same with joints further by so much of their derivatives, as is their noise.

        Positions as they were sampled get what the low-pass leaves nearly all of: a gain of H
        becomes one of ``1 - (1 - H)^2`` where what is left out is added once more (Tukey 1977).

        Args:
            numbers: (O, D) times the second, third and further derivatives [s^2, s^3, ...].

        Raises:
            ValueError: they are further already.
        """
        if len(self.further):
            raise ValueError("joints are further by derivatives of positions that were read")
        by, positions = self._of_derivatives(self.q, numbers), self.positions
        if len(positions):
            positions = positions + 2 * by - filtered(by, self.taps)
        louder = _louder(numbers, self.taps, self.rate, self.q.shape[1])
        return replace(
            self.with_joints_off(by),
            positions=positions,
            further=numbers,
            smoothed=self.q,
            noise=None if self.noise is None else self.noise * louder,
        )

    def _of_derivatives(self, q: F64, numbers: F64) -> F64:
        """(N, D) numbers (O, D) times the second and higher derivatives of positions."""
        if not len(numbers):
            return np.zeros(q.shape)
        return np.asarray(
            (higher_derivatives(q, self.rate, len(numbers) + 1) * numbers[:, None]).sum(0)
        )

    def joints_taken(self, joints: Int, late: F64) -> Trajectory:
        """The same with the positions of some joints as they are so much later.

        Args:
            joints: (J,) which.
            late: (N,) by how much later each position is taken [s].
        """
        at = self._later(late)

        def taken(x: F64) -> F64:
            out = np.array(x)
            out[:, joints] = Spline(out[:, joints]).within(at)
            return out

        return self._with_all(taken)

    def each_joint_taken(self, late: F64) -> Trajectory:
        """The same with the positions of each joint as they are so much (D,) later [s]."""

        def taken(x: F64) -> F64:
            columns = zip(x.T, late * self.rate, strict=True)
            return np.hstack([Spline(column[:, None]).later(by) for column, by in columns])

        return self._with_all(taken)

    def _with_all(self, taken: Callable[[F64], F64]) -> Trajectory:
        """The same with what is known of joints (N, D) in another way, and what follows from it."""
        q = taken(self.q)
        return replace(
            self,
            q=q,
            qd=first_derivative(q, self.rate),
            qdd=second_derivative(q, self.rate),
            effort=taken(self.effort) if len(self.effort) else self.effort,
            positions=taken(self.positions) if len(self.positions) else self.positions,
            smoothed=taken(self.smoothed) if len(self.smoothed) else self.smoothed,
        )

    def read_later(self, late: F64) -> Trajectory:
        """The same with readings that belong to so much later, as a clock of SUs that wanders says.

        The motion of all joints is that at these times, at the pace that it has.

        Args:
            late: (N,) by how much later each sample was read [s].
        """
        at = self._later(late)
        q, qd, qdd = (Spline(x).within(at) for x in (self.q, self.qd, self.qdd))
        effort, smoothed = (
            Spline(x).within(at) if len(x) else x for x in (self.effort, self.smoothed)
        )
        return replace(self, q=q, qd=qd, qdd=qdd, effort=effort, smoothed=smoothed)

    def _later(self, late: F64) -> F64:
        """(N,) fractional grid samples that are so much (N,) later [s], within the log."""
        last = len(self.q) - 1
        return np.asarray(np.clip(np.arange(last + 1) + late * self.rate, 0, last))

    def with_joints_times(self, factor: F64) -> Trajectory:
        """The same with the positions of joints times factors (D,), as others would count them."""
        known = len(self.positions) > 0
        return replace(
            self,
            q=self.q * factor,
            qd=self.qd * factor,
            qdd=self.qdd * factor,
            positions=self.positions * factor if known else self.positions,
            smoothed=self.smoothed * factor if len(self.smoothed) else self.smoothed,
            resolution=self.resolution * np.abs(factor)
            if len(self.resolution)
            else self.resolution,
            # Who counts a turn the other way counts its torque that way, too.
            effort=self.effort * np.sign(factor) if len(self.effort) else self.effort,
        )

    @property
    def path(self) -> F64:
        """(N, D) joint positions with all of their motion, and nothing beyond [rad or m]."""
        if not (self.motion_cutoff and len(self.positions)):
            return self.q
        return filtered(self.positions, low_pass(self.motion_cutoff, self.rate))

    @cached_property
    def rounded(self) -> F64:
        """(K, U) variance by which readings are off alike for a while, by digits [m^2/s^4]."""
        if not self.digits.any():
            return np.zeros(self.valid.shape)
        return rounding(self.readings[self.kept], self.digits, self.independence)

    @property
    def every(self) -> int:
        """Grid samples from one of those that hold all to the next."""
        return int(self.kept[1] - self.kept[0]) // self.thin if len(self.kept) > 1 else 1

    def smooth(self, x: F64) -> F64:
        """Low-pass (N, ...) by what loses nothing that passes the log's own low-pass.

        What is worked out from positions has been through that once, so that a wide one will do,
        which leaves no part of what passes behind. A gain of H becomes one of ``1 - (1 - H)^2``
        (twicing: Tukey 1977).
        """
        taps = low_pass(_WIDER * noise_bandwidth(self.taps, self.rate), self.rate)
        twice = 2 * np.pad(taps, len(taps) // 2) - np.convolve(taps, taps)
        return filtered(x, twice)

    def thinned(self, by: int) -> Trajectory:
        """The same with one in so many of the kept samples."""
        few = self._only(slice(None, None, by))
        return replace(few, independence=min(1.0, by * self.independence), thin=by * self.thin)

    def without_first(self, seconds: float) -> Trajectory:
        """The same with nothing compared in the first seconds of the log."""
        first = np.searchsorted(self.kept, seconds * self.rate)
        return self._only(slice(int(first), None))

    def _only(self, which: slice) -> Trajectory:
        """The same with some of the kept samples."""
        return replace(
            self,
            kept=self.kept[which],
            valid=self.valid[which],
            moving=self.moving[which],
            shaken=self.shaken[which],
            turning=None if self.turning is None else self.turning[which],
            leaps=None if self.leaps is None else self.leaps.only(which),
            beyond=None if self.beyond is None else self.beyond[which],
        )

    def slower(self, by: int) -> Trajectory:
        """The same motion and readings through a low-pass of so many times lower cutoff.

        What readings hold beyond those of the low-passed motion is left out.
        """
        more = low_pass(noise_bandwidth(self.taps, self.rate) / by, self.rate)
        taps, reach = np.convolve(self.taps, more), len(more) - 1
        margin = len(taps) // 2
        inside = (self.kept >= margin) & (self.kept < len(self.q) - margin)
        few = np.flatnonzero(inside)[::by]
        every = int(self.kept[1] - self.kept[0]) if len(self.kept) > 1 else 1
        whole = np.stack([eroded(each, -(-reach // every)) for each in self.valid.T], axis=1)
        q = filtered(self.q, more)
        twice = np.convolve(taps, taps)
        return replace(
            self,
            taps=taps,
            q=q,
            qd=first_derivative(q, self.rate),
            qdd=second_derivative(q, self.rate),
            readings=filtered(filtered(self.readings, more), more),
            effort=filtered(self.effort, more) if len(self.effort) else self.effort,
            smoothed=filtered(self.smoothed, more) if len(self.smoothed) else self.smoothed,
            kept=self.kept[few],
            valid=whole[few],
            moving=self.moving[few],
            shaken=self.shaken[few],
            independence=min(1.0, 2 * noise_bandwidth(twice, self.rate) * every * by / self.rate),
            rates=None,
            turning=None,
            noise=None,
            leaps=None,
            beyond=None,
        )


def trajectory(
    sampled: Sampled, log: int, reach: float = 0.0, sus: Int | None = None
) -> Trajectory:
    """Low-pass a log's motion and readings for comparison along the whole of it.

    Args:
        sampled: the log on its grid.
        log: its number.
        reach: how far readings may still be shifted in time [s]; nothing is compared so near to
            a gap.
        sus: (U,) which of the log's SUs, in which order; all of them by default.
    """
    sus = np.arange(sampled.valid.shape[1]) if sus is None else sus
    motion, rate = sampled.motion, sampled.motion.grid.rate
    taps = low_pass(sampled.cutoff_along, rate)
    half = len(taps) // 2
    positions, left = without_toggling(motion, taps)
    q = filtered(positions, taps)
    every = max(1, int(rate / (_RATE_OVER_CUTOFF * sampled.cutoff_along)))
    kept = np.arange(half, motion.grid.size - half, every)
    readings = room_for_streams(motion.grid.size, len(sus))

    def low_passed(u: int) -> None:
        readings[:, u] = filtered(filtered(sampled.readings[:, sus[u]], taps), taps)

    do_each(low_passed, range(len(sus)), len(sus))
    readings.flags.writeable = False  # of which the record then needs no copy
    whole = (sampled.valid & ~sampled.computed & motion.valid[:, None])[:, sus]
    margin = 2 * half + int(np.ceil(reach * rate))
    valid = np.stack([eroded(column, margin)[kept] for column in whole.T]).T
    rates, turning = None, None
    if sampled.turning is not None:
        rates = filtered(filtered(sampled.turning.rates[:, sus], taps), taps)
        there = (sampled.turning.valid & motion.valid[:, None])[:, sus]
        turning = np.stack([eroded(column, margin)[kept] for column in there.T]).T
    twice = np.convolve(taps, taps)
    moving = (np.abs(motion.qd) >= np.maximum(MOVING * motion.resolution, 1e-3))[kept]
    # What passes both low-passes comes from as far as they reach.
    around = np.abs(twice) / np.abs(twice).sum()
    smeared = filtered(left**2, around)[kept].clip(0.0, 1.0)
    shaken = np.where(motion.resolution > 0, smeared, moving)
    return Trajectory(
        log=log,
        rate=rate,
        taps=taps,
        q=q,
        qd=first_derivative(q, rate),
        qdd=second_derivative(q, rate),
        readings=readings,
        kept=kept,
        valid=valid,
        moving=moving,
        shaken=shaken,
        independence=min(1.0, 2 * noise_bandwidth(twice, rate) * every / rate),
        noise=_of_accelerations(motion.noise**2, motion.raw_rate, taps, rate),
        rates=rates,
        turning=turning,
        leaps=Leaps.of(
            motion, (sampled.readings[:, u] for u in sus), sampled.period[sus], taps, kept
        ),
        digits=sampled.digits[sus],
        publisher=motion.publisher,
        positions=positions,
        resolution=motion.resolution,
        raw_rate=motion.raw_rate,
        motion_cutoff=sampled.cutoff if sampled.cutoff > sampled.cutoff_along else 0.0,
        averaged=filtered(motion.q - positions, taps) if (left < 1).any() else np.zeros((0, 0)),
        effort=filtered(motion.effort, taps) if len(motion.effort) else motion.effort,
    )


def _of_accelerations(variance: F64, raw_rate: F64, taps: F64, rate: float) -> F64:
    """(D,) variances of accelerations, of white noise of positions.

    Args:
        variance: (D,) of each sample that is read [rad^2 or m^2].
        raw_rate: (D,) of these [Hz].
        taps: the low-pass, and
        rate: of its samples [Hz].
    """
    w, gain = _passed_twice(taps, rate)
    density = 2 * variance / raw_rate / (2 * np.pi)
    return np.asarray(density * np.trapezoid(gain * w**4, w))


def _louder(numbers: F64, taps: F64, rate: float, n_joints: int) -> F64:
    """(D,) variance of accelerations' noise over what it is with nothing added to positions."""
    w, gain = _passed_twice(taps, rate)
    power = gain * w**4
    return np.asarray(power @ np.abs(_set_further(w, numbers, n_joints)) ** 2 / power.sum())


def _set_further(w: F64, numbers: F64, n_joints: int) -> Complex:
    """(F, D) what positions are times by so much of their derivatives."""
    if not len(numbers):
        return np.ones((len(w), n_joints), dtype=np.complex128)
    return 1 + (1j * w[:, None]) ** np.arange(2, len(numbers) + 2) @ numbers


def _passed_twice(taps: F64, rate: float) -> tuple[F64, F64]:
    """Angular frequencies (F,) up to half a rate [rad/s], and what passes of noise there (F,)."""
    H = np.fft.rfft(taps, 2048)[:-1]
    return np.arange(len(H)) * 2 * np.pi * rate / 2048, np.abs(H) ** 4


def in_order(log: Trajectory, dofs: Int, sus: Int) -> Trajectory:
    """A trajectory with other columns.

    Args:
        log: the trajectory.
        dofs: (D,) which of its joints, in which order.
        sus: (U,) which of its SUs.
    """
    if log.leaps is not None:
        log = replace(log, leaps=log.leaps.ordered(dofs, sus))
    if not np.array_equal(dofs, np.arange(log.q.shape[1])):
        rest = np.setdiff1d(np.flatnonzero(log.moving.any(axis=0)), dofs)
        left_out = log.q[:, rest]
        log = replace(
            log,
            left_out=np.hstack([log.left_out, left_out]) if len(log.left_out) else left_out,
            q=log.q[:, dofs],
            positions=log.positions[:, dofs] if len(log.positions) else log.positions,
            qd=log.qd[:, dofs],
            qdd=log.qdd[:, dofs],
            moving=log.moving[:, dofs],
            shaken=log.shaken[:, dofs],
            publisher=log.publisher[dofs] if len(log.publisher) else log.publisher,
            noise=None if log.noise is None else log.noise[dofs],
            further=log.further[:, dofs] if len(log.further) else log.further,
            smoothed=log.smoothed[:, dofs] if len(log.smoothed) else log.smoothed,
            resolution=log.resolution[dofs] if len(log.resolution) else log.resolution,
            raw_rate=log.raw_rate[dofs] if len(log.raw_rate) else log.raw_rate,
            averaged=log.averaged[:, dofs] if len(log.averaged) else log.averaged,
            effort=log.effort[:, dofs] if len(log.effort) else log.effort,
        )
    # What stays in its order, as mostly, is not copied.
    if np.array_equal(sus, np.arange(log.readings.shape[1])):
        return log
    return replace(
        log,
        readings=log.readings[:, sus],
        beyond=None if log.beyond is None else log.beyond[:, sus],
        valid=log.valid[:, sus],
        digits=log.digits[sus] if len(log.digits) else log.digits,
        rates=None if log.rates is None else log.rates[:, sus],
        turning=None if log.turning is None else log.turning[:, sus],
    )
