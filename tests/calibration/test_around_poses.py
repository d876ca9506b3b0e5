"""SUs and poses are judged by the model that explains all samples, whatever features leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from calibrated import calibration, simulation

from skin2urdf.arrays import F64
from skin2urdf.calibration.around_poses import judged_by_samples, samples_around_poses
from skin2urdf.calibration.result import GOOD_FIT, Calibration
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.uncertainty.goodness import Goodness, Share
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled, sampled_together

_OFF = 0.05
"""Error of readings [m/s^2], five times their noise."""


@cache
def _sampled() -> Sequence[Sampled]:
    return sampled_together([retimed(simulation().recording)])[0]


def _all() -> tuple[MotionEstimate, Features]:
    found = calibration()
    assert found.along is not None
    assert found.features is not None
    return found.along, found.features


def _with_more(more: F64) -> MotionEstimate:
    """The fit of all samples, with residuals (K, U, 3) that have more in them [m/s^2]."""
    along, _ = _all()
    (predicted,) = along.fitted.predicted
    predicted = replace(predicted, residual=predicted.residual + more)
    return replace(along, fitted=replace(along.fitted, predicted=(predicted,)))


def _misfit_of_features() -> Goodness:
    """Features that one SU hardly fits, and of which none is predicted from the others."""
    fit = calibration().goodness
    factors = np.where(np.arange(fit.by_block.dof.shape[1]) == 4, 1e3, 1.0)
    held_out = Share(9.0 * fit.held_out.chi2, fit.held_out.dof)
    return replace(
        fit,
        by_block=Share(fit.by_block.chi2 * factors, fit.by_block.dof),
        held_out=held_out,
        of_features=True,
    )


def _judged(along: MotionEstimate) -> Calibration:
    fit = judged_by_samples(_misfit_of_features(), along, _all()[1], _sampled())
    return replace(calibration(), along=along, goodness=fit)


def test_samples_of_all_poses_and_sus_leave_no_more_than_noise() -> None:
    along, features = _all()
    found = samples_around_poses(along, features, _sampled())
    assert found.dof.shape == (features.n_poses, along.problem.tree.n_sus)
    assert (found.dof >= 3).all()
    assert found.chi2.sum() / found.dof.sum() < GOOD_FIT


def test_what_samples_explain_is_no_misfit_of_an_su() -> None:
    found = _judged(_all()[0])
    assert not found.unlike_sus.odd.any()
    assert not found.unlike_poses.odd.any()


def test_samples_show_an_su_that_does_not_fit() -> None:
    along, _ = _all()
    more = np.zeros(along.fitted.predicted[0].residual.shape)
    more[:, 2] = _OFF
    assert np.flatnonzero(_judged(_with_more(more)).unlike_sus.odd).tolist() == [2]


def test_samples_show_a_pose_that_does_not_fit() -> None:
    along, _ = _all()
    kept, windows = along.problem.logs[0].kept, _sampled()[0].neighbourhoods[1].windows
    during = np.any([(kept >= begin) & (kept < end) for begin, end in windows], axis=0)
    more = np.where(during, _OFF, 0.0)[:, None, None] * np.ones((1, along.problem.tree.n_sus, 3))
    assert np.flatnonzero(_judged(_with_more(more)).unlike_poses.odd).tolist() == [1]


def test_features_tell_nothing_of_how_well_more_than_a_rigid_robot_predicts() -> None:
    along, _ = _all()
    assert _judged(along).quality == "fair"
    yielding = _judged(replace(along, causes=("elastic",)))
    assert np.isnan(yielding.goodness.prediction)
    assert yielding.quality == "good"


def test_features_tell_where_samples_are_not_explained() -> None:
    fit, (along, features) = _misfit_of_features(), _all()
    unexplained = replace(along, misfit=2 * GOOD_FIT)
    assert judged_by_samples(fit, unexplained, features, _sampled()) is fit
    assert judged_by_samples(fit, None, features, _sampled()) is fit
    loose = replace(along, causes=("elastic", "slack"))
    assert judged_by_samples(fit, loose, features, _sampled()) is fit


def test_features_tell_of_poses_without_samples() -> None:
    fit, (along, features) = _misfit_of_features(), _all()
    nowhen = replace(features, span=np.zeros(2))
    found = judged_by_samples(fit, along, nowhen, _sampled())
    np.testing.assert_array_equal(found.by_block.chi2, fit.by_block.chi2)
