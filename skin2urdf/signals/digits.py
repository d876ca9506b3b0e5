"""What digits of sensors leave that averages do not take off.

Where noise is as large as half a digit, it carries a reading over from digit to digit, and the mean
of many is right. A quieter sensor reads the same as long as it stays where it is: all readings of a
rest are off alike, by anything up to half a digit. So are those of slow motion, for as long as the
true value stays within a digit.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.special import erfc

from skin2urdf.arrays import F64, Bool
from skin2urdf.recording.credibility import digit_of

_CARRIED = 0.5
"""Noise, in digits, that carries readings over from digit to digit: averages are then off by less
than a six hundredth of one, and by a tenth where it is 0.25."""
_HARMONICS = np.arange(1, 20)[:, None]
"""Terms of the Fourier series of a sawtooth: those left out hold a thirtieth of its square."""
_LONGER = 1.5
"""From one length of time to the next that is looked at for how long readings stay within a digit:
variances are at most so much too small."""


def changes_share(noise: F64) -> F64:
    """Share of readings of what stays where it is that differ from the one before.

    Of two readings ``x`` digits apart a share of ``min(|x|, 1)`` differs, wherever between two
    digits they lie. Of normal noise of ``s`` digits x has the standard deviation ``d = sqrt(2) s``,
    and the mean of that is ``d sqrt(2 / pi) (1 - exp(-1 / (2 d^2))) + erfc(1 / (sqrt(2) d))``.

    Args:
        noise: (...) standard deviations of noise, in digits; above 0.
    """
    apart = np.sqrt(2) * noise
    share = apart * np.sqrt(2 / np.pi) * (1 - np.exp(-0.5 / apart**2))
    return np.asarray(share + erfc(1 / (np.sqrt(2) * apart)))


def noise_in_digits(changing: F64) -> F64:
    """Noise (...) in digits that makes a share (...) of readings differ from the one before."""
    noise = np.geomspace(1e-3, 10.0, 200) / np.sqrt(2)
    return np.asarray(np.interp(changing, changes_share(noise), noise))


def left_by_averages(samples: F64, still: Bool) -> tuple[float, float]:
    """A sensor's digit, and what averages at rest leave of rounding to it, rms [m/s^2].

    Rounding is a sawtooth of the true value, of whose k-th harmonic noise of ``s`` digits leaves
    ``exp(-2 (pi k s)^2)`` in the mean (Widrow and Kollar 2008).

    Args:
        samples: (M, 3) in the order of their times.
        still: (M,) where the robot rests.
    """
    steps = np.diff(samples, axis=0)
    digit, at_rest = digit_of(steps), steps[still[1:] & still[:-1]]
    if not (digit and len(at_rest)):
        return 0.0, 0.0
    noise = noise_in_digits((at_rest != 0).mean())
    if noise >= _CARRIED:
        return digit, 0.0
    harmonics = np.exp(-4 * (np.pi * _HARMONICS * noise) ** 2) / (np.pi * _HARMONICS) ** 2
    return digit, digit * float(np.sqrt(harmonics.sum() / 2))


def alike(digits: F64) -> F64:
    """The same (U, 2), of sensors with the same digit no less than what is usual of them.

    One that is not turned against gravity reads one value in all rests, which may lie at the edge
    between two digits, and so look noisy.

    Args:
        digits: (U, 2) as :func:`left_by_averages` has them.
    """
    size, left = digits.T
    # Rounding of floats makes equal digits nearly equal.
    same = np.isclose(size[:, None], size, rtol=1e-3, atol=0.0)
    usual = [float(np.median(left[each])) if each.any() else 0.0 for each in same]
    return np.stack([size, np.maximum(left, usual)], axis=1)


def rounding(readings: F64, digits: F64, independence: float) -> F64:
    """Variance (K, U) by which readings are off alike, each for all that are [m^2/s^4].

    Those of a time in which a reading stays within a digit are; and those within a digit at any
    other time, as far as a motion of few digits, which always comes back to the same values, can
    not tell one reading from the other.

    Args:
        readings: (K, U, 3) low-passed ones [m/s^2].
        digits: (U, 2) the SUs' digits, and what averages leave of them, rms [m/s^2].
        independence: independent measurements in one of the readings.
    """
    out = np.zeros(readings.shape[:2])
    for u in np.flatnonzero(digits[:, 1] > 0):
        digit, left = digits[u]
        x = readings[:, u]
        # Errors of motion over many digits, which meets each of them otherwise, average out.
        again = _come_back(x, digit) / np.maximum(np.ptp(x, axis=0) / digit, 1.0)
        together = np.maximum(_stay_within(x, digit), again) * independence
        # Once it is in what residuals show.
        out[:, u] = left**2 * (np.maximum(together, 1.0) - 1.0).mean(axis=1)
    return out


def _come_back(x: F64, size: float) -> F64:
    """(K, C) how many samples (K, C) lie within half a size of each one, itself among them."""
    out = np.empty(x.shape)
    for column, of_axis in zip(out.T, x.T, strict=True):
        ordered = np.sort(of_axis)
        column[:] = np.searchsorted(ordered, of_axis + size / 2, "right")
        column -= np.searchsorted(ordered, of_axis - size / 2)
    return out


def _stay_within(x: F64, size: float) -> F64:
    """(K, C) how many samples (K, C) around each one stay within a size, itself among them."""
    out, half = np.ones(x.shape), 1
    while 2 * half + 1 <= len(x):
        length = 2 * half + 1
        span = maximum_filter1d(x, length, axis=0, mode="nearest")
        span -= minimum_filter1d(x, length, axis=0, mode="nearest")
        stays = maximum_filter1d((span < size).astype(np.float64), length, axis=0, mode="nearest")
        if not stays.any():
            break
        out = np.maximum(out, stays * length)
        half = max(half + 1, int(_LONGER * half))
    return out
