"""What readings say for another chain before an SU: likelihoods, pushes and their prices."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.structure.accelerations import Along, Judged
from skin2urdf.structure.draft import Draft
from skin2urdf.structure.joint_types import HALF_A_PUSH

CERTAIN = 10.0
"""Difference of log-likelihoods beyond which one of two structures is certain: 20,000 to 1."""
CONSISTENT = 4.0
"""Standard deviations by which the gain of a joint stands out from what chance gains and loses from
one stretch of time to the next, and the push of a sliding one from none: errors that are alike for
a while count once."""
QUIET = 1e-3
"""Noise [m/s^2] of low-passed samples below which no error matters: a tenth of a mg."""
_QUIET_RATE = 1e-3
"""The same of rates [rad/s]: what an encoder's steps make of a velocity."""
_PUSH = 0.1
"""Deviation of a sliding joint's push from unit length that scale and errors of fit may cause."""
_NEAREST = 0.005
"""Lever arm [m] of an SU below which it is shaken rather than turned by a vertical axis: half of
the width of a sensor's case."""


def gained(now: Judged, then: Judged) -> F64:
    """(B,) log-likelihood that another chain gains in each stretch, whatever its noise is."""
    return _log_ratio(now.loss, then.loss, now.count, QUIET) + _gain_in_turning(now, then)


def _gain_in_turning(now: Judged, then: Judged) -> F64:
    """(B,) the part of it that a gyroscope tells; 0 where there is none."""
    return _log_ratio(now.turn_loss, then.turn_loss, now.turn_count, _QUIET_RATE)


def is_shaken(now: Judged, then: Judged) -> bool:
    """Whether a vertical axis before an SU shakes it rather than that it turns it.

    A gyroscope tells: one that reads no turning has no such error of its axes as would hide it.
    """
    if then.turn_count.any():
        return then.turn_left > now.turn_left
    return then.lever < _NEAREST


def is_push(push: F64, sd: F64) -> bool:
    """Whether most SUs feel a sliding joint as one that carries them, by (n, 3) and (n,)."""
    size = np.linalg.norm(push, axis=1)
    # SUs beyond a joint that is not known yet say something else; and a push has to be seen.
    as_one = bool(np.median(np.abs(size - 1) - 4 * sd) <= _PUSH)
    return as_one and bool(np.median(size - CONSISTENT * sd) > 0)


def unfelt_pushes(draft: Draft, samples: Along) -> float:
    """Negative log-likelihood of pushes of half a slide's length where SUs feel less.

    Each SU finds a push of its own, of length 1 where a slide carries it. One that sits before the
    slide finds next to none, and is predicted the better for it: what the slide's weight does to
    elastic gears before them both goes with its acceleration as well.
    """
    total = 0.0
    for judged in draft.all_judged(samples):
        if judged is not None:
            lacking = np.maximum(HALF_A_PUSH - np.linalg.norm(judged.slide, axis=1), 0.0)
            total += 0.5 * float((lacking**2 / judged.slide_sd**2).sum())
    return total


def is_gained_throughout(gains: F64, price: float) -> bool:
    """Whether log-likelihoods (B,) that stretches gain are more than chance, and one odd moment.

    Of what is explained by chance as much is lost elsewhere.

    Args:
        gains: (B,) of each stretch.
        price: what has to be gained beside the one that gains most.
    """
    gain = float(gains.sum())
    chance = float(np.sqrt(2 * (np.minimum(gains, 0.0) ** 2).sum()))
    elsewhere = gain - float(gains.max(initial=0.0))
    return gain >= CONSISTENT * chance and elsewhere >= price


def price_of(samples: Along, joints: int, segments: int) -> float:
    """What a joint has to gain to be put in.

    Half the logarithm of the samples for each parameter, and that of the places tried.
    """
    return 3 * float(np.log(max(len(samples.q), 2))) + float(np.log(3 * joints * segments))


def _log_ratio(now: F64, then: F64, count: F64, quiet: float) -> F64:
    """Log-likelihood gained by a smaller sum of squares over so many measurements."""
    floor = quiet**2 * count + 1e-12
    return np.asarray(count / 2 * np.log((now + floor) / (then + floor)))
