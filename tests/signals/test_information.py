from dataclasses import replace

import numpy as np
import pytest

from skin2urdf.signals.information import Information


@pytest.fixture(scope="module")
def shared() -> Information:
    """Three poses and four SUs over five coefficients; SUs 0 and 2 share samples in pose 1."""
    rng = np.random.default_rng(0)
    X = rng.standard_normal((5, 20, 5))
    which = np.array([[0, 0, 0, 0], [1, 2, 1, 3], [4, 4, 4, 4]])
    weight, gain = rng.uniform(0.5, 2.0, (2, 3, 4, 5))
    weight[2, 3] = 0.0
    white = Information.of_products(np.swapaxes(X, 1, 2) @ X, which)
    np.testing.assert_allclose(white.dense(), (np.swapaxes(X, 1, 2) @ X)[which], rtol=1e-9)
    return replace(white, gain=gain, weight=weight)


def test_sus_that_share_samples_are_weighed_on_their_own(shared: Information) -> None:
    dense = shared.dense()
    for p, u in np.ndindex(3, 4):
        W = np.diag(shared.weight[p, u])
        G = W @ shared.factor[shared.which[p, u]]
        expected = G @ np.diag(shared.gain[p, u]) @ G.T
        np.testing.assert_allclose(dense[p, u], expected, rtol=1e-12)
    np.testing.assert_allclose(shared.diagonal(), np.einsum("puii->pui", dense), rtol=1e-12)
    assert not dense[2, 3].any()


def test_blocks_and_products_are_those_of_the_whole(shared: Information) -> None:
    rng, dense = np.random.default_rng(1), shared.dense()
    x = rng.standard_normal((3, 4, 5, 2))
    np.testing.assert_allclose(shared.times(x), dense @ x, rtol=1e-10, atol=1e-12)
    su, rows = np.array([3, 1]), np.array([[0, 4, 2], [1, 0, 3]])
    block = shared.block(su, rows)
    for i, u in enumerate(su):
        np.testing.assert_allclose(block[:, i], dense[:, u][:, rows[i]][:, :, rows[i]], rtol=1e-12)


def test_parts_are_joined_scaled_and_chosen(shared: Information) -> None:
    dense = shared.dense()
    twice = Information.joined([shared, Information.of(dense)])
    np.testing.assert_allclose(twice.dense(), np.concatenate([dense, dense]), rtol=1e-12)
    chosen = np.array([False, True, True, True, False, False])
    np.testing.assert_allclose(
        twice.of_poses(chosen).dense(), np.concatenate([dense[1:], dense[:1]]), rtol=1e-12
    )
    factor = np.array([1.0, 2.0, 0.0, -1.0, 3.0])
    np.testing.assert_allclose(
        shared.scaled(factor).dense(), dense * factor[:, None] * factor, rtol=1e-12
    )
