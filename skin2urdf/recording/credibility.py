"""Which readings no accelerometer gave: absurd values, spikes, several sensors under one name."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.recording.numbering import median_of

# Accelerometers that robots carry end at 16 to 50 g; more than this is damage [m/s^2].
LARGEST_FORCE = 500.0
LARGEST_IN_ANY_UNIT = 1e6
# Gyroscopes that robots carry end at 4,000 deg/s, which some drivers send as such [rad/s, deg/s].
LARGEST_RATE = 5000.0
# Drives of robots end at some 10 kN m; more than this is damage in any unit [N m or N, mA].
LARGEST_EFFORT = 1e6
# A spike departs from its neighbours by so many times what samples usually do. The distance of
# Gaussian noise comes to five times its median once in 1e9 samples; shocks come to more, but last.
_FAR = 10.0
# What the samples next to a spike may differ among themselves, over the size of the spike.
_RETURNED = 0.25
_AROUND = 10

# Publishers of one name are looked for up to half as many as this.
_LAGS = 16
_STARTS = 512
# Samples of one sensor come as close to another of the next K, over the one next to them, as the
# smallest of K distances in C dimensions, K^(-1 / C); with a margin of three.
_CLOSE = 0.3
# Accelerometers that differ by less (3 deg of their tilt) are not told from one that vibrates
# [m/s^2], encoders not from one of 10 bits between two digits [rad or m].
FORCES_APART = 0.5
POSITIONS_APART = 6e-3
# What accelerometers of several publishers read is as long as gravity, but for their errors (biases
# of 60 mg, scales of 3 %) and what the robot accelerates them by; what shakes one of them changes
# the length as well as the direction. Their deviation, over their median.
_LENGTHS_APART = 0.1


def absurd(force: F64) -> Bool:
    """(N,) True for readings (N, 3) that are not finite, or larger than any sensor's range.

    Where most are larger, it is their unit that is odd, for others to say; none is marked then
    but those that no unit explains.
    """
    # By columns, as NumPy reduces short rows one by one.
    size = np.maximum.reduce([np.abs(column) for column in force.T])
    bad = ~(size < LARGEST_FORCE)
    if 2 * np.count_nonzero(bad & np.isfinite(size)) > np.count_nonzero(np.isfinite(size)):
        bad = ~(size < LARGEST_IN_ANY_UNIT)
    return np.asarray(bad)


def real_rates(rates: F64) -> F64 | None:
    """Angular velocities (N, 3) that a gyroscope can have given, NaN in place of the others.

    Many drivers fill in zeros or what else never changes where there is no gyroscope.

    Returns:
        None where an axis never changes, or where there are no two readings.
    """
    bad = ~(np.maximum.reduce([np.abs(column) for column in rates.T]) < LARGEST_RATE)
    if bad.any():
        rates = np.where(bad[:, None], np.nan, rates)
    sound = rates[~bad] if bad.any() else rates
    if len(sound) < 2 or not (sound != sound[0]).any(axis=0).all():
        return None
    return rates


def real_efforts(effort: F64) -> F64 | None:
    """Efforts (N,) of a joint that a sensor can have given, NaN in place of the others.

    Many drivers fill in zeros, NaN or a command that never changes where nothing is measured.

    Returns:
        None where it never changes.
    """
    sound = np.abs(effort) < LARGEST_EFFORT
    there = effort[sound]
    if not (there.size and np.any(there != there[0])):
        return None
    return effort if sound.all() else np.where(sound, effort, np.nan)


def digit_of(steps: F64) -> float:
    """Size of the smallest step that is one: a digit of a sensor that has digits; 0 without any.

    Args:
        steps: (N, C) from samples to later ones, in the samples' unit.
    """
    sizes = np.abs(steps)
    return float(sizes.min(initial=np.inf, where=sizes > 0)) if sizes.any() else 0.0


def spikes(values: F64) -> Bool:
    """(N,) True for single samples that depart far from those around them, which agree.

    Args:
        values: (N, C) samples in the order of their times.
    """
    found = np.zeros(len(values), dtype=bool)
    if len(values) < 2 * _AROUND:
        return found
    bend = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    kink = np.sqrt(np.einsum("nc,nc->n", bend, bend))
    digit = digit_of(np.diff(values[:: len(values) // 4096 | 1], axis=0))
    usual = max(median_of(kink), digit)
    # A second spike two samples further halves the kink of the first.
    suspects = np.flatnonzero(kink > 0.5 * _FAR * usual) + 1
    if not suspects.size or usual == 0.0:
        return found
    last = len(values) - 1
    reach = np.arange(-3, 4)
    nearby = values[np.clip(suspects[:, None] + reach, 0, last)]
    # Around one, samples go on as the robot turns, by the same from each to the next.
    slope = np.median(np.diff(nearby, axis=1), axis=1)
    nearby = nearby - slope[:, None] * reach[:, None]
    middle = np.median(nearby, axis=1)
    off = np.linalg.norm(nearby - middle[:, None], axis=2)
    around = np.clip(suspects[:, None] - 1 + np.arange(-_AROUND, _AROUND + 1), 0, kink.size - 1)
    local = np.maximum(np.median(kink[around], axis=1), usual)
    # Those next to it agree with the middle, and all but one of the others, a second spike.
    others = np.sort(off[:, [0, 1, 2, 4, 5, 6]], axis=1)[:, -2]
    returns = np.maximum(others, np.maximum(off[:, 2], off[:, 4])) < _RETURNED * off[:, 3]
    found[suspects[(off[:, 3] > _FAR * local) & returns]] = True
    return found


def several_publishers(values: F64, least: float, *, of_forces: bool) -> bool:
    """Whether samples (N, C) of one name come from several sensors in turn.

    A sensor's next sample is the one most like the last. Where those of several are mixed, the next
    is another's, and the one like the last comes some samples later. So it does where what shakes a
    sensor is slower after sampling than it was, which accelerometers show by the lengths of what
    they read.

    Args:
        values: the samples in the order of their arrival.
        least: distance of samples in a row that one sensor may have.
        of_forces: whether they are what accelerometers read (C = 3), not positions of joints.
    """
    count, channels = values.shape
    if count < 4 * _LAGS:
        return False
    start = np.arange(0, count - _LAGS, (count - _LAGS) // _STARTS | 1)
    # Mostly samples in a row are close, which is seen at once.
    steps = values[start + 1] - values[start]
    near = np.sqrt(np.einsum("nc,nc->n", steps, steps))
    if np.isfinite(values).all() and not median_of(near) > least:
        return False
    apart = values[start[None] + np.arange(1, _LAGS + 1)[:, None]] - values[start]
    distance = np.sqrt(np.einsum("lnc,lnc->ln", apart, apart))
    whole = np.isfinite(distance).all(axis=0)
    if not whole.any():
        return False
    following = float(np.median(distance[0, whole]))
    closest = float(np.median(distance[1:, whole].min(axis=0)))
    like = _CLOSE * (_LAGS - 1) ** (-1 / channels)
    if not (following > least and closest < like * following):
        return False
    if not of_forces:
        return True
    differ = start[whole & (distance[0] > least)]
    lengths = np.linalg.norm(values[differ[:, None] + np.arange(_LAGS + 1)], axis=2)
    return bool(np.median(lengths.std(axis=1)) < _LENGTHS_APART * np.median(lengths))
