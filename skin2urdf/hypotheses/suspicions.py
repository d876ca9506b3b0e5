"""Which encoder is wrong, and how: hypotheses for the score test."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.geometry.so3 import skew
from skin2urdf.hypotheses.encoder_score import encoder_scores
from skin2urdf.signals.records import EncoderError, Features

_LARGEST_SCALE = 2.0
"""Factor by which one step may correct a scale; the next estimate goes on from there."""

_GROSS = 0.25
"""Logarithm of a scale that slopes, noisy as they are, tell from 1."""
_CHANCE = 1e-3
"""Probability that chance alone makes slopes look like those of an axis, or like another scale; a
scale that is suspected in vain costs one more estimate."""


@dataclass(frozen=True)
class Suspicion:
    """An encoder error that would explain much of what the fit leaves.

    Attributes:
        error: the error.
        gain: chi-squared that it takes off.
    """

    error: EncoderError
    gain: float


def suspicions(found: Estimate, features: Features) -> tuple[Suspicion, ...]:
    """Errors of single encoders, those with the largest gain first.

    Args:
        found: the estimate; its blocks list the poses of
        features: the features.
    """
    if not found.tree.n_joints:
        return ()
    scores = encoder_scores(found)
    errors: list[EncoderError] = []
    results = []
    for joint in range(found.tree.n_joints):
        own, directions = zip(*_hypotheses(found, features, joint), strict=True)
        errors += own
        results.append(scores.test(joint, np.array(directions)))
    gain, size, deviation = (np.concatenate(part) for part in zip(*results, strict=True))
    return tuple(
        Suspicion(_sized(errors[i], float(size[i]), float(deviation[i])), float(gain[i]))
        for i in np.argsort(-gain)
    )


def gross_scales(found: Estimate) -> tuple[EncoderError, ...]:
    """Scales far from 1, from the slopes alone: no estimate of the robot is needed.

    In the frame of an SU, the axis w of the joint it sits on is the same in every pose, so that
    ``s = f0 x w`` is linear in w, whose length is 1 where the encoder reports radians.

    Args:
        found: an estimate, however bad; its tree and its blocks count.
    """
    tree, blocks = found.tree, found.cost.blocks
    out = []
    for j, name in enumerate(tree.joint_names):
        scales = []
        for u in np.flatnonzero((tree.su_joint == j) & ~tree.prismatic[tree.su_joint]):
            row = int(blocks.chains.length[u])
            known = np.isfinite(blocks.variance[:, u, row])
            if known.sum() < 2:
                continue
            f0, s = blocks.coefficients[known, u, 0], blocks.coefficients[known, u, row]
            weight = blocks.variance[known, u, row, None] ** -0.5
            A, y = (skew(f0) * weight[..., None]).reshape(-1, 3), (s * weight).ravel()
            w, *_ = np.linalg.lstsq(A, y, rcond=None)
            size = max(float(np.linalg.norm(w)), 1e-6)
            left, of_one, whole = (float(((y - A @ v) ** 2).sum()) for v in (w, w / size, 0 * w))
            # An SU that slips, or that is another's, has no constant axis of any length.
            is_axis = _explained(whole - left, 3, left, len(y) - 3)
            other = _explained(of_one - left, 1, left, len(y) - 3)
            scales.append(1 / size if is_axis and other else 1.0)
        middle = float(np.median(scales)) if scales else 1.0
        if abs(np.log(middle)) > _GROSS:
            out.append(EncoderError("scale", name, middle))
    return tuple(out)


def _explained(gain: float, parameters: int, left: float, freedom: int) -> bool:
    """Whether parameters explain more of a misfit than chance does, by Fisher's F test."""
    return bool(fdtrc(parameters, freedom, gain / parameters * freedom / left) < _CHANCE)


def _sized(error: EncoderError, size: float, deviation: float) -> EncoderError:
    if error.kind == "scale":
        size = float(np.clip(1 + size, 1 / _LARGEST_SCALE, _LARGEST_SCALE))
    return replace(error, size=size, deviation=deviation)


def _hypotheses(
    found: Estimate, features: Features, joint: int
) -> Iterator[tuple[EncoderError, F64]]:
    """Errors of unknown size of one encoder, with their directions (P + 1,) in the score test.

    An encoder reports too much by x from a change between two poses on, or in a whole log but the
    first; or it reports 1 + x times the true motion, so that the true coefficients are as much
    larger than those measured.
    """
    name, q = found.tree.joint_names[joint], found.cost.blocks.q[:, joint]
    yield EncoderError("scale", name, 1.0), np.append(-q, -1.0)
    for log in range(found.cost.n_logs):
        for begin, spread, later in _changes(features, log):
            offset = np.zeros(len(q) + 1)
            offset[later] = -1.0
            yield EncoderError("offset", name, 0.0, log, begin, spread=spread), offset


def _changes(features: Features, log: int) -> Iterator[tuple[float, float, Int]]:
    """Times at which an offset may begin in a log, how far off they may be, and later poses."""
    poses = np.flatnonzero(features.log == log)
    poses = poses[np.argsort(features.span[poses].mean(axis=1), kind="stable")]
    if log > 0:
        yield -np.inf, 0.0, poses
    for k in range(1, len(poses)):
        before, after = features.span[poses[k - 1]], features.span[poses[k]]
        apart = before[1] <= after[0]
        begin = (before[1] + after[0]) / 2 if apart else (before.mean() + after.mean()) / 2
        # Where poses are visited in turns, the moves between them are many.
        yield float(begin), float(max(0.0, after[0] - before[1]) / 2), poses[k:]
