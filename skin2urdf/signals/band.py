"""The band in which a log is looked at: as wide as the motion, and no wider than encoders know it.

An encoder's rounding, seen through two differentiations, grows with the frequency to the fourth
power, and with the cutoff of a low-pass to the power of 2.5. With S(f) the spectrum of a joint's
accelerations, P(f) that of what its encoder makes of them, and A(f) that of the sensor's noise, the
length r of an arm that least squares find has, over a time T, the relative variance

    v = int S (A / r^2 + P) df / (2 T (int S df)^2) + (c int P df / int S df)^2

up to the cutoff. The first part is that of noise beside the motion. The second is that of noise in
it, by which lengths come out shorter (errors in variables: Fuller 1987): what is known of that is
taken off, but for a part c. So a band beyond the motion costs nothing where encoders are finer than
sensors are quiet. Where they are not, a robot that takes seconds for its moves is known several
times better in a band of 2 Hz than in one of 5 Hz: of 12 bits read at 100 Hz, rounding makes
0.006 rad/s^2 in the one, and 0.06 in the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.signals.motion import Motion
from skin2urdf.signals.poses import Neighbourhood

_BANDS_PER_HERTZ = 8
_HIGHEST = 32
"""Frequency up to which motion is looked at [Hz]: no motion of a robot's links is faster."""
_SHORTEST = 64
"""Samples of a window at least, half a second, in which a pattern shows."""
_MOST_OF_IT = 0.98
"""Part of the motion's energy that is kept, with second harmonics, which turning makes."""
_HARMONICS, _MARGIN = 2.2, 1.0
"""Cutoff over the highest frequency of a motion, and what it is beyond that [Hz]: second harmonics
pass, which turning makes."""
_NARROWEST, _USUAL, _WIDEST = 2.0, 5.0, 20.0
"""Cutoffs [Hz]: below the first one, low-passes take more than three seconds of a log's ends and of
what lies beside its gaps; patterns lie below the second one; sensors and grids end at the last."""
_PATTERNS = 0.01
"""Energy of the motion in poses, over that of the whole log, from which there are patterns: of a
pattern of 1 rad/s in every pose it is a tenth and more, of a robot that only rests there 1e-6."""
_CERTAIN = 5.0
"""Standard deviations of a periodogram by which motion has to be above the noise of encoders."""
_ARM = 0.3
"""Arm of an SU about a joint [m], half of an arm's links."""
_UNKNOWN = 0.3
"""Part of what encoders' noise does to lengths that is not taken off: rounding is white in the mean
of many motions only."""
_ENOUGH = 0.9
"""Part of what the best band tells that a wider one has to tell: errors are 5 % larger then, and
clocks and low-passes of sensors show at high frequencies."""


def quietness(readings: F64, still: Bool, rate: float) -> float:
    """Noise of an SU, as a one-sided spectral density [m^2/s^4/Hz]; NaN where it never rests.

    Digits count as noise, which the median of steps (:func:`skin2urdf.signals.health.rest_noise`)
    has none of where they are coarse; and moments that stand for rests may be slow motion.

    Args:
        readings: (N, 3) on the grid.
        still: (N,) where the robot rests, and they are valid.
        rate: of the grid [Hz].
    """
    rests = still[2:] & still[1:-1] & still[:-2]
    if not rests.any():
        return float("nan")
    # Second differences leave nothing of slow motion, and six times the square of noise.
    bend = np.diff(readings, n=2, axis=0)[rests]
    return float((bend**2).mean()) / 6 / (rate / 2)


@dataclass(frozen=True)
class Cutoffs:
    """Cutoffs of the low-passes that suit a log, at -6 dB [Hz].

    Attributes:
        patterns: of what is looked at around poses; it keeps the patterns' accelerations and their
            second harmonics.
        along: of all samples, along the whole log; the same, or less where encoders do not know the
            motion so far.
    """

    patterns: float
    along: float


