"""What sampling leaves open where motion leaps: patterns that begin at once, drives that stop.

An acceleration that lasts for less than the time between two readings is missed by them, or is
taken for one that lasts as long as that time. Where in that time a step of height h comes is
anybody's guess, so that the mean over it has the variance ``h^2 / 12``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.signals.filters import filtered, low_pass, second_derivative
from skin2urdf.signals.motion import SMOOTH, Motion
from skin2urdf.threads import do_each

_CLEAR = 5.0
"""Standard deviations of noise from which steps count: chance makes one in a million samples, a
pattern that begins at once a hundred and more."""


@dataclass(frozen=True, eq=False)
class Leaps(Record):
    """What sampling leaves open at K samples of a trajectory.

    Attributes:
        joints: (K, D) variance of the accelerations of D joints, were an SU read as often as the
            grid has samples [rad^2/s^4 or m^2/s^4].
        readings: (K, U) variance per axis of readings, as they themselves show it where they are
            fewer than the samples of the grid; others are low-passed first [m^2/s^4].
        period: (U,) time between an SU's readings, over that between samples of the grid.
    """

    joints: F64
    readings: F64
    period: F64

    @classmethod
    def of(
        cls, motion: Motion, readings: Iterable[F64], period: F64, taps: F64, kept: Int
    ) -> Leaps:
        """Look for leaps.

        Args:
            motion: of the joints, on N samples of a grid.
            readings: of each SU (N, 3), on the same [m/s^2].
            period: (U,) time between two readings of an SU [s].
            taps: of the low-pass that both go through twice.
            kept: (K,) samples that are wanted.
        """
        rate = motion.grid.rate
        noise = _noise_of_steps(motion, taps)
        # Positions tell how much velocity changed between two of them: it may have been at once.
        spread = np.maximum(1.0, rate / motion.raw_rate)
        joints = _steps(motion.qdd, taps)
        joints = spread * np.where(np.abs(joints) > _CLEAR * noise, joints, 0.0)
        ratio = rate * period
        felt = np.zeros((len(kept), len(ratio)))

        def look(numbered: tuple[int, F64]) -> None:
            u, read = numbered
            # Those that are read more often than the grid has samples are low-passed to it.
            if ratio[u] > 1:
                steps = _steps(read, taps)
                usual = np.median(np.abs(steps), axis=0) / 0.6745
                clear = np.where(np.abs(steps) > _CLEAR * usual, steps, 0.0)
                felt[:, u] = ratio[u] ** 2 * _low_passed((clear**2).mean(axis=1), taps)[kept]

        do_each(look, enumerate(readings), len(ratio))
        return cls(_low_passed(joints**2, taps)[kept], felt, ratio)

    def ordered(self, dofs: Int, sus: Int) -> Leaps:
        """The same with other columns."""
        return Leaps(self.joints[:, dofs], self.readings[:, sus], self.period[sus])

    def only(self, which: slice) -> Leaps:
        """The same at some samples."""
        return Leaps(self.joints[which], self.readings[which], self.period)

    def variance(self, levers: F64) -> F64:
        """(K, U) variance per axis of what sampling leaves open, as the joints tell [m^2/s^4].

        What the readings tell is left aside: weights that follow them would prefer those that
        missed a leap to those that met it.

        Args:
            levers: (U, D) reading per acceleration of a joint at most [m, or 1].
        """
        return np.asarray(self.joints @ (levers**2 * self.period[:, None] ** 2).T)


def between_positions(q: F64, rate: float, raw_rate: F64, taps: F64) -> F64:
    """Variance (N, D) of accelerations that positions leave open between those that were read.

    Curves of fifth order go through them (:mod:`~skin2urdf.signals.filters`). How far those of
    third order are off these is more than these are off the motion, by about as much as it is less
    smooth than they are: a joint that swings at 3 Hz, or stops, in a stream of 20 Hz.

    Args:
        q: (N, D) positions on a grid, low-passed [rad or m].
        rate: of the grid [Hz].
        raw_rate: (D,) of the positions that were read [Hz].
        taps: of the low-pass.
    """
    time, out = np.arange(len(q)) / rate, np.zeros(q.shape)
    twice = np.convolve(taps, taps)
    around = np.abs(twice) / np.abs(twice).sum()
    for raw in np.unique(raw_rate[raw_rate < rate]):
        its = np.flatnonzero(raw_rate == raw)
        read = np.arange(0.0, time[-1], 1 / raw)
        positions = CubicSpline(time, q[:, its])(read)
        off = CubicSpline(read, positions)(np.minimum(time, read[-1])) - q[:, its]
        squares = filtered(second_derivative(off, rate), taps) ** 2
        out[:, its] = filtered(squares, around).clip(0.0)
    return out


def _steps(x: F64, taps: F64) -> F64:
    """Steps (N, ...) from sample to sample of what a low-pass does not let through.

    What it does is sampled finely enough.
    """
    fast = x - filtered(x, taps)
    return np.diff(fast, axis=0, append=fast[-1:])


def _noise_of_steps(motion: Motion, taps: F64) -> F64:
    """(D,) standard deviation of the steps that white noise of the positions makes.

    Accelerations are second derivatives of low-passed positions. A stream slower than the grid
    holds nothing beyond half its rate.
    """
    rate = motion.grid.rate
    # Both low-passes are a few dozen taps long: a period of 1024 samples holds them.
    f = np.fft.rfftfreq(1024, 1 / rate)
    smooth, slow = (np.abs(np.fft.rfft(t, 1024)) for t in (low_pass(SMOOTH, rate), taps))
    power = ((2 * np.pi * f) ** 2 * smooth * (1 - slow) * 2 * np.sin(np.pi * f / rate)) ** 2
    held = f[:, None] <= motion.raw_rate / 2
    variance = motion.noise_density
    return np.asarray(np.sqrt(variance * np.trapezoid(power[:, None] * held, f, axis=0)))


def _low_passed(squares: F64, taps: F64) -> F64:
    """Variance (N, C) of what two low-passes leave of steps of random places."""
    return np.asarray(np.maximum(filtered(squares, np.convolve(taps, taps) ** 2), 0.0)) / 12
