"""What encoders get wrong, put into other orders, poses and units."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.signals.encoder_noise import EncoderNoise

ARRAYS = ("position_sd", "pull", "hidden", "omega2", "tones", "products", "white")


def random_noise(P: int, D: int) -> EncoderNoise:
    draw = np.random.default_rng(0).uniform
    return EncoderNoise(
        position_sd=draw(1, 2, (P, D)),
        pull=draw(1, 2, (P, D, 1 + 2 * D)),
        hidden=draw(1, 2, (P, D, D)),
        omega2=draw(1, 2, (P, D)),
        tones=draw(1, 2, (P, D, 2)),
        products=draw(1, 2, (P, 2 * D, 2 * D)),
        white=draw(1, 2, (P, D, D)),
    )


def assert_same(a: EncoderNoise, b: EncoderNoise) -> None:
    for name in ARRAYS:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), err_msg=name)


def test_joints_change_places_with_all_that_is_theirs() -> None:
    noise, order = random_noise(3, 4), np.array([2, 0, 3, 1])
    turned = noise.of_dofs(order)
    d, e = 1, 2
    assert turned.position_sd[0, d] == noise.position_sd[0, order[d]]
    assert turned.hidden[0, d, e] == noise.hidden[0, order[d], order[e]]
    assert turned.white[0, d, e] == noise.white[0, order[d], order[e]]
    assert turned.products[0, d, 4 + e] == noise.products[0, order[d], 4 + order[e]]
    assert turned.pull[0, d, 0] == noise.pull[0, order[d], 0]
    assert turned.pull[0, d, 1 + 4 + e] == noise.pull[0, order[d], 1 + 4 + order[e]]
    assert_same(turned.of_dofs(np.argsort(order)), noise)


def test_fewer_joints_and_poses_keep_what_is_theirs() -> None:
    noise = random_noise(3, 4)
    part = noise.of_poses(np.array([2])).of_dofs(np.array([3, 1]))
    assert part.pull.shape == (1, 2, 5)
    assert part.products.shape == (1, 4, 4)
    assert part.tones[0, 1, 0] == noise.tones[2, 1, 0]
    one_by_one = EncoderNoise.joined([EncoderNoise(**_of_pose(noise, p)) for p in range(3)])
    assert_same(one_by_one, noise)


def _of_pose(noise: EncoderNoise, pose: int) -> dict[str, np.ndarray]:
    return {name: getattr(noise, name)[pose] for name in ARRAYS}


def test_other_units_of_the_positions_change_no_reading() -> None:
    """Shares of the readings ``s q`` and ``tau qdd`` stay, with s and tau per the new unit."""
    noise, scale = random_noise(2, 3), np.array([2.0, -1.0, 0.5])
    other = noise.rescaled(scale)
    np.testing.assert_allclose(other.position_sd * np.abs(scale), noise.position_sd)
    np.testing.assert_allclose(other.white * scale**2, noise.white)
    # Motion of e per acceleration of d: squares of units of e over squares of units of d.
    np.testing.assert_allclose(other.hidden * (scale / scale[:, None]) ** 2, noise.hidden)
    np.testing.assert_allclose(other.pull[..., 1:4], noise.pull[..., 1:4] * scale)
    assert_same(other.rescaled(1 / scale), noise)


def test_what_is_not_given_is_without_error() -> None:
    noise = EncoderNoise(position_sd=np.array([0.1, np.inf])).of_size(3, 2)
    assert noise.position_sd.shape == (3, 2)
    np.testing.assert_array_equal(noise.pull, np.tile(np.eye(5)[0], (3, 2, 1)))
    assert not noise.white.any()
    known = noise.with_unknown_positions_at_rest()
    np.testing.assert_array_equal(known.position_sd, np.tile([0.1, 0.0], (3, 1)))
    with pytest.raises(ValueError):
        noise.of_size(3, 4)
