"""How well all samples around each pose are explained, SU by SU.

Features around poses know a rigid robot that follows its encoders, with sensors that are always
the same. Joints that yield, gears that are uneven and biases that drift leave much in them, more in
some SUs and poses than in others, and nothing in samples that are explained with these. Play and
slack are no more than sizes of what is left from place to place: there features count as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.estimation.trajectory.attempt import PLAY
from skin2urdf.estimation.trajectory.misfit import SPAN, part_means
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.uncertainty.goodness import Goodness, Share
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled


def judged_by_samples(
    fit: Goodness, along: MotionEstimate | None, features: Features, sampled: Sequence[Sampled]
) -> Goodness:
    """Goodness of fit with SUs and poses judged by the model that all samples are explained by.

    Args:
        fit: how well features are explained.
        along: the fit of all samples; None where features alone count.
        features: P poses, and when they were.
        sampled: the logs.

    Returns:
        The same of features where samples are not explained, or by slack that is of any shape.
    """
    if along is None or not along.misfit <= GOOD_FIT or {"slack", PLAY} & set(along.causes):
        return fit
    whole = samples_around_poses(along, features, sampled)
    # Of poses so short that filters reach beyond them, features tell alone.
    told = (whole.dof > 0).any(axis=1, keepdims=True)
    by_block = Share(
        np.where(told, whole.chi2, fit.by_block.chi2), np.where(told, whole.dof, fit.by_block.dof)
    )
    return replace(fit, by_block=by_block, of_features=not along.causes)


def samples_around_poses(
    along: MotionEstimate, features: Features, sampled: Sequence[Sampled]
) -> Share:
    """Chi-squared (P, U) of mean residuals over spans of time around each pose.

    Args:
        along: the fit of all samples of U SUs.
        features: P poses, and when they were.
        sampled: the logs.
    """
    problem, fitted = along.problem, along.fitted
    chi2, dof = np.zeros((2, features.n_poses, problem.tree.n_sus))
    # No other pose of a log has its span.
    windows = [{p.span(s.motion.grid): p.windows for p in s.neighbourhoods} for s in sampled]
    for pose, (g, span) in enumerate(zip(features.log.tolist(), features.span, strict=True)):
        log = problem.logs[g]
        for window in windows[g].get(tuple(span.tolist()), ()):
            begin, end = np.searchsorted(log.kept, window)
            if begin == end:
                continue
            n = max(1, int((log.time[end - 1] - log.time[begin]) / SPAN))
            means, variances = part_means(
                fitted.predicted[g], fitted.weights[g], slice(begin, end), n
            )
            known = np.isfinite(variances)
            square = means**2 / np.where(known, variances, 1.0)
            chi2[pose] += np.where(known, square, 0.0).sum(axis=(0, 2))
            dof[pose] += known.sum(axis=(0, 2))
    return Share(chi2, dof)
