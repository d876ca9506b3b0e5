"""Options that make sensors better than they are, named where nothing fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated import calibration

from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import Free
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.health import few_affected, why_bad
from skin2urdf.estimation.uncertainty.narrow import narrow_priors


def test_priors_that_hold_are_not_named() -> None:
    assert narrow_priors(calibration().estimate) == ()


@pytest.mark.parametrize(("name", "option"), [("bias", "--bias"), ("scale", "--scale")])
def test_priors_far_below_what_was_found_are_named(name: str, option: str) -> None:
    found = calibration().estimate
    narrow = replace(found, given=replace(found.given, **{name: 1e-6}))
    (words,) = narrow_priors(narrow)
    assert option in words
    assert option in why_bad(narrow, 50.0)[1]


def test_sensors_that_are_none_say_nothing_of_what_was_given() -> None:
    """Of a robot with another tree most SUs come out with scale errors as none has."""
    found = calibration().estimate
    shape = np.zeros_like(found.state.shape)
    shape[found.tree.su_joint >= 0] = 0.3
    shape[np.argmax(found.tree.su_joint >= 0)] = 0.0
    wrong = replace(found, state=replace(found.state, shape=shape))
    assert narrow_priors(wrong) == ()
    assert "--scale" not in why_bad(wrong, 50.0)[1]


def test_the_worst_sus_are_those_of_all_samples_where_these_decide() -> None:
    """Features of a log without patterns are rests, which leave nothing of what moves show."""
    found = calibration().estimate
    names = found.tree.su_names
    left = np.where(np.arange(len(names)) < 3, 30.0, 1.0)
    told = why_bad(found, 10.0, (24.0, left))[0]
    assert [name in told for name in names] == (left > 1).tolist()


@pytest.mark.parametrize("several", [1, 3])
def test_sus_that_a_robot_does_not_explain_may_be_left_out_where_they_are_few(several: int) -> None:
    found = calibration().estimate
    names = found.tree.su_names
    left = np.where(np.arange(len(names)) < several, 500.0, 1.0)
    assert few_affected(found, 20.0, (60.0, left)) == names[:several]
    assert all(f"--without {su}" in why_bad(found, 20.0, (60.0, left))[1] for su in names[:several])
    assert few_affected(found, 20.0, (60.0, 500.0 - left)) == ()
    assert few_affected(found, 20.0, (60.0, np.ones(len(names)))) == ()


def test_errors_that_were_denied_show_in_the_size_of_gravity() -> None:
    found = calibration().estimate
    sus = found.free.sus.copy()
    sus[:, 6:] = False
    blocks = found.cost.blocks

    def readings(factor: float) -> Estimate:
        """The estimate with errors denied, from readings at rest of a multiple of gravity."""
        coefficients = np.array(blocks.coefficients)
        f0 = coefficients[:, :, 0]
        f0 *= factor * found.given.gravity / np.linalg.norm(f0, axis=-1, keepdims=True)
        cost = Cost(found.tree, replace(blocks, coefficients=coefficients), found.given)
        return replace(found, free=Free(found.free.joints, found.free.logs, sus), cost=cost)

    assert narrow_priors(readings(1.0)) == ()
    (words,) = narrow_priors(readings(1.01))
    assert "--no-intrinsics" in words
