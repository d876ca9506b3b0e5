"""What numbers of gaps do is what links in them do."""

from __future__ import annotations

import numpy as np
from synthetic import RATE, sampled_trajectory, serial_tree, stays

from skin2urdf.estimation.trajectory.coarser import on_grid
from skin2urdf.estimation.trajectory.gaps import Gaps

_D, _P, _STEP = 2, 3, 4


def test_motions_of_gaps_are_what_their_numbers_change() -> None:
    rng = np.random.default_rng(7)
    tree = serial_tree(_D)
    q = stays(rng.uniform(-1.0, 1.0, (5, _D)), 60, 120)
    log = sampled_trajectory(q, np.zeros((len(q), tree.n_sus, 3)))
    time = np.arange(0, len(q), _STEP) / RATE
    torques = np.sin(
        time[:, None, None] * rng.uniform(1, 6, (_D, _P)) + rng.uniform(0, 6, _D)[:, None]
    )
    none = Gaps(
        np.tile(np.arange(_D), _P + 1),
        (np.zeros((0, (_P + 1) * _D)),),
        number=np.concatenate([np.repeat(np.arange(_P), _D), _P + np.arange(_D)]),
        every=(_STEP,),
        torques=(torques,),
    )
    x = np.array([1.5, -0.7, 0.4, 1e-3, 2e-3])
    about = none.about([log], x)
    largest = np.abs(about.moved(log, 0, x).q - log.q).max(axis=0)
    assert (0.7 * x[_P:] < largest).all()
    assert (largest < x[_P:]).all()
    for number, size in enumerate([1e-3] * _P + [1e-6] * _D):
        more = x + size * (np.arange(_P + _D) == number)
        ends = (none.about([log], each).moved(log, 0, each).q for each in (more, 2 * x - more))
        ahead, behind = (each[50:-50] for each in ends)
        changes = (ahead - behind) / (2 * size)
        of_number = about.number == number
        there = np.zeros((len(time), _D))
        there[:, about.joint[of_number]] = about.motions[0][:, of_number]
        found = on_grid(there, _STEP, len(q))[50:-50]
        np.testing.assert_allclose(found, changes, atol=2e-3 * np.abs(changes).max())
