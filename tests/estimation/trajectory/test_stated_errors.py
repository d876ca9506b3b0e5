"""Stated errors hold where a robot has what no model of it has, and are not wide where it has not.

Motions are Pinocchio's, of a robot with inertias on two more joints below its base.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from stand import UP, readings_on_a_stand
from synthetic import RATE, random_state, sampled_trajectory, serial_tree, stays

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State, identifiable
from skin2urdf.estimation.trajectory.clusters import CLUSTERS, clusters
from skin2urdf.estimation.trajectory.estimate import estimate_along
from skin2urdf.estimation.trajectory.fit import fit
from skin2urdf.estimation.trajectory.information import motion_information
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.priors import motion_priors
from skin2urdf.estimation.uncertainty.observability import (
    Observability,
    Subject,
    aligned_deviations,
    observability_along,
)
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.model.kinematics import to_pinocchio
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import first_derivative, second_derivative

_TREE = serial_tree(3)
_PERIOD = 10.0
_STEP = 2 * np.pi / 2**10
_CONFIGURATIONS = np.random.default_rng(6).uniform(-1.0, 1.0, (40, 3))


@cache
def _truth() -> State:
    state = random_state(np.random.default_rng(3), _TREE, 1, 0.3)
    return replace(state, up=UP[None])


def _positions(repeated: int) -> F64:
    """(N, 3) what encoders say: all joints at once, again and again."""
    rng = np.random.default_rng(4)
    t = np.arange(round(_PERIOD * repeated * RATE)) / RATE
    k = np.arange(1, 13)
    phase, size = rng.uniform(0, 6, (12, 3)), rng.normal(size=(12, 3)) / np.sqrt(k)[:, None]
    q = np.sin(2 * np.pi / _PERIOD * k[:, None] * t[:, None, None] + phase) * size
    return np.asarray(0.5 * q.sum(axis=1))


def _of_the_place(q: F64, size: float) -> F64:
    """(N, 3, 3) [m/s^2] that sensors read in excess, by where the robot is and nothing else."""
    rng = np.random.default_rng(5)
    waves, phase = 4.0 * rng.standard_normal((8, 3)), rng.uniform(0, 6, 8)
    share = rng.standard_normal((8, 3, 3)) / 2
    return np.asarray(size * np.einsum("nw,wuc->nuc", np.sin(q @ waves.T + phase), share))


def _read(q: F64, compliance: float) -> F64:
    """(N, 3, 3) readings of links on a base that turns by moments about a point below it."""
    at = to_pinocchio(_truth().model(_TREE)).jointPlacements
    middles = 0.5 * at[2].translation, 0.5 * at[3].translation, np.full(3, 0.05)
    bodies = [
        pin.Inertia(mass, middle, 0.02 * mass * np.eye(3))
        for mass, middle in zip((12.0, 8.0, 3.0), middles, strict=True)
    ]
    read, _ = readings_on_a_stand(_TREE, _truth(), bodies, q, compliance)
    return read + 1e-2 * np.random.default_rng(2).standard_normal(read.shape)


@cache
def _found(
    *, excess: float = 0.0, compliance: float = 0.0, repeated: int = 9
) -> tuple[MotionEstimate, Observability]:
    """A rigid robot on a rigid base, fitted to one that is not.

    Args:
        excess: what sensors read too much from place to place [m/s^2].
        compliance: by how much the base turns [rad/(N m)].
        repeated: how often the robot does the same.
    """
    q = _positions(repeated)
    log = sampled_trajectory(q, _read(q, compliance) + _of_the_place(q, excess))
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    found = estimate_along([log], _TREE, _truth(), priors, np.zeros(3), look_further=False)
    return found, observability_along(_subject(found), found.information)


def _subject(found: MotionEstimate) -> Subject:
    q, free = found.problem.logs[0].q, identifiable(_TREE, 1, True)
    # Turns of the SUs' own frames that cross-axis errors hide are not compared.
    sensors = Priors(cross=0.0)
    return Subject(_TREE, found.state, free, q, sensors, sensors)


def _places(state: State, q: F64) -> F64:
    """(C, 2, 3) where the SUs beyond the first joint are, whose places all readings tell."""
    plain = to_pinocchio(state.model(_TREE))
    data, out = plain.createData(), np.empty((len(q), 2, 3))
    for n, each in enumerate(q):
        pin.framesForwardKinematics(plain, data, each)
        for u in (1, 2):
            at = plain.getFrameId(_TREE.su_names[u])
            out[n, u - 1] = data.oMf[at].translation
    return out


def _stated(found: MotionEstimate, seen: Observability) -> float:
    """Error of the SUs' places to expect, root mean square [m]."""
    stated, _ = aligned_deviations(_subject(found), seen, _CONFIGURATIONS)
    return float(np.sqrt((stated[1:] ** 2).mean()))


