"""The alignment is exact without errors and optimal with them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skin2urdf.geometry import se3
from skin2urdf.urdf.alignment import ARM, align, kabsch

SCALE = np.array([1, 1, 1, ARM, ARM, ARM])
NONE = np.zeros((0, 6))


def frames(rng: np.random.Generator, *shape: int) -> np.ndarray:
    n = int(np.prod(shape))
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.random(n, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-1, 1, (n, 3))
    return T.reshape(*shape, 4, 4)


def cost(X: np.ndarray, D: np.ndarray, T_est: np.ndarray, T_true: np.ndarray) -> float:
    error = se3.log(np.linalg.inv(X @ T_est @ D) @ T_true) * SCALE
    return float(np.sum(error**2))


def test_kabsch_is_exact_without_errors() -> None:
    rng = np.random.default_rng(0)
    X, T = frames(rng, 1)[0], frames(rng, 4, 3)
    np.testing.assert_allclose(kabsch(T, X @ T), X, atol=1e-12)
    # Orientations count: one frame is enough, and so are frames on one line.
    np.testing.assert_allclose(kabsch(T[:1, :1], X @ T[:1, :1]), X, atol=1e-12)


@pytest.mark.parametrize(("noise", "step"), [(1e-4, 1e-6), (1e-2, 1e-3), (0.1, 0.02)])
def test_alignment_is_the_least_squares_one(noise: float, step: float) -> None:
    rng = np.random.default_rng(1)
    T_est = frames(rng, 30, 3)
    T_true = frames(rng, 1)[0] @ T_est @ se3.exp(noise * rng.standard_normal((30, 3, 6)))
    free = [NONE, np.eye(6)[[0, 4]], np.eye(6)[[5]]]
    X, D = align(T_est, T_true, free)
    best = cost(X, D, T_est, T_true)
    for direction in np.concatenate([np.eye(6), -np.eye(6)]):
        assert cost(X @ se3.exp(step * direction), D, T_est, T_true) > best
    for u, rows in enumerate(free):
        for direction in (*rows, *(-rows)):
            moved = D.copy()
            moved[u] = moved[u] @ se3.exp(step * direction)
            assert cost(X, moved, T_est, T_true) > best


def test_displacements_keep_to_their_directions() -> None:
    rng = np.random.default_rng(2)
    T_est = frames(rng, 20, 2)
    T_true = T_est @ se3.exp(0.01 * rng.standard_normal((20, 2, 6)))
    _, D = align(T_est, T_true, [NONE, np.array([[0, 0, 1.0, 0, 0, 0]])])
    np.testing.assert_array_equal(D[0], np.eye(4))
    moved = se3.log(D[1])
    assert abs(moved[2]) > 1e-5
    np.testing.assert_allclose(np.delete(moved, 2), 0, atol=1e-12)


def test_many_displacements_do_not_slow_the_alignment() -> None:
    """One firm SU among many that tell one direction each: the optimum in a few steps."""
    rng = np.random.default_rng(3)
    n = 40
    T_est = frames(rng, 3, n)
    T_true = T_est @ se3.exp(1e-5 * rng.standard_normal((3, n, 6)))
    free = [NONE, *(np.eye(6)[rng.permutation(6)[:5]] for _ in range(n - 1))]
    X, D = align(T_est, T_true, free)
    best = cost(X, D, T_est, T_true)
    X_again, D_again = X, D
    for _ in range(5):  # from where it ended, further alignment gains nothing
        more, moved = align(X_again @ T_est @ D_again, T_true, free)
        X_again = more @ X_again
        D_again = D_again @ moved
    assert cost(X_again, D_again, T_est, T_true) > best * (1 - 1e-6)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("angle", [0.5, 3.0, np.pi, -np.pi])
def test_displacements_may_be_large(seed: int, angle: float) -> None:
    """Half a turn about a screw axis, which noise shows as +pi here and as -pi there."""
    rng = np.random.default_rng(seed)
    n, noise = 4, 1e-3
    T_est = frames(rng, 20, n)
    xi = rng.standard_normal((n, 6))
    xi /= np.linalg.norm(xi[:, 3:], axis=1, keepdims=True)
    D_true = se3.exp(angle * xi)
    D_true[0] = np.eye(4)
    T_true = frames(rng, 1)[0] @ T_est @ D_true
    T_true = T_true @ se3.exp(noise * rng.standard_normal((20, n, 6)))
    free = [NONE, *(x[None] * SCALE for x in xi[1:])]
    X, D = align(T_est, T_true, free)
    assert cost(X, D, T_est, T_true) < 1.5 * T_est[..., 0, 0].size * noise**2 * np.sum(SCALE**2)
    np.testing.assert_allclose(D, D_true, atol=10 * noise)


@pytest.mark.parametrize("seed", range(20))
def test_sus_that_are_free_along_one_axis_do_not_turn_the_base(seed: int) -> None:
    """Joints on one line, whose SUs may be anywhere along it: half a metre apart, or beside."""
    rng = np.random.default_rng(seed)
    at = frames(rng, 2)
    at[:, :3, 3] *= 0.1
    turns = se3.exp(rng.uniform(-2.0, 2.0, (20, 2, 1)) * np.eye(6)[5])
    T_est = turns @ at
    free = [np.r_[T[2, :3], np.zeros(3)][None] for T in at]
    D_true = se3.exp(np.array([[0.5], [-0.4]]) * np.concatenate(free))
    T_true = frames(rng, 1)[0] @ T_est @ D_true
    X, D = align(T_est, T_true, free)
    assert cost(X, D, T_est, T_true) < 1e-12


@pytest.mark.parametrize("seed", range(6))
def test_a_limb_that_is_free_along_its_axes_is_aligned_all_the_same(seed: int) -> None:
    """All places are open along nearly one axis: the frame may lie anywhere along it as well."""
    rng = np.random.default_rng(seed)
    first, second = rng.uniform(-1.5, 1.5, (2, 60, 1))
    turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    link, tool = frames(rng, 2)

    def limb(tilt: float) -> np.ndarray:
        """Poses of an SU on either link; the second axis is tilted against the first."""
        elbow = np.eye(4)
        elbow[:3, :3] = Rotation.from_rotvec([tilt, 0.0, 0.0]).as_matrix()
        elbow[:3, 3] = 0.3, 0.1, -0.1
        T_first = se3.exp(first * turn)
        T_second = T_first @ elbow @ se3.exp(second * turn)
        return np.stack([T_first @ link, T_second @ tool], axis=1)

    free = [np.array([[*T[2, :3], 0.0, 0.0, 0.0]]) for T in (link, tool)]
    off = np.stack([se3.exp(x * rows[0]) for x, rows in zip((0.3, -0.2), free, strict=True)])
    wrong = se3.exp(0.03 * rng.standard_normal((2, 6)))
    X_true, T_est = frames(rng, 1)[0], limb(1e-4)
    T_true = X_true @ limb(0.03) @ off @ wrong
    X, D = align(T_est, T_true, free)
    assert cost(X, D, T_est, T_true) <= cost(X_true, off, T_est, T_true)
