"""Evidence of activity, from features made by Pinocchio's Jacobians and from recordings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated import changed_sus, features_of, simulation
from synthetic import random_features, random_state, random_tree, serial_tree

from skin2urdf.arrays import Bool
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.simulation import Simulation
from skin2urdf.structure.activity import CERTAIN, STATIC_THRESHOLD, activity


def true_activity(sim: Simulation, features: Features) -> Bool:
    """(U, D) activity of a serial robot of the simulation."""
    joint = {su.name: su.joint for su in sim.truth.sus}
    position = [sim.truth.joint_names.index(n) for n in features.dof_names]
    return np.array([[d <= joint[name] for d in position] for name in features.su_names])


@pytest.mark.parametrize(
    ("robot", "options"),
    [
        ("panda", {}),
        ("panda", {"upright": True, "excite": "all"}),
        ("ur5", {"upright": True}),
        ("so101", {"excite": "all", "grade": "bma150"}),
        ("kinova", {"grade": "bma150", "upright": True}),
    ],
)
def test_every_bit_is_right(robot: str, options: dict[str, Any]) -> None:
    sim = simulation(robot, **options)
    features = features_of(sim.recording)
    seen = activity(features)
    np.testing.assert_array_equal(seen.matrix, true_activity(sim, features))
    assert seen.excited.all()
    assert seen.heard.all()
    assert np.isfinite(seen.evidence).all()


def test_a_vertical_axis_is_seen_by_its_pattern_only() -> None:
    """Gravity can not see axis 1 of an upright arm (design, structure)."""
    sim = simulation("ur5", upright=True)
    features = features_of(sim.recording)
    seen = activity(features)
    first = features.dof_names.index(sim.truth.joint_names[0])
    moving = [u for u, n in enumerate(features.su_names) if _joint(sim, n) >= 0]
    assert np.nanmax(seen.static[:, first]) < 1.0
    assert (seen.dynamic[moving, first] > 1.0).all()


@pytest.mark.parametrize("moved", [True, False])
def test_what_is_certain_outweighs_the_evidence(moved: bool) -> None:
    features = features_of(simulation("ur5").recording)
    seen = activity(features)
    su, dof = (int(i[0]) for i in np.nonzero(seen.matrix != moved))
    told = seen.moved_by(features.su_names[su], features.dof_names[dof], moved)
    changed = told.matrix != seen.matrix
    assert changed[su, dof]
    assert changed.sum() == 1
    assert abs(told.evidence[su, dof]) > CERTAIN


def test_a_tree_outweighs_the_evidence() -> None:
    rng = np.random.default_rng(3)
    tree, other = random_tree(rng, 5, 5), serial_tree(5)
    features = random_features(rng, tree, random_state(rng, tree), 6, noise=0.02)
    told = activity(features).as_in(other)
    su = [told.su_names.index(name) for name in other.su_names]
    dof = [told.dof_names.index(name) for name in other.joint_names]
    np.testing.assert_array_equal(told.matrix[np.ix_(su, dof)], other.activity())
    assert (np.abs(told.evidence) > CERTAIN).all()


def _joint(sim: Simulation, name: str) -> int:
    return next(su.joint for su in sim.truth.sus if su.name == name)


@pytest.mark.parametrize("seed", range(6))
def test_trees_of_any_shape_show_their_activity_in_features_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, 7, 9, prismatic=0.2)
    features = random_features(rng, tree, random_state(rng, tree, intrinsics=0.2), 6, noise=0.02)
    seen = activity(features)
    su = [seen.su_names.index(n) for n in tree.su_names]
    dof = [seen.dof_names.index(n) for n in tree.joint_names]
    np.testing.assert_array_equal(seen.matrix[np.ix_(su, dof)], tree.activity())
    assert np.isnan(seen.static).all()


def still(features: Features) -> Features:
    """Features in which no pattern was felt."""
    coefficients = features.coefficients.copy()
    coefficients[:, :, 1:] = 0.0
    return replace(features, coefficients=coefficients)


def with_moves(
    features: Features, dof: int, changes: list[float], doubt: float = 0.142
) -> Features:
    """Features with one static move of a DoF, which changes the reading of each SU so much.

    Other joints moved along, which can have changed readings by ``doubt`` [m/s^2]: by a little less
    than what makes the threshold of the paper doubtful.
    """
    change = np.array(changes)[None, :, None] * np.array([0.0, 0.6, 0.8])
    moves = StaticMoves(np.array([dof]), np.array([0.8]), change, np.array([doubt]))
    return replace(features, moves=moves)


@pytest.fixture
def quiet() -> Features:
    rng = np.random.default_rng(0)
    tree = serial_tree(3)
    plain = random_features(rng, tree, random_state(rng, tree), 4, noise=0.02, shuffle=False)
    return still(plain)


def test_the_static_threshold_is_that_of_the_paper(quiet: Features) -> None:
    above, below = 1.05 * STATIC_THRESHOLD, 0.95 * STATIC_THRESHOLD
    assert pytest.approx(0.05 * 9.81) == STATIC_THRESHOLD
    seen = activity(with_moves(quiet, 1, [0.0, above, above]))
    np.testing.assert_array_equal(seen.matrix[:, 1], [False, True, True])
    seen = activity(with_moves(quiet, 1, [0.0, below, below]))
    assert not seen.matrix[:, 1].any()
    seen = activity(with_moves(quiet, 1, [0.0, below, below]), threshold=0.8 * below)
    np.testing.assert_array_equal(seen.matrix[:, 1], [False, True, True])


def test_a_move_of_one_joint_alone_counts_below_the_threshold(quiet: Features) -> None:
    """Axis 1 of an arm that stands almost upright turns gravity by little."""
    little = 0.3 * STATIC_THRESHOLD
    seen = activity(with_moves(quiet, 1, [0.0, little, little], doubt=0.0))
    np.testing.assert_array_equal(seen.matrix[:, 1], [False, True, True])
    seen = activity(with_moves(quiet, 1, [0.0, little, little], doubt=0.15))
    assert not seen.matrix[:, 1].any()


def test_sag_of_other_joints_is_not_taken_for_activity(quiet: Features) -> None:
    """A DoF turns gravity by the same angle in all SUs beyond it; sag turns it by far less."""
    g = 9.81
    seen = activity(with_moves(quiet, 2, [0.06 * g, 0.07 * g, 0.7 * g]))
    np.testing.assert_array_equal(seen.matrix[:, 2], [False, False, True])


def test_what_other_joints_can_have_changed_more_does_not_outweigh_patterns() -> None:
    """Joint 1 is upright; in its only move the last joint turned the last SU by far more."""
    rng = np.random.default_rng(0)
    tree = serial_tree(3)
    plain = random_features(rng, tree, random_state(rng, tree), 4, noise=0.02, shuffle=False)
    seen = activity(with_moves(plain, 0, [0.0, 0.0, 2.5], doubt=3.0))
    np.testing.assert_array_equal(seen.matrix, activity(plain).matrix)
    # Without patterns such a move says nothing.
    assert not activity(with_moves(still(plain), 0, [0.0, 0.0, 2.5], doubt=3.0)).matrix.any()


def test_an_su_without_a_reading_of_a_move_is_undecided_by_it(quiet: Features) -> None:
    seen = activity(with_moves(quiet, 0, [np.nan, 4.0, 4.0]))
    assert np.isnan(seen.static[0, 0])
    assert not seen.matrix[0, 0]
    np.testing.assert_array_equal(seen.matrix[1:, 0], [True, True])


def test_a_dof_that_turns_no_gravity_is_undecided_and_not_out_of_the_tree_of_others(
    quiet: Features,
) -> None:
    """Gravity alone can not tell an upright first axis from one that carries nothing."""
    unfelt = replace(quiet, information=quiet.information.scaled(np.r_[1.0, np.zeros(6)]))
    seen = activity(with_moves(unfelt, 1, [0.0, 0.01, 0.01], doubt=0.0))
    assert seen.tested[:, 1].all()
    assert not seen.evidence[:, 1].any()


def test_moves_say_together_what_one_of_them_would_say_wrongly(quiet: Features) -> None:
    """In the second move another joint turned the first SU as well, and so it counts for less."""
    g = 9.81
    change = np.array([[0.0, 0.5, 0.5], [0.2, 0.5, 0.5]]) * g
    moves = StaticMoves(
        np.array([1, 1]), np.ones(2), change[..., None] * np.array([0.0, 0.6, 0.8]),
        np.array([0.0, 0.2 * g]),
    )  # fmt: skip
    seen = activity(replace(quiet, moves=moves))
    np.testing.assert_array_equal(seen.matrix[:, 1], [False, True, True])
    assert abs(seen.evidence[0, 1]) > CERTAIN


def test_an_su_recorded_in_weak_moves_alone_is_not_taken_to_be_moved(quiet: Features) -> None:
    """The first log has no SU beyond the DoF, the second has no SU before it."""
    nan = np.nan
    change = np.array([[0.01, 0.02, nan], [nan, nan, 5.0]])
    moves = StaticMoves(
        np.array([1, 1]), np.ones(2), change[..., None] * np.array([0.0, 0.6, 0.8]), np.zeros(2)
    )
    seen = activity(replace(quiet, moves=moves))
    np.testing.assert_array_equal(seen.matrix[:, 1], [False, False, True])


def test_a_dof_that_moved_unmeasured_did_not_keep_still(quiet: Features) -> None:
    nothing = replace(quiet, information=quiet.information.scaled(np.r_[1.0, np.zeros(6)]))
    moves = StaticMoves(
        np.zeros(0), np.zeros(0), np.zeros((0, 3, 3)), moved=np.array([True, False, True])
    )
    seen = activity(replace(nothing, moves=moves))
    np.testing.assert_array_equal(seen.excited, [True, False, True])
    assert not seen.tested.any()


def test_a_dof_that_never_moved_is_not_excited(quiet: Features) -> None:
    moving = np.ones(7)
    moving[[2, 5]] = 0.0
    seen = activity(replace(quiet, information=quiet.information.scaled(moving)))
    np.testing.assert_array_equal(seen.excited, [True, False, True])
    assert not seen.matrix[:, 1].any()


def test_a_silent_su_is_not_heard() -> None:
    sim = simulation("panda")
    odd = sim.recording.sus[4].name

    def silenced(su: SuStream) -> SuStream:
        if su.name != odd:
            return su
        return replace(su, time=su.time[:3], specific_force=su.specific_force[:3])

    features = features_of(changed_sus(sim.recording, silenced))
    seen = activity(features)
    u = features.su_names.index(odd)
    assert not seen.heard[u]
    assert seen.heard.sum() == features.n_sus - 1
    others = [i for i in range(features.n_sus) if i != u]
    np.testing.assert_array_equal(seen.matrix[others], true_activity(sim, features)[others])
