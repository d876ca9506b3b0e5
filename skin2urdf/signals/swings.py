"""What joints do around the poses of a log: regressors, low-passed, and what encoders hide in them.

None of it depends on readings, nor on when these were taken. Features are taken again and again,
as latencies and what lies beyond first order become known; this is worked out once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.signals.encoder_noise import EncoderNoise
from skin2urdf.signals.filters import filtered, low_pass, noise_bandwidth
from skin2urdf.signals.motion import Motion
from skin2urdf.signals.poses import Neighbourhood
from skin2urdf.signals.regression import excited, regressors
from skin2urdf.signals.rounding import (
    hidden_motion,
    pattern_products,
    regressor_noise,
    rest_pull,
    tones,
    white_noise,
)

_RATE_OVER_CUTOFF = 3.0
"""Samples kept per second over the cutoff: the low-pass ends at 1.4 times its cutoff, aliases
appear below 2.8."""
_STILL = 20.0
"""Encoder steps per second below which rounding does not average out [1/s]."""


@dataclass(frozen=True, eq=False)
class Swing(Record):
    """What joints do around one pose, of N grid samples with the reach of the low-pass.

    Attributes:
        spans: (N,) the grid samples, window after window.
        dq: (N, D) positions relative to the pose [rad or m], and their derivatives
        qd: (N, D) and
        qdd: (N, D).
        X: (N, 1 + 2 D) regressors of the features, and
        low_passed: (K, 1 + 2 D) the same low-passed, at the samples that are kept.
        nuisances: (K, k) regressors of what is not wanted, alike.
        encoders: what is known of the encoders' noise.
    """

    spans: Int
    dq: F64
    qd: F64
    qdd: F64
    X: F64
    low_passed: F64
    nuisances: F64
    encoders: EncoderNoise


@dataclass(frozen=True, eq=False)
class Swings:
    """What joints do around the poses of a log.

    Attributes:
        motion: of the joints.
        neighbourhoods: the poses and their windows.
        cutoff: of the low-pass [Hz].
    """

    motion: Motion
    neighbourhoods: tuple[Neighbourhood, ...]
    cutoff: float

    @cached_property
    def taps(self) -> F64:
        """The low-pass."""
        return low_pass(self.cutoff, self.motion.grid.rate)

    @cached_property
    def every(self) -> int:
        """Grid samples from one that is kept to the next: what the low-pass leaves needs few."""
        return max(1, int(self.motion.grid.rate / (_RATE_OVER_CUTOFF * self.cutoff)))

    @cached_property
    def independence(self) -> float:
        """Independent measurements in one kept sample."""
        rate = self.motion.grid.rate
        return min(1.0, 2 * noise_bandwidth(self.taps, rate) * self.every / rate)

    @cached_property
    def noise(self) -> tuple[F64, F64]:
        """Noise of the regressors (n,), and of position with acceleration (D,), of the encoders."""
        return regressor_noise(self.motion, self.cutoff)

    @cached_property
    def with_nuisances(self) -> tuple[Swing, ...]:
        """With regressors of what lies beyond first order, where nothing predicts it."""
        return tuple(self._around(pose, linear=False) for pose in self.neighbourhoods)

    @cached_property
    def linear(self) -> tuple[Swing, ...]:
        """Of readings from which that is taken off."""
        return tuple(self._around(pose, linear=True) for pose in self.neighbourhoods)

    def pieces(self, pose: Neighbourhood) -> list[tuple[int, int]]:
        """The windows of a pose widened by the filter's reach, inside the grid."""
        half, size = len(self.taps) // 2, self.motion.grid.size
        return [(max(0, a - half), min(size, b + half)) for a, b in pose.windows]

    def kept(self, values: F64, pose: Neighbourhood) -> F64:
        """(K, ..) of values (N, ..) around a pose, low-passed, those that are kept."""
        out, at = [], 0
        for (a, b), (lo, hi) in zip(pose.windows, self.pieces(pose), strict=True):
            smooth = filtered(values[at : at + hi - lo], self.taps)
            out.append(smooth[a - lo : b - lo : self.every])
            at += hi - lo
        return np.concatenate(out)

    def _around(self, pose: Neighbourhood, *, linear: bool) -> Swing:
        motion, rate, every = self.motion, self.motion.grid.rate, self.every
        spans = np.concatenate([np.arange(lo, hi) for lo, hi in self.pieces(pose)])
        dq = motion.q[spans] - pose.q
        qd, qdd = motion.qd[spans], motion.qdd[spans]
        X, Z = regressors(dq, qd, qdd, linear)
        smooth = self.kept(np.concatenate([X, Z], axis=1), pose)
        low_passed, nuisances = np.split(smooth, [X.shape[1]], axis=1)
        position, acceleration = np.split(low_passed[:, 1:], 2, axis=1)
        moves = np.abs(motion.qd) >= _STILL * motion.resolution
        own = np.concatenate([np.arange(a, b) for a, b in pose.windows])
        moving = np.concatenate([moves[a:b:every] for a, b in pose.windows])
        squares = tones(acceleration, rate / every, self.cutoff)
        hidden, omega2 = hidden_motion(position, acceleration, motion.resolution)
        variance = motion.noise**2 / motion.raw_rate * self.independence * rate / every
        encoders = EncoderNoise(
            position_sd=np.where(motion.named, (~moves[own]).mean(axis=0) * motion.noise, np.inf),
            pull=rest_pull(excited(low_passed, self.noise[0]), moving),
            hidden=hidden,
            omega2=omega2,
            tones=squares,
            products=self.independence
            * pattern_products(position, acceleration * (squares[:, 0] > 0)),
            white=white_noise(acceleration, moving, variance),
        )
        return Swing(spans, dq, qd, qdd, X, low_passed, nuisances, encoders)
