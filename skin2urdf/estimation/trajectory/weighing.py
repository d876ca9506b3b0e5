"""With how much information each sample counts, from what is left of all of them.

Weights follow the residuals, and residuals the weights: both are found in turns. Where encoders
shake predictions by more than sensors shake readings, what is taken off for that says at long arms
that they are short, and at short ones that they are long, so that fits would swing to and fro for
ever. Between two weighings there is one at which they do not (Mann 1953).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.trajectory.gyro import rate_weights
from skin2urdf.estimation.trajectory.kinematics import levers
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.estimation.trajectory.shaken import Shaken, made_by_encoders
from skin2urdf.estimation.trajectory.state import MotionState

_HUBER = 3.0
"""Residual, in standard deviations, beyond which a sample counts less; noise is one in 400."""
_QUIET = 1e-5
"""Noise of a sample at least [m/s^2], 1 ug: no accelerometer has less, and simulated ones without
noise are fitted no worse for it."""


@dataclass(frozen=True, eq=False)
class Weighing:
    """What residuals show of the noise, and what samples count with because of it.

    Attributes:
        noise: per log (K, U, 3) standard deviation of each sample; with gyroscopes (K, U, 6),
            theirs last [m/s^2, rad/s].
        weights: per log, of the same shape, information that each sample counts with.
        shaken: what the noise of encoders makes of predictions, with these weights.
    """

    noise: tuple[F64, ...]
    weights: tuple[F64, ...]
    shaken: Shaken

    @staticmethod
    def of(problem: MotionProblem, state: MotionState, predicted: Sequence[Predicted]) -> Weighing:
        """Of all samples.

        Args:
            problem: the logs, the tree and what is known before.
            state: where.
            predicted: per log, residuals there.
        """
        noise, weights = _noise(problem, state, predicted)
        return Weighing(noise, weights, Shaken.of(problem.tree, problem.logs, state, weights))

    def towards(self, other: Weighing, share: float) -> Weighing:
        """A weighing on the way from this to another one.

        Args:
            other: of the same samples.
            share: of the way, from 0 to 1.
        """
        if share >= 1:
            return other
        return Weighing(
            _between(self.noise, other.noise, share),
            _between(self.weights, other.weights, share),
            self.shaken.towards(other.shaken, share),
        )

    def cost(
        self, problem: MotionProblem, state: MotionState, predicted: Sequence[Predicted]
    ) -> float:
        """Chi-squared with these weights, without what front ends gain by cutting noise off.

        Args:
            problem: the logs, the tree and what is known before.
            state: where.
            predicted: per log, residuals there.
        """
        data = self.shaken.cut_off(state.front)
        for w, p in zip(self.weights, predicted, strict=True):
            square = np.einsum("kuc,kuc,kuc->ku", w[..., :3], p.residual, p.residual)
            data += float(square[p.measured].sum())
            if p.turned is not None:
                data += float((w[..., 3:] * p.turned.residual**2).sum())
        return data + problem.prior_chi2(state)


def _between(one: Sequence[F64], other: Sequence[F64], share: float) -> tuple[F64, ...]:
    """Arrays between two, a share of the way; the other's where one has none to begin from."""
    out = []
    for a, b in zip(one, other, strict=True):
        known = np.isfinite(a) & np.isfinite(b)
        out.append(np.where(known, (1 - share) * np.where(known, a, 0.0) + share * b, b))
    return tuple(out)


def _noise(
    problem: MotionProblem, state: MotionState, predicted: Sequence[Predicted]
) -> tuple[tuple[F64, ...], tuple[F64, ...]]:
    """Noise of each sample and weights.

    It is what residuals of the SU show at rest and in motion, what encoders leave around a rest
    beside what the most of it shows, and what its sampling leaves open where a joint on its way
    leaps.
    """
    noise, weights = [], []
    arms = levers(problem.tree, state.placements)
    for log, p in zip(problem.logs, predicted, strict=True):
        # By SU, as all axes have the same; which views give to each.
        shape = p.residual.shape
        sd = np.full(shape[1::-1], np.inf).T
        around = made_by_encoders(problem.tree, log, state.placements)
        square = np.einsum("kuc,kuc->uk", p.residual, p.residual).T
        for joint in np.unique(problem.tree.su_joint).tolist():
            sus = np.flatnonzero(problem.tree.su_joint == joint)
            moves = log.moving[:, list(problem.tree.chain(joint))].any(axis=1)
            for which in (moves, ~moves):
                some = square.T[sus][:, which], p.measured.T[sus][:, which]
                sd[np.ix_(which, sus)] = _spreads(*some)
            if around is not None:
                still = np.ix_(~moves, sus)
                sd[still] = np.hypot(sd[still], np.sqrt(around[sus][:, ~moves]).T)
        if log.leaps is not None:
            sd = np.hypot(sd, np.sqrt(log.leaps.variance(arms)))
        size = np.where(p.measured, np.sqrt(square / 3) / sd, 0.0)
        share = _HUBER / np.maximum(size, _HUBER)
        w = np.where(p.measured, log.independence * share, 0.0) / sd**2
        w = np.where(np.isfinite(w), w, 0.0)
        noise.append(np.broadcast_to(sd[..., None], shape))
        weights.append(np.broadcast_to(w[..., None], shape))
    turned = [p.turned for p in predicted]
    if any(t is not None for t in turned):
        rates = rate_weights(problem.tree, problem.logs, problem.gyros, turned)
        noise = [np.concatenate(each, axis=2) for each in zip(noise, rates[0], strict=True)]
        weights = [np.concatenate(each, axis=2) for each in zip(weights, rates[1], strict=True)]
    return tuple(noise), tuple(weights)


def _spreads(square: F64, measured: Bool) -> F64:
    """(S,) standard deviations of residuals of squares (S, K), all axes together.

    They are those of their medians, which outliers do not move.

    Args:
        square: sums over the axes of an SU.
        measured: (S, K) which count.
    """
    out, count = np.full(len(square), np.inf), measured.sum(axis=1)
    enough = count >= 8
    whole = enough & (count == square.shape[1])
    if whole.any():
        out[whole] = np.median(square[whole], axis=1)
    for s in np.flatnonzero(enough & ~whole).tolist():
        out[s] = np.median(square[s, measured[s]])
    # The median of chi-squared with three degrees of freedom is 2.366.
    return np.maximum(np.sqrt(out / 2.366), _QUIET)