def suitable_cutoffs(
    motion: Motion, neighbourhoods: Sequence[Neighbourhood], quiet: F64
) -> Cutoffs:
    """The bands in which a log is looked at.

    Around poses, patterns need theirs, however coarse encoders are: features are sums of harmonics.
    In a log without patterns both are the same.

    Args:
        motion: of the joints.
        neighbourhoods: poses, with the windows in which patterns may be.
        quiet: (U,) noise of SUs, see :func:`quietness`, of which the middle one counts.
    """
    patterns = _Spectrum(motion, [w for pose in neighbourhoods for w in pose.windows])
    everything = _Spectrum(motion, [(0, motion.grid.size)])
    some = patterns.energy.sum() >= _PATTERNS * everything.energy.sum()
    usual = _kept_by(patterns if some else everything)
    measured = quiet[np.isfinite(quiet)]
    beside = float(np.median(measured)) if len(measured) else 0.0
    told = everything.information(beside / _ARM**2)
    enough = np.flatnonzero(told >= _ENOUGH * told.max())
    known = (enough[-1] + 1) / _BANDS_PER_HERTZ if told.max() > 0 else _WIDEST
    along = float(np.clip(known, _NARROWEST, usual))
    return Cutoffs(usual if some else along, along)


def _kept_by(spectrum: _Spectrum) -> float:
    """Cutoff [Hz] that keeps nearly all of a motion, and what turning makes of it."""
    energy = spectrum.energy
    share = np.cumsum(energy) / max(energy.sum(), 1e-12)
    highest = float(np.searchsorted(share, _MOST_OF_IT) / _BANDS_PER_HERTZ)
    return float(np.clip(_HARMONICS * highest + _MARGIN, _USUAL, _WIDEST))


class _Spectrum:
    """Motion of D joints in B bands of an eighth of a hertz, above what their encoders make of it.

    Attributes:
        energy: (B,) of the velocities of all joints, over the noise of their encoders; 0 in bands
            that hold no more than that.
    """

    def __init__(self, motion: Motion, windows: Sequence[tuple[int, int]]) -> None:
        """Add up the periodograms of all windows that are long enough."""
        bands = _HIGHEST * _BANDS_PER_HERTZ + 1
        rate, joints = motion.grid.rate, len(motion.dof_names)
        read, made = np.zeros((bands, joints)), np.zeros((bands, joints))
        values = np.zeros(bands)
        self._density = motion.noise_density
        self._seconds = 0.0
        for begin, end in windows:
            if end - begin < _SHORTEST:
                continue
            window = np.hanning(end - begin)[:, None]
            power = np.abs(np.fft.rfft(motion.qd[begin:end] * window, axis=0)) ** 2
            f = np.fft.rfftfreq(end - begin, 1 / rate)
            index = np.minimum((f * _BANDS_PER_HERTZ).astype(int), bands - 1)
            np.add.at(read, index, power / (0.5 * rate * (window**2).sum()))
            np.add.at(made, index, (2 * np.pi * f[:, None]) ** 2 * self._density)
            np.add.at(values, index, 1.0)
            self._seconds += (end - begin) / rate
        scale = np.maximum(motion.noise * 100, 1e-4) ** 2
        over, beside = (read / scale).sum(axis=1), (made / scale).sum(axis=1)
        # Of each value in a band a periodogram has two degrees of freedom, for every joint.
        chance = np.sqrt(1 / np.maximum(values * joints, 1.0))
        moves = over > beside * (1 + np.maximum(1.0, _CERTAIN * chance))
        self.energy = np.where(moves, over - beside, 0.0)
        mean = np.maximum(read - made, 0.0) / np.maximum(values, 1.0)[:, None]
        self._velocity = np.where(moves[:, None], mean, 0.0)

    def information(self, beside: float) -> F64:
        """(B,) what all joints' accelerations up to each band tell of lengths, in no unit.

        Args:
            beside: noise of sensors, per square of an arm [1/s^4/Hz].
        """
        width = 1 / _BANDS_PER_HERTZ
        w = 2 * np.pi * (np.arange(len(self.energy))[:, None] + 0.5) * width
        motion, encoder = self._velocity * w**2, self._density * w**4
        known = np.cumsum(motion, axis=0) * width
        beside_it = np.cumsum(motion * (beside + encoder), axis=0) * width / (2 * self._seconds)
        within = _UNKNOWN * np.cumsum(encoder, axis=0) * width
        error = beside_it + within**2
        told = np.divide(known**2, error, out=np.zeros_like(known), where=error > 0)
        return np.asarray(told.sum(axis=1))
