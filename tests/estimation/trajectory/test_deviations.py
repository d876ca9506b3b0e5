"""Deviations of what is each SU's own are those of the whole inverse."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.estimation.trajectory.deviations import su_covariances
from skin2urdf.estimation.trajectory.records import Equations

U, J, N = 3, 4, 6


def equations(rng: np.random.Generator, scale: float) -> tuple[Equations, np.ndarray]:
    """Normal equations in arrow form, and the same as one matrix; units differ by ``scale``."""
    A = rng.standard_normal((U, 20, J + N)) * np.r_[np.ones(J), np.geomspace(1, scale, N)]
    blocks = np.swapaxes(A, 1, 2) @ A
    whole = np.zeros((J + U * N, J + U * N))
    for u, block in enumerate(blocks):
        at = np.r_[:J, J + u * N : J + (u + 1) * N]
        whole[np.ix_(at, at)] += block
    return Equations(
        joint=blocks[:, :J, :J].sum(axis=0),
        su=blocks[:, J:, J:],
        mixed=blocks[:, J:, :J],
        joint_gradient=np.zeros(J),
        su_gradient=np.zeros((U, N)),
    ), whole


@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_they_are_blocks_of_the_whole_inverse(scale: float) -> None:
    arrow, whole = equations(np.random.default_rng(0), scale)
    found, inverse = su_covariances(arrow), np.linalg.inv(whole)
    for u in range(U):
        at = slice(J + u * N, J + (u + 1) * N)
        sd = np.sqrt(np.diagonal(inverse[at, at]))
        assert found[u] / np.outer(sd, sd) == pytest.approx(inverse[at, at] / np.outer(sd, sd))


def test_a_direction_that_nothing_tells_disturbs_no_other() -> None:
    arrow, _ = equations(np.random.default_rng(1), 1.0)
    su, mixed = np.array(arrow.su), np.array(arrow.mixed)
    su[0, 0, :] = su[0, :, 0] = 0.0
    mixed[0, 0] = 0.0
    blind = Equations(arrow.joint, su, mixed, arrow.joint_gradient, arrow.su_gradient)
    found = su_covariances(blind)
    assert np.isfinite(found).all()
    assert found[0, 0] == pytest.approx(0.0)
    assert (np.diagonal(found, axis1=1, axis2=2)[0, 1:] > 0).all()
