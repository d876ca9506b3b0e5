"""How much of what a fit leaves is slow: noise averages out over a span of time, errors do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Predicted
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.threads import MANY

SPAN = 2.0
"""Length of the spans of time whose errors count as independent [s]: far longer than the low-pass,
and than a pattern's period."""
_ROUNDS = 20
"""Times weights are taken again; after ten nothing changes by a hundredth."""
MOST_OF_IT = 0.5
"""Part of a misfit, above the 1 of noise, or of slack's gain, that may stay where a cause is added,
and after a first look at one that is to be followed further. Links that bend leave 0.24 as elastic
joints, with which positions are four times better; a base that gives way 0.37 as a drift of biases,
so that causes are held against each other before one is taken."""


def span_edges(log: Trajectory, seconds: float) -> Int:
    """(n + 1,) first sample of each of the n spans of a log, and the number of samples.

    Args:
        log: the trajectory, whose kept samples count.
        seconds: length of a span [s].
    """
    n = max(1, int((log.time[-1] - log.time[0]) / seconds))
    return np.linspace(0, len(log.kept), n + 1).astype(np.int64)


def span_means(
    problem: MotionProblem,
    predicted: Sequence[Predicted],
    weights: Sequence[F64],
    seconds: float,
) -> tuple[F64, F64]:
    """Mean residuals over spans of time, and their variances if residuals are noise.

    Args:
        problem: what was fitted.
        predicted: residuals of each log.
        weights: per log (K, U, 3) information of each sample [s^4/m^2].
        seconds: length of a span [s].

    Returns:
        (S, U, 3) means [m/s^2], and (S, U, 3) variances; infinite where nothing was measured.
    """
    means, variances = [], []
    for log, p, w in zip(problem.logs, predicted, weights, strict=True):
        n = len(span_edges(log, seconds)) - 1
        mean, variance = part_means(p, w, slice(0, len(log.kept)), n)
        means.append(mean)
        variances.append(variance)
    return np.concatenate(means), np.concatenate(variances)


def part_means(predicted: Predicted, weights: F64, within: slice, n: int) -> tuple[F64, F64]:
    """Mean residuals over n parts of a time, and their variances if residuals are noise.

    Args:
        predicted: residuals of a log.
        weights: (K, U, 3) information of each of its samples [s^4/m^2].
        within: its samples of that time, at least n.
        n: number of parts.

    Returns:
        (n, U, 3) means [m/s^2], and (n, U, 3) variances; infinite where nothing was measured.
    """
    w = weights[within, :, :3]
    first = np.linspace(0, len(w), n + 1).astype(int)[:-1]
    total = np.add.reduceat(w, first, axis=0)
    known = total > 0
    moment = np.empty_like(total)
    # Of very many SUs not all at a time, as products are as large as the residuals.
    for u in range(0, w.shape[1], MANY):
        sus = slice(u, u + MANY)
        measured = predicted.measured[within, sus, None]
        r = np.where(measured, predicted.residual[within, sus], 0.0)
        moment[:, sus] = np.add.reduceat(w[:, sus] * r, first, axis=0)
    means = np.divide(moment, total, out=np.zeros_like(total), where=known)
    return means, np.divide(1.0, total, out=np.full_like(total, np.inf), where=known)


def variance_beyond(means: F64, variances: F64) -> float:
    """What means over spans vary by beyond noise, in the mean of all spans and SUs [m^2/s^4].

    Those with much noise hide what those with little show: each counts by how well it shows a
    variance as large as that, which makes them most likely.

    Args:
        means: mean residuals over spans, and
        variances: their variances, see :func:`span_means`.
    """
    known = np.isfinite(variances)
    square, noise = means[known] ** 2, variances[known]
    beyond = 0.0
    for _ in range(_ROUNDS):
        weights = 1 / np.maximum(noise + beyond, 1e-300) ** 2
        beyond = max(float(np.average(square - noise, weights=weights)), 0.0)
    return beyond


def misfit_of_sus(means: F64, variances: F64) -> F64:
    """(U,) the same of each SU; NaN for one without samples."""
    known = np.isfinite(variances)
    square = np.where(known, means**2 / np.where(known, variances, 1.0), 0.0)
    count = known.sum(axis=(0, 2))
    return np.where(count > 0, square.sum(axis=(0, 2)) / np.maximum(count, 1), np.nan)


def misfit_of_links(means: F64, variances: F64, su_joint: Int) -> float:
    """The misfit that may be due to what links do, and not to single SUs.

    Over spans of time a link that is elsewhere than its encoders say is tilted against gravity,
    which all SUs on it feel alike: what one of them does not show, none has from its link.

    Args:
        means: mean residuals over spans, and
        variances: their variances, see :func:`span_means`.
        su_joint: (U,) joint that carries each SU, -1 for none.
    """
    known = np.isfinite(variances)
    count = known.sum(axis=(0, 2))
    power = np.where(known, means**2, 0.0).sum(axis=(0, 2)) / np.maximum(count, 1)
    each = np.nan_to_num(misfit_of_sus(means, variances))
    for joint in np.unique(su_joint):
        on_it = np.flatnonzero((su_joint == joint) & (count > 0) & (power > 0))
        if len(on_it):
            each[on_it] *= power[on_it].min() / power[on_it]
    return float((count * each).sum() / max(1, count.sum()))


def misfit(means: F64, variances: F64) -> float:
    """Mean squares of span means over their variances.

    1 for white noise, less where noise is of high frequencies, as that of encoders; far above 1
    where the model lacks something.
    """
    known = np.isfinite(variances)
    return float((means[known] ** 2 / variances[known]).mean()) if known.any() else 0.0


def misfit_of(problem: MotionProblem, fitted: Fitted, seconds: float) -> float:
    """Squares of mean residuals over spans of so many seconds, over what noise makes of them."""
    return misfit(*span_means(problem, fitted.predicted, fitted.weights, seconds))