def _true(found: MotionEstimate) -> float:
    """The same as it is; one rigid transform aligns all."""
    both = (_places(state, _CONFIGURATIONS).reshape(-1, 3) for state in (_truth(), found.state))
    true, is_ = (x - x.mean(axis=0) for x in both)
    turned = Rotation.align_vectors(true, is_)[0].apply(is_)
    return float(np.sqrt(((turned - true) ** 2).sum(axis=1).mean()))


def test_nothing_is_widened_where_nothing_is_lacking() -> None:
    found, seen = _found()
    assert 0.6 < seen.widening < 1.4
    assert 0.4 < _true(found) / _stated(found, seen) < 2


@pytest.mark.parametrize("compliance", [3e-6, 1e-5])
def test_stated_errors_hold_a_base_that_gives_way_unseen(compliance: float) -> None:
    found, seen = _found(compliance=compliance)
    assert found.misfit < 1.1
    assert _true(found) > 2 * _true(_found()[0])
    assert 0.5 < _true(found) / _stated(found, seen) < 2


def test_what_is_left_beyond_noise_makes_all_stated_errors_larger() -> None:
    found, seen = _found()
    plain = _stated(found, seen)
    for misfit, times in ((0.5, 1.0), (1.0, 1.0), (4.0, 2.0)):
        information = motion_information(found.problem, found.fitted, misfit=misfit)
        stated = _stated(found, observability_along(_subject(found), information))
        assert stated / plain == pytest.approx(times, rel=0.15)


def _stopped(steps: int) -> MotionEstimate:
    """A fit that begins centimetres and degrees off, and may take so many steps."""
    rng, (found, _) = np.random.default_rng(8), _found()
    places = found.state
    for name in ("T_parent_joint", "T_joint_su"):
        off = np.array(getattr(places, name))
        off[:, :3, :3] @= rotation_exp(0.05 * rng.standard_normal((3, 3)))
        off[:, :3, 3] += 0.05 * rng.standard_normal((3, 3))
        places = replace(places, **{name: off})
    begin = replace(found.fitted.state, placements=places)
    fitted = fit(found.problem, begin, near=True, iterations=steps)
    return replace(found, fitted=fitted, corrected=())


@pytest.mark.parametrize("steps", [1, 2, 3, 30])
def test_stated_errors_hold_a_fit_that_ran_out_of_steps(steps: int) -> None:
    stopped = _stopped(steps)
    stated = _stated(stopped, observability_along(_subject(stopped), stopped.information))
    assert 0.4 < _true(stopped) / stated < 2
    assert stopped.ahead.is_most == (steps < 3)


@cache
def _rounded() -> MotionEstimate:
    """One joint swings at a time, others yield to it by a step of their encoders or so."""
    rng = np.random.default_rng(10)
    n, move = round(4.0 * RATE), round(1.0 * RATE)
    t = np.arange(n) / RATE
    swing = 0.1 * np.sin(2 * np.pi * 1.5 * t) * np.clip(2 * np.minimum(t, t[-1] - t), 0, 1) ** 3
    q = stays(rng.uniform(-1.0, 1.0, (18, 3)), n, move)
    for part in range(18):
        follows = rng.uniform(-1.5, 1.5, 3) * _STEP / 0.1
        follows[part % 3] = 1.0
        begin = part * (n + move)
        q[begin : begin + n] += swing[:, None] * follows
    read = _read(q, 0.0)
    log = sampled_trajectory(_STEP * np.round(q / _STEP), read)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    log = replace(log, resolution=np.full(3, _STEP))
    return estimate_along([log], _TREE, _truth(), priors, np.zeros(3), look_further=False)


