"""Notes on what does not fit, on a small calibration whose residuals are made worse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated import calibration

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.uncertainty.goodness import Goodness, Share
from skin2urdf.estimation.uncertainty.health import (
    health_notes,
    mirrored_sus,
    unlike_the_rest,
)
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.notes import Note, of_kind


def with_misfit(factors: F64) -> Goodness:
    """The goodness of fit with the chi-squared of blocks (P, U) multiplied."""
    fit = calibration().goodness
    return replace(fit, by_block=Share(fit.by_block.chi2 * factors, fit.by_block.dof))


def notes(su: int | None = None, pose: int | None = None) -> list[Note]:
    """Notes about misfits, with one SU and one pose a thousand times worse."""
    factors = np.ones(calibration().goodness.by_block.chi2.shape)
    if su is not None:
        factors[:, su] *= 1e3
    if pose is not None:
        factors[pose] *= 1e3
    found = health_notes(calibration().estimate, with_misfit(factors))
    return [*of_kind(found, "misfit"), *of_kind(found, "poses misfit")]


def test_a_clean_recording_has_no_notes_about_its_fit() -> None:
    assert notes() == []
    assert unlike_the_rest(calibration().estimate) == ()


def test_an_su_that_does_not_fit_is_named() -> None:
    (note,) = notes(su=3)
    assert (note.kind, note.sus) == ("misfit", (calibration().model.tree.su_names[3],))
    assert note.size > 30


def test_a_pose_that_does_not_fit_is_numbered() -> None:
    last = len(calibration().features.q) - 1
    assert notes(pose=last) == [Note("poses misfit", numbers=(last,), of=last + 1)]


def test_poses_with_patterns_are_told_from_rests() -> None:
    excited = calibration().goodness.patterned
    assert excited.sum() == 3
    assert not excited[:-3].any()


def test_no_result_with_a_sensor_that_counts_one_axis_the_other_way_is_good() -> None:
    """A scale of -1 explains its readings as well as a left-handed frame does."""
    sound = calibration()
    assert sound.quality == "good"
    assert are_plausible(sound.estimate.state).all()
    shape = np.array(sound.estimate.state.shape)
    shape[2, 2] = -2.0
    state = replace(sound.estimate.state, shape=shape)
    assert np.flatnonzero(~are_plausible(state)).tolist() == [2]
    assert replace(sound, estimate=replace(sound.estimate, state=state)).quality == "fair"


def test_a_mirrored_su_is_told_where_the_tip_of_its_limb_shows_no_axes() -> None:
    found = calibration().estimate
    tip, mirrored = (int(np.argsort(found.tree.su_joint)[i]) for i in (-1, -2))
    coefficients = np.array(found.cost.blocks.coefficients)
    coefficients[:, mirrored] *= -1
    of_tip = coefficients[:, tip, 1:]
    of_tip += np.random.default_rng(0).normal(0.0, 3.0, of_tip.shape)
    blocks = replace(found.cost.blocks, coefficients=coefficients)
    cost = Cost(found.tree, blocks, found.cost.priors)
    assert mirrored_sus(replace(found, cost=cost)) == (mirrored,)


@pytest.mark.parametrize(
    ("implausible", "open_", "quality"), [(3, 4, "fair"), (4, 1, "fair"), (4, 4, "bad")]
)
def test_sensors_that_none_is_like_speak_against_a_model_that_leaves_them_open(
    implausible: int, open_: int, quality: str
) -> None:
    """All readings may be too large by one scale, which gravity tells; then SUs are determined."""
    sound = calibration()
    shape = np.array(sound.estimate.state.shape)
    assert 3 <= len(shape) / 2 < 4
    shape[:implausible, 0] = 0.5
    state = replace(sound.estimate.state, shape=shape)
    verdicts = sound.observability.su_verdict
    seen = replace(
        sound.observability,
        su_verdict=(*verdicts[: len(verdicts) - open_], *(open_ * ("not observable",))),
    )
    found = replace(sound, estimate=replace(sound.estimate, state=state), observability=seen)
    assert found.quality == quality
