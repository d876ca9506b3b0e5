"""What encoders' noise does through loads, on a stand whose tilt is Pinocchio's."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import islice
from typing import Any

import numpy as np
import pytest
from stand import BODIES, TREE, TRUTH, readings_on_a_stand
from synthetic import sampled_trajectory, stays

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory import estimate, yielding
from skin2urdf.estimation.trajectory.ahead import step_along
from skin2urdf.estimation.trajectory.balance import Balance, balanced
from skin2urdf.estimation.trajectory.encoder_noise import without_shortening
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.moving_base import FELT
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.rounded import drawn_anew
from skin2urdf.estimation.trajectory.shaken_loads import ShakenLoads, shaken_loads
from skin2urdf.signals.trajectory import Trajectory


@cache
def _log() -> Trajectory:
    """On a stand of 30 kNm/rad, with encoders of 17 bits and sensors that are nearly exact."""
    q = stays(np.random.default_rng(1).uniform(-1.5, 1.5, (6, 2)), 150, 120)
    read, _ = readings_on_a_stand(TREE, TRUTH, BODIES, q, 1 / 30_000)
    read = read + 5e-4 * np.random.default_rng(2).standard_normal(read.shape)
    step = 2 * np.pi / 2**17
    log = sampled_trajectory(step * np.round(q / step), read, still_below=1e-3)
    log = replace(log, resolution=np.full(2, step))
    return replace(log, noise=log.rounding)


def _estimated(log: Trajectory) -> MotionEstimate:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    return estimate_along([log], TREE, TRUTH, priors, np.zeros(3), without=(FELT,))


@cache
def _found() -> MotionEstimate:
    return _estimated(_log())


def _height(state: State) -> float:
    """How far the first SU is above the second joint along the first axis, across the second [m].

    A base that stands still shows nothing of it.
    """
    second = state.T_parent_joint[1]
    up = np.array([0.0, 0.0, 1.0]) - second[2, 2] * second[:3, 2]
    apart: F64 = state.T_joint_su[0, :3, 3] - second[:3, 3]
    return float(up @ apart / np.linalg.norm(up))


def test_what_a_draw_does_through_loads_is_what_it_does_to_an_estimate() -> None:
    found, log = _found(), _log()
    loads, fitted, layout = found.loads, found.fitted, found.problem.layout
    assert loads is not None
    assert loads.taken_off
    expected, seen = [], []
    for draw, (off,) in enumerate(islice(drawn_anew([log]), 2)):
        step = step_along(fitted, loads.joint[draw], loads.su[draw])
        moved = layout.moved(fitted.state, *step.steps).placements
        expected.append(_height(moved) - _height(found.state))
        seen.append(_height(_estimated(log.with_joints_off(off)).state) - _height(found.state))
    np.testing.assert_array_equal(np.sign(seen), np.sign(expected))
    assert np.abs(np.subtract(seen, expected)).sum() < 0.5 * np.abs(seen).sum()


def test_a_fit_whose_loads_are_out_of_balance_is_nobodys(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _found()
    assert "base" in found.causes
    assert yielding.is_in_balance(found.problem, found.fitted)
    # Masses of the other sign, and many times as heavy.
    state = replace(found.fitted.state, unseen=-400.0 * found.fitted.state.unseen)
    nobodys = replace(found.fitted, state=state)
    assert not yielding.is_in_balance(found.problem, nobodys)
    assert shaken_loads(found.problem, nobodys) is None
    assert yielding.is_in_balance(found.problem.stiff(), found.fitted)
    monkeypatch.setattr(estimate, "is_in_balance", lambda *_: False)
    assert not set(_estimated(_log()).causes) & {"base", "elastic"}


def test_exact_encoders_and_links_that_follow_no_loads_are_shaken_by_none() -> None:
    found = _found()
    exact = found.problem.again(logs=[replace(_log(), resolution=np.zeros(2))])
    assert shaken_loads(exact, found.fitted) is None
    stiff = found.problem.stiff()
    state = replace(found.fitted.state, unseen=np.zeros(0))
    assert shaken_loads(stiff, replace(found.fitted, problem=stiff, state=state)) is None


def test_deflections_that_are_in_no_balance_with_their_loads_explain_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    rigid = estimate_along([_log()], TREE, TRUTH, priors, np.zeros(3), look_further=False)

    def out_of_balance(*arguments: Any) -> Balance:
        there = balanced(*arguments)
        return replace(there, deflections=replace(there.deflections, holds=False))

    monkeypatch.setattr(yielding, "balanced", out_of_balance)
    bent = yielding.fit_yielding(rigid.problem, rigid.fitted, elastic=True, base=False)
    assert bent == (rigid.problem, rigid.fitted)


def test_a_step_that_would_leave_more_than_it_takes_is_not_taken() -> None:
    """With draws of sixteen times the step, what loads do leads to where residuals grow."""
    found = _found()
    coarse = replace(_log(), resolution=16 * _log().resolution)
    problem = found.problem.again(logs=[coarse])
    fitted, parts, loads = without_shortening(problem, found.fitted)
    assert loads is not None
    assert not loads.taken_off
    # What goes past loads is taken off all the same.
    assert len(parts) == TREE.n_joints
    assert fitted is not found.fitted


def test_what_is_not_taken_off_is_an_error() -> None:
    rng = np.random.default_rng(0)
    joint, su = 3 + rng.normal(size=(8, 5)), rng.normal(size=(8, 2, 4))
    loads = ShakenLoads(np.arange(2), joint, su, np.zeros(5))
    off = np.array([joint for joint, _ in loads.off])
    np.testing.assert_allclose(off[-1], loads.joint.mean(axis=0))
    # The variance of a mean of eight, and nothing else, is left where it is taken off.
    known = np.array([joint for joint, _ in replace(loads, taken_off=True).off])
    np.testing.assert_allclose(known, off[:-1])
    np.testing.assert_allclose((known**2).sum(axis=0), loads.joint.var(axis=0) / 8)
