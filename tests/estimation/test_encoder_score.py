"""The score test of encoders: exact derivatives, sizes and significance of their errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import GRAVITY, random_cost, random_features, random_state, random_tree, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.cost import Cost, Priors
from skin2urdf.estimation.encoder_score import encoder_scores
from skin2urdf.estimation.estimate import Estimate, EstimationSettings, estimate
from skin2urdf.signals.records import Features

SETTINGS = EstimationSettings(Priors(gravity=GRAVITY), robust=False)


def test_the_encoder_jacobian_is_that_of_differences() -> None:
    rng = np.random.default_rng(4)
    tree = random_tree(rng, 5, 6, prismatic=0.4)
    assert tree.prismatic.any()
    state = random_state(rng, tree, n_logs=2)
    cost = random_cost(rng, tree, state, 4, noise=0.05)
    K = cost.at(state).encoder_jacobian()
    P, U, rows, _ = K.shape
    L = cost.blocks.chains.joint.shape[1]
    h = 1e-6

    def residuals(q: F64) -> F64:
        moved = Cost(tree, replace(cost.blocks, q=q), cost.priors)
        return moved.at(state).residual.reshape(P, U, rows)

    for p in range(P):
        for d in range(tree.n_joints):
            e = np.zeros_like(cost.blocks.q)
            e[p, d] = h
            change = (residuals(cost.blocks.q + e) - residuals(cost.blocks.q - e)) / (2 * h)
            for u in range(U):
                own = list(cost.blocks.chains.joint[u, : cost.blocks.chains.length[u]])
                expected = K[p, u, :, own.index(d)] if d in own else np.zeros(rows)
                assert change[p, u] == pytest.approx(expected, rel=1e-5, abs=1e-4 * abs(K).max())
    grown = np.array(cost.at(state).whole.Y)
    grown[:, :, 0] = 0.0
    exact = cost.blocks.W @ (grown @ cost.at(state).whole.GT)
    assert K[..., L:].sum(axis=-1) == pytest.approx(exact.reshape(P, U, rows))


def chain(noise: float, seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    tree = serial_tree(4)
    return random_features(rng, tree, random_state(rng, tree, intrinsics=0.3), 10, noise, False)


def fitted(features: Features) -> Estimate:
    return estimate(features, serial_tree(4), SETTINGS)


def offset_from(pose: int, joint: int) -> F64:
    h = np.zeros((11, 4))
    h[pose:10, joint] = -1.0
    return h.reshape(1, -1)


def test_the_size_of_a_small_error_is_found_in_one_step() -> None:
    features = chain(0.05)
    q = np.array(features.q)
    q[6:, 2] += 0.01
    found = fitted(replace(features, q=q))
    gain, size, deviation = encoder_scores(found).test(offset_from(6, 2))
    assert size[0] == pytest.approx(0.01, abs=5 * deviation[0] + 2e-4)
    assert gain[0] == pytest.approx((size[0] / deviation[0]) ** 2)
    assert gain[0] > 0.9 * (found.chi2 - found.degrees_of_freedom)


def test_a_constant_offset_is_no_error() -> None:
    scores = encoder_scores(fitted(chain(0.05)))
    gain, _, deviation = scores.test(offset_from(0, 1))
    assert gain[0] == 0.0
    assert np.isinf(deviation[0])


def test_without_errors_gains_are_chi_squared() -> None:
    gains = [
        encoder_scores(fitted(chain(0.05, seed))).test(
            np.concatenate([offset_from(p, d) for p in (3, 6, 8) for d in range(4)])
        )[0]
        for seed in range(12)
    ]
    assert np.mean(gains) == pytest.approx(1.0, abs=0.45)
    assert np.max(gains) < 16
