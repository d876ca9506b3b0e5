"""By how much later an SU on the base was read than all others.

On a base that stands still an SU reads gravity, whatever its clock says. Where the base moves all
others feel that as well, each by shares that its place on the robot makes: what they lack goes with
what was felt on the base at one lag of that SU's clock, and less so at any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.fit import Fitted, held
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import CERTAIN
from skin2urdf.model.poses import su_poses
from skin2urdf.signals.filters import Spline
from skin2urdf.signals.trajectory import Trajectory

_LONGEST, _STEP = 0.15, 0.01
"""Lags that are compared, and from one to the next [s]: what a base does at 7 Hz, faster than any
log is compared at, goes through a fifteenth of its swing in between."""
_DEVIATIONS = 3.0
"""Standard deviations of what chi-squared scatters by that chance does not make of any lag."""


def read_with_others(
    problem: MotionProblem, fitted: Fitted, asked: Int
) -> tuple[MotionProblem, Fitted]:
    """What was fitted, with SUs on the base read when all others were.

    Args:
        problem: the logs, of a robot on a base that stands still.
        fitted: its fit.
        asked: (B,) SUs on the base.

    Returns:
        What was given where none of them was read later for certain.
    """
    later = read_later(problem, fitted, asked)
    if not later.any():
        return problem, fitted
    logs = [_sooner(log, asked, by) for log, by in zip(problem.logs, later, strict=True)]
    clock = np.array(fitted.state.clock)
    clock[:, asked] = 0.0
    there = problem.again(logs=logs)
    return there, held(there, replace(fitted.state, clock=clock))


def read_later(problem: MotionProblem, fitted: Fitted, asked: Int) -> F64:
    """(G, B) by how much later SUs on the base were read than the others, log by log [s].

    For each lag every other SU's residuals, in the base's frame, are regressed on what was felt on
    the base: the sum of what chi-squared falls by is largest where they were read at once. Lags
    that say no more than chance makes of none, or of which the longest says most, are none.

    Args:
        problem: the logs, of a robot on a base that stands still.
        fitted: its fit.
        asked: (B,) SUs on the base.
    """
    tree = problem.tree
    others = np.setdiff1d(np.arange(tree.n_sus), asked)
    model = fitted.state.placements.model(tree)
    out = np.zeros((len(problem.logs), len(asked)))
    n = round(_LONGEST / _STEP)
    lags = np.asarray(_STEP * np.arange(-n, n + 1), dtype=np.float64)
    for g, (log, p, w) in enumerate(
        zip(problem.logs, fitted.predicted, fitted.weights, strict=True)
    ):
        turned = su_poses(model, log.q[log.kept])[:, others, :3, :3]
        left = np.where(p.measured[..., None], p.residual, 0.0)[:, others]
        left = np.einsum("kuij,kuj->kui", turned, left)
        weight = np.where(p.measured, w[..., 0], 0.0)[:, others]
        for b, u in enumerate(asked):
            felt = Spline(_beside_its_mean(log.readings[:, u]))
            gains = [_fall(_at(felt, log, lag), left, weight) for lag in lags]
            # Chi-squared of so many numbers scatters by twice the root of them from lag to lag.
            n_numbers = 9 * int((weight > 0).any(axis=0).sum())
            chance = 2 * CERTAIN + _DEVIATIONS * 2 * np.sqrt(n_numbers)
            out[g, b] = _peak(lags, np.array(gains, dtype=np.float64), chance)
    return out


def _peak(lags: F64, gains: F64, chance: float) -> float:
    """The lag of the largest gain, between those compared; 0 where chance makes as much."""
    best = int(np.argmax(gains))
    none = len(lags) // 2
    if best in (0, len(lags) - 1) or gains[best] - gains[none] < chance:
        return 0.0
    before, here, behind = gains[best - 1 : best + 2]
    return float(lags[best] + 0.5 * _STEP * (before - behind) / (before - 2 * here + behind))


def _fall(felt: F64, left: F64, weight: F64) -> float:
    """By how much chi-squared falls with shares of what is felt in what is left of each SU.

    Args:
        felt: (K, 3) on the base.
        left: (K, U, 3) residuals in the base's frame.
        weight: (K, U) their information; 0 where nothing is measured.
    """
    together = np.einsum("ki,ku,kuj->uij", felt, weight, left, optimize=True)
    alone = np.einsum("ki,ku,kj->uij", felt, weight, felt, optimize=True)
    inverse = np.linalg.pinv(alone, hermitian=True)
    return float(np.einsum("uij,uik,ukj->", together, inverse, together))


def _at(felt: Spline, log: Trajectory, lag: float) -> F64:
    """(K, 3) what was felt a lag after the samples that are compared."""
    return felt.within((log.kept + lag * log.rate).clip(0, len(log.q) - 1))


def _beside_its_mean(x: F64) -> F64:
    """Samples (N, C) less their mean, 0 where they are missing."""
    return np.asarray(np.nan_to_num(x - np.nanmean(x, axis=0)))


def _sooner(log: Trajectory, sus: Int, by: Sequence[float] | F64) -> Trajectory:
    """A log whose SUs on the base were read by such times (B,) sooner [s]."""
    out = {"readings": np.array(log.readings)}
    if log.rates is not None:
        out["rates"] = np.array(log.rates)
    at = np.arange(len(log.q))
    for values in out.values():
        for u, lag in zip(sus, by, strict=True):
            mean = np.nanmean(values[:, u], axis=0)
            spline = Spline(_beside_its_mean(values[:, u]))
            values[:, u] = mean + spline.within((at + lag * log.rate).clip(0, len(at) - 1))
    return replace(log, readings=out["readings"], rates=out.get("rates"))
