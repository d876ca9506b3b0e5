"""Motion of a base, made of what an SU on it feels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic import RATE, motion_state, sampled_trajectory, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.felt_on_the_base import (
    UNIT,
    Felt,
    Numbers,
    about,
    felt_as_it_yields,
    felt_on_the_base,
    motion_of,
)
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.signals.filters import filtered, low_pass, second_derivative
from skin2urdf.signals.trajectory import Trajectory

_RATE, _DEPTH, _G = 50.0, 0.8, 9.81
_TIME = np.arange(0.0, 40.0, 1 / _RATE)
_EDGE = slice(200, -200)
"""What is far from the ends, where filters are mirrored."""


def _felt(s: F64, by_loads: F64 | float = 0.0) -> Felt:
    return Felt(s, s, np.zeros_like(s) + by_loads, _RATE, 1, len(s), np.array([0.0, 0.0, _G]))


def _standing() -> State:
    """Two joints and an SU on the base."""
    T = np.tile(np.eye(4), (2, 1, 1))
    return State(T, T[:1], np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 3)), np.zeros((1, 6)))


def _log(s: F64) -> Trajectory:
    """Of two joints that stand and an SU on the base that feels this beside gravity."""
    return sampled_trajectory(np.zeros((len(s), 2)), s[:, None] + [0.0, 0.0, _G])


def _rocking() -> tuple[F64, F64]:
    """(N, 3) turns about a point below [rad], and what the frame feels beside gravity [m/s^2]."""
    e = np.zeros((len(_TIME), 3))
    e[:, 0] = 2e-3 * np.sin(2 * np.pi * 0.5 * _TIME + 1.0)
    e[:, 1] = 1e-3 * np.sin(2 * np.pi * 0.8 * _TIME)
    f = np.array([0.0, 0.0, _G])
    turned = np.array([rotation_exp(-each) @ f for each in e]) - f
    return e, turned + np.cross(second_derivative(e, _RATE), [0.0, 0.0, _DEPTH])


def test_a_base_that_rocks_about_a_point_turns_as_it_does() -> None:
    """Mixtures of turns about the points that are tried are turns about any between them."""
    e, s = _rocking()
    felt = _felt(s)
    turns = felt.turns.reshape(len(s), -1, 3)
    for axis, by in ((0, 1), (1, 0)):
        columns = turns[_EDGE, :3, by]
        share, *_ = np.linalg.lstsq(columns, e[_EDGE, axis], rcond=None)
        np.testing.assert_allclose(columns @ share, e[_EDGE, axis], atol=0.03 * np.ptp(e[:, axis]))


def test_what_an_su_on_the_base_feels_is_what_its_motion_makes() -> None:
    """Whatever turns are taken for it: the frame moves so that the SU feels it all the same."""
    _, s = _rocking()
    felt, none = _felt(s), Numbers.none(Priors())
    rng = np.random.default_rng(1)
    x = np.zeros(none.n_numbers)
    x[11:] = none.spread[11:] * 0.3 * rng.standard_normal(none.n_numbers - 11)
    numbers = replace(none, x=x)
    moved = motion_of(felt, numbers)
    d, e = moved[:, :3], moved[:, 3:]
    tilted = -np.cross(e, felt.f)
    there = second_derivative(d, _RATE) + tilted
    there += np.cross(second_derivative(e, _RATE), numbers.place)
    np.testing.assert_allclose(there[_EDGE], s[_EDGE], atol=0.01 * np.abs(s).max())


def test_what_a_known_motion_of_the_base_is_felt_as() -> None:
    """The frame rocks about a point below, and one SU is on it."""
    e, s = _rocking()
    d = np.cross(e, [0.0, 0.0, _DEPTH])
    unseen = Unseen(
        np.array([2]), (np.zeros((len(e), 1)),), settled=(np.hstack([0 * e[:, :2], d, e]),)
    )
    log = replace(_log(np.zeros_like(s)), rate=_RATE)
    state = motion_state(_standing(), np.zeros(1))
    ((made, turned),) = felt_as_it_yields(unseen, [log], state, np.array([0]))
    np.testing.assert_allclose(turned, e - e.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(
        made[_EDGE], (s - s.mean(axis=0))[_EDGE], atol=0.02 * np.abs(s).max()
    )


def test_what_loads_explain_is_heard_though_it_hides_in_noise() -> None:
    """A base moves with the robot, in the middle of the band by half as much as an SU has noise."""
    rng = np.random.default_rng(4)
    noise = 0.05 * rng.standard_normal((8000, 3))
    s = filtered(0.025 * rng.standard_normal(noise.shape), low_pass(2.0, RATE))
    log = _log(s + noise)
    # Motions are low-passed once.
    s = filtered(s, log.taps)

    def share(of_loads: F64 | None) -> float:
        by_loads = None if of_loads is None else [(of_loads, np.zeros_like(s))]
        (felt,) = felt_on_the_base([log], _standing(), _G, np.array([0]), by_loads)
        true = s[:: felt.step][20:-20]
        return float(np.sum(felt.likeliest[20:-20] * true) / np.sum(true**2))

    assert share(s) > 0.8 > share(None) + 0.15
    # Loads that stand for what moves it besides say nothing of it.
    other = filtered(0.025 * rng.standard_normal(noise.shape), low_pass(2.0, RATE))
    assert abs(share(other) - share(None)) < 0.1


def test_turns_by_loads_are_taken_whatever_is_felt_and_when() -> None:
    """Two shifts and a turn hide it in what one SU feels; loads make it without noise."""
    e, s = _rocking()
    felt, none = _felt(0.1 * s[::-1], e), Numbers.none(Priors())
    x = np.zeros(none.n_numbers)
    x[9:11] = 0.01, 0.02
    x[-12:-3] = np.eye(3).ravel()
    np.testing.assert_allclose(motion_of(felt, replace(none, x=x))[:, 3:], e, atol=1e-12)


def test_slopes_are_those_of_differences() -> None:
    e, s = _rocking()
    felt, none, tree = _felt(s, e), Numbers.none(Priors()), serial_tree(2)
    rng = np.random.default_rng(2)
    numbers = none.at(0.3 * UNIT * rng.standard_normal(none.n_numbers))
    motion = about(tree, [felt], numbers)
    assert motion.n_numbers == none.n_numbers
    np.testing.assert_allclose(motion.settled[0][:, 2:], motion_of(felt, numbers))
    for n in range(none.n_numbers):
        more = 1e-3 * UNIT * (np.arange(none.n_numbers) == n)
        expected = motion_of(felt, none.at(motion.origin + more)) - motion_of(felt, numbers)
        found = np.zeros_like(expected)
        mine = motion.number == n
        np.add.at(found.T, motion.joint[mine] - 2, 1e-3 * UNIT * motion.motions[0].T[mine])
        np.testing.assert_allclose(found, expected, atol=1e-9 + 1e-6 * np.abs(expected).max())
