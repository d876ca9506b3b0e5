"""Joints that count the other way in another log than in the first.

In one log the sense of a joint is a convention: axis and joint turn the other way together. Between
logs it is a contradiction: what the first log says of the robot predicts the others, with the
sense of every joint as it is, or turned.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.estimation.blocks import feature_blocks
from skin2urdf.estimation.cost import Cost
from skin2urdf.estimation.estimate import Estimate
from skin2urdf.signals.records import EncoderError, Features

_HALF = 0.5
"""Chi-squared with one more joint turned, over that without, from which it is followed."""
_TENTH = 0.1
"""Chi-squared with all joints turned, over that with none, from which they are believed."""


def reversed_encoders(first: Estimate, features: Features) -> Iterator[EncoderError]:
    """Encoders that count the other way in later logs.

    Args:
        first: an estimate from the first log alone.
        features: of all logs.
    """
    for log in np.unique(features.log[features.log > 0]):
        here = _poses(features, features.log == log)
        turned: list[str] = []
        before = now = _misfit(first, here)
        for _ in first.tree.joint_names:
            left = [n for n in first.tree.joint_names if n not in turned]
            trials = [_misfit(first, _turned(here, [*turned, name])) for name in left]
            best = int(np.argmin(trials))
            if trials[best] > _HALF * now:
                break
            now = trials[best]
            turned.append(left[best])
            if len(turned) == len(first.tree.joint_names):
                break
        if now < _TENTH * before:
            yield from (EncoderError("sign", name, -1.0, int(log)) for name in turned)


def _poses(features: Features, chosen: Bool) -> Features:
    """The features of some poses, as of a first log."""
    by_pose = ("q", "coefficients", "noise", "position_sd", "hidden", "omega2", "span")
    parts = {name: getattr(features, name)[chosen] for name in by_pose}
    information = features.information.of_poses(chosen)
    log = np.zeros(int(chosen.sum()), dtype=np.int64)
    return replace(features, log=log, information=information, **parts)


def _turned(features: Features, names: list[str]) -> Features:
    """Features as they are where some joints count the other way."""
    D = features.n_dofs
    sign = np.ones(D)
    sign[[features.dof_names.index(name) for name in names]] = -1.0
    rows = np.concatenate([[1.0], sign, sign])
    return replace(
        features,
        q=features.q * sign,
        coefficients=features.coefficients * rows[:, None],
        information=features.information.scaled(rows),
    )


def _misfit(first: Estimate, features: Features) -> float:
    """Chi-squared of poses under another log's estimate, gravity taken from the readings."""
    cost = Cost(first.tree, feature_blocks(features, first.tree), first.cost.priors)
    state = replace(first.state, up=first.state.up[:1])
    kin = cost.at(state).kin
    sensed = cost.blocks.coefficients[:, :, 0] - state.bias
    true = np.linalg.solve(state.sensor_matrix(), sensed[..., None])
    seen = (cost.blocks.count > 0)[..., None]
    up = ((kin.R @ true)[..., 0] * seen).sum(axis=(0, 1))
    size = float(np.linalg.norm(up))
    if size < 1e-9:
        return np.inf
    return float(cost.at(replace(state, up=(up / size)[None])).chi2_by_block().sum())