def test_stated_errors_hold_what_encoders_round_off() -> None:
    found = _rounded()
    stated = _stated(found, observability_along(_subject(found), found.information))
    assert 0.5 < _true(found) / stated < 2
    ignored = motion_information(found.problem, found.fitted, misfit=found.misfit)
    narrow = _stated(found, observability_along(_subject(found), ignored))
    assert _true(found) / narrow > 2


def test_errors_that_come_back_with_the_motion_do_not_average_out() -> None:
    by_noise, by_place = (
        [_stated(*_found(excess=excess, repeated=n)) for n in (3, 9)] for excess in (0.0, 1e-2)
    )
    np.testing.assert_allclose(by_noise[1] / by_noise[0], 3**-0.5, rtol=0.25)
    assert by_place[1] / by_place[0] > 0.85
    assert _found(excess=1e-2)[1].widening > 2
    # Twenty times as much is taken for noise of the samples, and does not pass for it.
    louder, seen = _found(excess=0.2)
    assert louder.fitted.noise[0].mean() > 10 * _found()[0].fitted.noise[0].mean()
    assert louder.misfit < 2 < seen.widening


def _widening_of_many(slack: float = 0.0) -> tuple[float, float]:
    """By how much errors come back, of many SUs on links whose encoders' noise all of them feel.

    Args:
        slack: by how much links are off their encoders as well, by where the robot is [rad].

    Returns:
        As it is stated, and over noise that each SU has alone.
    """
    rng = np.random.default_rng(7)
    names = tuple(f"su_{u:02}" for u in range(60))
    tree = replace(_TREE, su_names=names, su_joint=np.repeat(np.arange(3), 20))
    truth = replace(random_state(rng, tree, 1, 0.3), up=UP[None])
    q = _positions(3)
    moved = q + slack * np.sin(2.0 * q @ rng.standard_normal((3, 3)))
    speed, push = first_derivative(moved, RATE), second_derivative(moved, RATE)
    ideal = specific_forces(truth.model(tree), moved, speed, push, 9.81 * UP)
    read = np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias
    read += 1e-2 * rng.standard_normal(read.shape)
    log = sampled_trajectory(q + 2e-4 * rng.standard_normal(q.shape), read)
    priors = motion_priors(Priors(), gravity=0.0, front=(np.zeros(2), np.zeros(2)))
    found = estimate_along([log], tree, truth, priors, np.zeros(len(names)), look_further=False)
    sensors = Priors(cross=0.0)
    subject = Subject(tree, found.state, identifiable(tree, 1, True), log.q, sensors, sensors)
    moments = found.information.moments
    stated, alone = (
        observability_along(subject, replace(found.information, moments=share * moments)).widening
        for share in (1.0, 0.0)
    )
    return stated, alone


def test_noise_that_many_sus_share_does_not_come_back() -> None:
    stated, alone = _widening_of_many()
    assert stated < 2 < alone
    assert _widening_of_many(slack=2e-3)[0] > 2


def test_samples_at_one_place_and_neighbours_in_time_are_one_cluster() -> None:
    repeated = 9
    q = _positions(repeated)
    log = sampled_trajectory(q, np.zeros((len(q), 3, 3)))
    parts = clusters(_TREE, [log, log])
    (of_one, of_other), (one, other) = (
        [label[members] for members in parts.members] for label in (parts.place, parts.stretch)
    )
    assert of_one.shape == of_other.shape == log.kept.shape
    for label in (parts.place, parts.stretch):
        assert len(np.unique(label)) == CLUSTERS
    assert len(np.unique(np.stack([parts.place, parts.stretch]), axis=1).T) == len(parts.place)
    # Both logs are of the same motion, and each of them of the same one again and again.
    assert (of_one == of_other).all()
    period = round(_PERIOD / float(np.median(np.diff(log.time))))
    assert np.mean(of_one[period:] == of_one[:-period]) > 0.75
    assert (np.diff(one) >= 0).all()
    assert one.max() < other.min()
