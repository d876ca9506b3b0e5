"""How much of what is left over links may explain."""

from __future__ import annotations

import numpy as np
import pytest

from skin2urdf.estimation.trajectory.misfit import misfit, misfit_of_links, variance_beyond


def test_what_one_su_of_a_link_does_not_show_is_not_due_to_the_link() -> None:
    rng = np.random.default_rng(0)
    su_joint = np.array([0, 0, 1, 1])
    noise = np.array([1.0, 1.0, 1.0, 5.0])
    variances = np.broadcast_to(noise[:, None] ** 2, (200, 4, 3))
    quiet = rng.normal(size=(200, 4, 3)) * noise[:, None]
    assert misfit_of_links(quiet, variances, su_joint) == pytest.approx(1.0, rel=0.3)
    # An SU alone is off; the noise of its neighbour does not hide it.
    alone = quiet + 10 * np.eye(4)[0][:, None]
    assert misfit(alone, variances) > 20
    assert misfit_of_links(alone, variances, su_joint) < 2
    # All of a link are, as much as the noisier one does not even show.
    together = quiet + 10 * (su_joint == 1)[:, None]
    of_links = misfit_of_links(together, variances, su_joint)
    assert of_links == pytest.approx(misfit(together, variances), rel=0.4)
    # An SU that is the only one of its link may owe all to it.
    only = misfit_of_links(alone, variances, np.array([0, 1, 2, 2]))
    assert only == pytest.approx(misfit(alone, variances), rel=0.1)


@pytest.mark.parametrize("beyond", [0.0, 1e-5, 1e-3])
def test_noisy_sus_do_not_hide_what_quiet_ones_show(beyond: float) -> None:
    rng = np.random.default_rng(0)
    noise = np.broadcast_to(10.0 ** np.linspace(-7.0, -3.0, 7)[:, None], (60, 7, 3)).copy()
    means = rng.standard_normal(noise.shape) * np.sqrt(noise + beyond)
    # A spectrum that is not white makes what is left of the noisiest one less than its weights say.
    means[:, -1] *= 0.3
    noise[0, 0] = np.inf
    assert variance_beyond(means, noise) == pytest.approx(beyond, rel=0.15, abs=1e-7)
