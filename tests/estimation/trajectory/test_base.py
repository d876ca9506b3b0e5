"""A base that gives way is found from the readings of SUs on the robot alone.

Motions are Pinocchio's, of a robot with inertias and with two more joints below its base.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import ortho_group
from stand import BODIES, DEPTH, TREE, TRUTH, UP, readings_on_a_stand
from synthetic import RATE, sampled_trajectory, stays

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import identifiable
from skin2urdf.estimation.trajectory import attempt
from skin2urdf.estimation.trajectory.azimuth import turned
from skin2urdf.estimation.trajectory.balance import balanced, bending, followed
from skin2urdf.estimation.trajectory.bending import Bending, bends_of
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.leaning import with_leaning_base, with_pulls_on_leaning
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.moving_base import FELT
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.shifting import that_shifts
from skin2urdf.estimation.trajectory.slack import Lacking, Shared, Size, lacking, size_of
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.estimation.uncertainty.observability import Subject, observability_along
from skin2urdf.geometry.so3 import rotation_exp, rotation_log
from skin2urdf.signals.filters import filtered, low_pass
from skin2urdf.signals.trajectory import Trajectory

_STAY, _MOVE, _PLACES = 180, 120, 8
_BY_LOADS = (FELT,)
"""What the SU on the base feels is not taken off: loads have to tell how the base moves."""


def _log_on_a_stand(
    compliance: float, noise: float, step: float = 0.0, slides: float = 0.0
) -> tuple[Trajectory, F64]:
    """A log of stiff joints on a base, and how the base turns (N, 2) about x and y [rad].

    Args:
        compliance: by how much it turns about a point below it [rad/(N m)].
        noise: of the readings [m/s^2].
        step: of the encoders [rad].
        slides: by how much the base shifts along x and y [m/N].
    """
    at = np.random.default_rng(1).uniform(-1.5, 1.5, (_PLACES, 2))
    q = stays(at, _STAY, _MOVE)
    read, tilt = readings_on_a_stand(TREE, TRUTH, BODIES, q, compliance, slides)
    read = read + noise * np.random.default_rng(2).standard_normal(read.shape)
    seen = step * np.round(q / step) if step else q
    return replace(sampled_trajectory(seen, read), resolution=np.full(2, step)), tilt


@cache
def _on_a_stand(compliance: float, slides: float = 0.0) -> tuple[MotionEstimate, F64]:
    """What is found of a log on a base that gives way, and (N, 2) how that turns [rad].

    Args:
        compliance: by how much it turns about a point below it [rad/(N m)].
        slides: by how much it shifts along x and y [m/N].
    """
    truth = TRUTH
    log, tilt = _log_on_a_stand(compliance, 7e-3, slides=slides)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    # What stands still shows nothing of its turn about gravity.
    T = np.array(truth.T_joint_su)
    T[2, :3, :3] = rotation_exp(2.5 * UP) @ T[2, :3, :3]
    T[2, :3, 3] = 0.0
    start = replace(truth, T_joint_su=T)
    found = estimate_along([log], TREE, start, priors, np.zeros(3), without=_BY_LOADS)
    return found, tilt


def test_a_base_that_gives_way_is_followed() -> None:
    found, tilt = _on_a_stand(1 / 30_000)
    assert found.causes == ("base",)
    assert found.misfit < 1.5
    # The robot's forces act on the stand about the same point that the stand turns about.
    stand = found.problem.unseen
    assert isinstance(stand, Bending)
    np.testing.assert_allclose(stand.lever, [0.0, 0.0, DEPTH], atol=0.1)
    taps = low_pass(6.0, RATE)
    smooth = filtered(tilt, taps)[found.problem.logs[0].kept]
    np.testing.assert_allclose(found.base_motion[3:5], np.ptp(smooth, axis=0), rtol=0.2)
    assert np.max(found.deflections) < 0.1 * np.ptp(smooth, axis=0).max()
    # An SU on the base begins 2.5 rad off; its tilt and its bias are hardly told apart.
    turned = found.state.T_joint_su[2, :3, :3].T @ TRUTH.T_joint_su[2, :3, :3]
    assert np.linalg.norm(rotation_log(turned)) < 0.3
    stiff, _ = _on_a_stand(0.0)
    assert stiff.causes == ()
    assert not stiff.base_motion.any()
    # Loads that no encoder sees bend joints as well; what says less at first sight is not followed.
    assert "elastic" not in found.tried


def test_a_base_that_gives_way_by_less_than_encoders_round_off_is_followed() -> None:
    """It turns by a third of a milliradian, and misfits are as small as what rounding leaves."""
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))

    def found(compliance: float) -> tuple[str, ...]:
        log, tilt = _log_on_a_stand(compliance, 1e-3, step=4e-4)
        assert np.ptp(tilt, axis=0).max() < log.resolution[0]
        return estimate_along([log], TREE, TRUTH, priors, np.zeros(3), without=_BY_LOADS).causes

    assert found(0.0) == ()
    assert found(1 / 250_000) == ("base",)


def test_uneven_gears_on_a_base_that_gives_way_are_followed_as_well() -> None:
    """What the base does says more at first; what it leaves is no slack, nor rounding."""
    at = np.random.default_rng(1).uniform(-1.5, 1.5, (_PLACES, 2))
    q = stays(at, _STAY, _MOVE)
    read, _ = readings_on_a_stand(TREE, TRUTH, BODIES, q, 1 / 30_000)
    read = read + 7e-3 * np.random.default_rng(2).standard_normal(read.shape)
    ahead = 8e-4 * (np.sin(q + 0.3) + 0.5 * np.sin(2 * q + 2.0))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    log = sampled_trajectory(q - ahead, read)
    found = estimate_along([log], TREE, TRUTH, priors, np.zeros(3), without=_BY_LOADS)
    assert found.causes == ("base", "harmonics")
    assert found.misfit < 1.0
    # A constant of it is the joint's zero, and a slope along its range is its neighbours' turn.
    (seen,) = found.problem.deflections(found.fitted.state)
    kept = found.problem.logs[0].kept
    about = np.column_stack([np.ones(len(kept)), q[kept]])
    bends = np.hstack([seen, ahead[kept]])
    bends -= about @ np.linalg.lstsq(about, bends, rcond=None)[0]
    assert np.corrcoef(bends.T)[[0, 1], [2, 3]].min() > 0.9


def test_how_a_base_stands_is_chosen_or_stated_to_be_open() -> None:
    """Nothing shows its turn about gravity, nor how it leans all the time."""
    found, _ = _on_a_stand(1 / 30_000)
    tree, state, free = TREE, found.state, identifiable(TREE, 1)
    subject = Subject(tree, state, free, np.zeros((1, 2)), Priors(), Priors())
    seen = observability_along(subject, found.information)
    covariance = seen.covariance.joint[: free.joints.size, : free.joints.size]
    about_gravity, *about = (turned(tree, state, axis)[0].ravel() for axis in (UP, *np.eye(3)[:2]))
    about_gravity /= np.linalg.norm(about_gravity)
    assert np.sqrt(about_gravity @ covariance @ about_gravity) < 1e-5
    sways = np.concatenate(found.problem.base_motions(found.fitted.state))[:, 3:].std(axis=0).max()
    leans = np.array([way - (about_gravity @ way) * about_gravity for way in about])
    for way in leans:
        stated = np.sqrt(way @ covariance @ way)
        # Loads that hardly change are not known exactly, either.
        assert 1.0 < stated / (sways * np.linalg.norm(leans @ way)) < 2.0


def test_what_pulls_at_a_robot_pulls_at_the_lean_of_its_base_as_much() -> None:
    """Readings tell neither from the other; a pull at one alone would be an error of both."""
    found, _ = _on_a_stand(1 / 30_000)
    problem, fitted = found.problem, found.fitted
    wrong = np.random.default_rng(0).standard_normal(3)
    off = tuple(replace(p, residual=p.residual + wrong) for p in fitted.predicted)
    narrow = problem.equations(fitted.state, off, fitted.weights)
    wide, leaning = with_leaning_base(problem, fitted)
    pulls = (narrow.joint_gradient, narrow.su_gradient)
    ((joint, su),) = with_pulls_on_leaning(problem, fitted, [pulls])
    expected = wide.equations(leaning.state, off, fitted.weights)
    np.testing.assert_allclose(su, expected.su_gradient, rtol=1e-6, atol=1e-3)
    lean = slice(wide.layout.unseen.stop - 2, wide.layout.unseen.stop)
    size = np.abs(expected.joint_gradient[lean]).max()
    assert size > 0
    np.testing.assert_allclose(joint[lean], expected.joint_gradient[lean], atol=0.02 * size)


def test_what_numbers_stand_for_does_not_change_what_is_stated() -> None:
    """Loads may be mixed as one likes, where as much is known of the mixtures before."""
    found, _ = _on_a_stand(1 / 30_000)
    free, info = identifiable(TREE, 1), found.information
    J, Z = info.shared_joint.shape[1], len(info.shared)
    known = info.prior_joint[J:] > 0
    unit = np.where(known, info.prior_joint[J:].clip(min=1e-300) ** -0.5, 1.0)
    mixed = np.eye(Z)
    mixed[np.ix_(known, known)] = ortho_group.rvs(int(known.sum()), random_state=1)
    axes = unit[:, None] * mixed / unit
    others = info.along(axes)
    subject = Subject(TREE, found.state, free, np.zeros((1, 2)), Priors(), Priors())
    stated, mixtures = (
        np.sqrt(np.diag(observability_along(subject, each).covariance.joint)[:J])
        for each in (info, others)
    )
    shows = stated > 0
    np.testing.assert_allclose(mixtures[shows], stated[shows], rtol=0.01)


def test_what_each_number_does_to_the_base_is_what_another_number_makes() -> None:
    q = stays(np.random.default_rng(1).uniform(-1.0, 1.0, (3, 2)), _STAY, _MOVE)
    log, truth = sampled_trajectory(q, np.zeros((len(q), 3, 3))), TRUTH
    turns = bending(TREE, [log], truth, 9.81, joints=False, base=True)
    still = balanced(turns, TREE, [log], truth, 9.81, np.zeros(turns.n_numbers))
    loads, _ = that_shifts(still, np.full(3, 0.04))
    masses = np.concatenate([body.toDynamicParameters() for body in BODIES])
    x = np.zeros(loads.n_numbers)
    P = len(loads.basis)
    x[:P] = np.linalg.lstsq(loads.basis.T, masses / 20_000, rcond=None)[0]
    x[-13:-3] = [5e-5, 3e-5, 2e-5, 1e-5, 0.0, -1e-5, -4.0, 0.1, -0.2, 0.3]
    x[-3:] = [0.1, -0.1, 0.3]
    # Along and about other axes than its frame's it yields less.
    alike = np.array([[1.0, 0.2, 0.1], [0.2, 0.8, -0.2], [0.1, -0.2, 0.5]])
    found = replace(loads, compliance=block_diag(0.03 * alike[::-1, ::-1], alike))
    for _ in range(3):
        found, x = followed(found, TREE, [log], truth, 9.81, x)
    hinges, kept = slice(-6, None), log.kept
    steps = {n: 1e-3 * abs(x[n]) + 1e-7 for n in range(P)}
    steps |= dict.fromkeys(range(P, len(x)), 1e-2)
    steps |= dict.fromkeys(range(len(x) - 13, len(x) - 7), 1e-6)
    # What a mass does goes with the square of frequency: most is where low-passes begin, of which
    # a balance has one more than a derivative.
    of_mass = range(len(x) - 7, len(x) - 3)
    for n in [0, 1, *range(P, len(x))]:
        entries = np.flatnonzero((found.number == n) & (found.joint >= TREE.n_joints))
        if not len(entries):
            continue  # what yields most is the scale of all
        step = steps[n] * np.eye(len(x))[n]
        more, less = (
            followed(found, TREE, [log], truth, 9.81, x + far)[0].settled[0][kept, hinges]
            for far in (step, -step)
        )
        change = (more - less) / (2 * steps[n])
        told = np.zeros_like(change)
        told[:, found.joint[entries] - TREE.n_joints] = found.on_grid[0][np.ix_(kept, entries)]
        within = 0.02 if n in of_mass else 0.01
        assert np.linalg.norm(told - change) < within * np.linalg.norm(change)


def test_what_a_base_leaves_is_judged_by_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """In noise that falls with what is explained, little that is left is as certain as much was."""

    class Certain(Lacking):
        def size(self, group: int, shared: Shared | None = None) -> Size:
            size = super().size(group, shared)
            return replace(size, gain=max(size.gain, 13.0))

    def in_less_noise(
        problem: MotionProblem, fitted: Fitted, more: Sequence[Unseen], *, curves: bool = False
    ) -> Lacking:
        return Certain(**vars(lacking(problem, fitted, more, curves=curves)))

    monkeypatch.setattr(attempt, "lacking", in_less_noise)
    found, _ = _on_a_stand.__wrapped__(1 / 100_000)
    assert found.causes[0] == "base"
    assert found.misfit < 1.5


def test_a_base_that_says_little_at_first_is_followed_where_slack_leaves_much(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Loads of one size may say less than slack, which has a size for every joint."""

    def at_first(problem: MotionProblem, fitted: Fitted, more: Unseen) -> Size:
        size = size_of(problem, fitted, more)
        return replace(size, gain=min(size.gain, 20.0))

    monkeypatch.setattr(attempt, "size_of", at_first)
    found, _ = _on_a_stand.__wrapped__(1 / 10_000)
    assert found.causes == ("base",)
    assert found.misfit < 1.5


def test_a_base_that_shifts_as_well_as_it_turns_is_followed() -> None:
    """Turns about any point leave what shifts do, which looked like slack of the joints."""
    turns, shifts = 1 / 50_000, 1 / 200_000
    found, _ = _on_a_stand(turns, slides=shifts)
    assert found.causes == ("base",)
    bends = bends_of(found.problem.unseen)
    assert bends is not None
    assert bends.shifts
    yields = np.diag(bends.compliance)
    along, about = yields[:2], yields[3:5]
    np.testing.assert_allclose(along / about, shifts / turns, rtol=0.12)
    # Nothing yields along its vertical, nor about it.
    assert max(yields[2] / along.min(), yields[5] / about.min()) < 0.1
    between = [_between_axes(s.T_parent_joint[1]) for s in (found.state, TRUTH)]
    assert abs(between[0] - between[1]) < 1e-4


def _between_axes(T: F64) -> float:
    """Distance between the z axes of two frames, of which one is at T (4, 4) in the other [m]."""
    across = np.cross([0.0, 0.0, 1.0], T[:3, 2])
    return float(abs(across @ T[:3, 3]) / np.linalg.norm(across))
