"""Faults of SUs: each kind is named, and the rest of the robot is as good as without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from random_robots import chain, robot_of, small_arm
from simulated import PATTERNS, held_against

from skin2urdf.calibration import explanation
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import HOPELESS_FIT, Calibration
from skin2urdf.calibration.rounds import (
    Logs,
    Solution,
    Structure,
    estimate_once,
    find_structure,
    leads_nowhere,
    relinearise,
    sample_logs,
    settle,
    take_features,
)
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import InsufficientDataError
from skin2urdf.faults import Fault, distinct, without_slips
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.loose import slips
from skin2urdf.hypotheses.names import named_as_felt
from skin2urdf.hypotheses.records import Amendment
from skin2urdf.hypotheses.slip import Moment, Slipped
from skin2urdf.notes import Note
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import Simulation, SimulationSettings, load_robot, simulate
from skin2urdf.simulation.faults import FAULTS, Faulty, Sound, in_two
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.structure.activity import Activity
from skin2urdf.structure.records import KinematicTree

SETTINGS = SimulationSettings(n_poses=4, excite="all", seed=1, imu_rate=125.0, joint_rate=100.0)


FIVE_JOINTS = ("loose", "renamed")
"""Three joints leave the size of a slip open, and half of their log may explain nothing."""

CHANGES = ("loose", "stepped")
"""Kinds that are of one SU before some time, and of another one after it."""


@cache
def sound(five: bool = False) -> Sound:
    robot = load_robot("so101") if five else small_arm(3)
    return Sound(robot, SETTINGS, simulate(robot, SETTINGS))


@cache
def faulty(kind: str) -> Faulty:
    # A slip of an SU whose place the log tells, so that its size can be held against it.
    draw = 4 if kind == "loose" else 2
    whole = sound(kind in FIVE_JOINTS)
    return FAULTS[kind](whole, np.random.default_rng([draw, *kind.encode()]))


@cache
def clean(five: bool = False, slips: bool = False) -> Calibration:
    return calibrate(retimed(sound(five).recording), settings_of(slips))


@cache
def calibrated(kind: str) -> Calibration:
    logs = [retimed(recording) for recording in faulty(kind).recordings]
    return calibrate(logs, settings_of(kind in CHANGES))


def settings_of(slips: bool) -> CalibrationSettings | None:
    """All samples have a say in whether an SU changed; nothing else is asked of them here."""
    return None if slips else PATTERNS


def without(simulation: Simulation, found: Calibration, names: tuple[str, ...], to: Path) -> float:
    """Root mean square position error of all SUs but some, which align nothing either [m]."""
    sus = held_against(found, simulation.truth.urdf, to, names).sus
    errors = [su.position.rms for su in sus if su.name not in names and su.position is not None]
    return float(np.sqrt(np.mean(np.square(errors))))


def test_a_clean_recording_has_no_fault() -> None:
    found = clean(five=True, slips=True)
    assert found.faults == ()
    assert found.quality == "good"


@pytest.mark.parametrize("kind", list(FAULTS))
def test_a_fault_is_named_and_costs_the_others_nothing(kind: str, tmp_path: Path) -> None:
    injected, found = faulty(kind), calibrated(kind)
    named = {(fault.kind, fault.subject) for fault in found.faults}
    assert named == {(injected.kind, subject) for subject in injected.subjects}
    assert found.quality == "fair"
    five = kind in FIVE_JOINTS
    truth = sound(five).simulation
    error = without(truth, found, injected.subjects, tmp_path)
    least = without(truth, clean(five, kind in CHANGES), injected.subjects, tmp_path)
    # One recording of four poses: chance alone moves the ratio by some ten per cent.
    assert error < 1.5 * least + 1e-5


def test_sus_that_fit_no_place_keep_a_result_from_being_good() -> None:
    """Here two exchange their names, and a tree of the other two explains its own readings."""
    injected = FAULTS["renamed"](sound(), np.random.default_rng([7, *b"renamed"]))
    found = calibrate([retimed(recording) for recording in injected.recordings], PATTERNS)
    assert set(found.without_a_place) == set(injected.subjects)
    assert found.quality == "fair"


def test_a_slip_is_measured() -> None:
    """Its size is that of the simulated slip, and the earlier placement is an SU of its own."""
    injected = faulty("loose")
    (fault,) = calibrated("loose").faults
    distance, angle = (float(part.split()[0]) for part in injected.words.split(", "))
    assert 1e3 * fault.size == pytest.approx(distance, abs=0.5)
    assert np.rad2deg(fault.turn) == pytest.approx(angle, abs=0.15)
    assert fault.begin < fault.end
    tree, (name,) = calibrated("loose").model.tree, injected.subjects
    assert joint_of(tree, f"{name}_before") == joint_of(tree, name)


def of_six_poses(kind: str, seed: int) -> tuple[Faulty, list[Recording]]:
    """A Panda with a fault, and its logs."""
    robot = load_robot("panda")
    settings = SimulationSettings(n_poses=6, excite="all", seed=seed)
    whole = Sound(robot, settings, simulate(robot, settings))
    injected = FAULTS[kind](whole, np.random.default_rng([seed, *kind.encode()]))
    return injected, [retimed(recording) for recording in injected.recordings]


def test_names_that_one_part_of_a_log_tells_apart_are_exchanged_in_the_other() -> None:
    """The early part shows which two changed places, and the late one is explained by it."""
    injected = FAULTS["renamed"](sound(), np.random.default_rng([3, *b"renamed"]))
    found = calibrate([retimed(recording) for recording in injected.recordings], PATTERNS)
    named = {(fault.kind, fault.subject) for fault in found.faults}
    assert named == {("swapped", name) for name in injected.subjects}


def test_an_su_whose_last_joint_was_missed_in_gaps_is_put_beyond_it() -> None:
    """By what its readings fit, where their activity says otherwise."""
    injected, recordings = of_six_poses("gaps", 10282)
    (name,), clock = injected.subjects, Clock()
    logs = sample_logs(recordings, PATTERNS, clock)
    features = take_features(logs, clock)
    assert [(f.kind, f.subject) for f in features.faults] == [(injected.kind, name)]
    missed = find_structure(logs, features, clock).certain_tree
    assert joint_of(missed, name) == "panda_joint4"
    first = relinearise(logs, missed, features, clock, hopeless=leads_nowhere)
    found, _ = settle(logs, *first, clock)
    assert found.misfit < 1.3
    assert joint_of(found.tree, name) == "panda_joint5"
    assert Note("placed by fit", (name,), ("panda_joint5",), "active") in found.tree.notes


def joint_of(tree: KinematicTree, su: str) -> str:
    return tree.joint_names[tree.su_joint[tree.su_names.index(su)]]


def test_a_joint_that_gaps_have_hidden_is_no_other_branch() -> None:
    """An SU at the tip seems not to be moved by the joint before its own."""
    injected, recordings = of_six_poses("gaps", 210004)
    (name,), clock = injected.subjects, Clock()
    logs = sample_logs(recordings, PATTERNS, clock)
    features = take_features(logs, clock)
    missed = find_structure(logs, features, clock).certain_tree
    chain = {missed.joint_names[j] for j in missed.chain(missed.joint_names.index("panda_joint7"))}
    assert "panda_joint6" not in chain
    found, _ = settle(logs, *relinearise(logs, missed, features, clock), clock)
    assert joint_of(found.tree, name) == "panda_joint7"
    assert found.tree.parent.tolist() == [-1, 0, 1, 2, 3, 4, 5]
    assert found.cost_per_dof < 1.2


def test_a_slip_explains_the_pose_in_which_it_happened() -> None:
    """Readings of both placements together fit neither, and need not."""
    rng, clock = np.random.default_rng([3, *b"loose"]), Clock()
    injected = FAULTS["loose"](sound(five=True), rng)
    logs = sample_logs([retimed(each) for each in injected.recordings], PATTERNS, clock)
    features = take_features(logs, clock)
    during = np.argsort(features.span[:, 0])[7]
    coefficients = np.array(features.coefficients)
    coefficients[during, features.su_names.index(injected.subjects[0]), 0] += 10.0
    features = replace(features, coefficients=coefficients)
    tree = find_structure(logs, features, clock).certain_tree
    found = estimate_once(logs, tree, features, None, clock)
    u = tree.su_names.index(injected.subjects[0])
    (slip,) = (each for each in slips(found, np.argsort(features.span[:, 0])) if each.su == u)
    assert slip.before < during < slip.after
    of_su = float(found.chi2_by_block[:, u].sum())
    assert found.chi2_by_block[during, u] > 0.05 * of_su
    assert slip.drop == pytest.approx(of_su, rel=0.03)


def nothing(*_: object) -> Solution:
    raise InsufficientDataError("rests tell nothing", "record more of them", lacks="poses")


def test_no_physics_is_tried_for_what_leaves_more_than_any(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing has found what is wrong, fits with gears that yield take minutes."""
    monkeypatch.setattr(explanation, "KINDS", ())
    monkeypatch.setattr(explanation, "with_sus_apart", lambda *found, **_: found[:2])
    monkeypatch.setattr(explanation, "estimate_at_rest", nothing)
    injected = FAULTS["loose"](sound(), np.random.default_rng([3, *b"loose"]))
    found = calibrate([retimed(recording) for recording in injected.recordings])
    assert found.estimate.misfit > HOPELESS_FIT
    assert found.along is not None
    assert not found.along.tried


def test_a_fixed_su_does_not_slip() -> None:
    found = clean()
    order = np.arange(found.features.n_poses)
    assert slips(found.estimate, order) == ()
    # An SU without a single pose has none to slip between.
    heard = np.arange(found.estimate.tree.n_sus) > 0
    assert slips(replace(found.estimate, count=found.estimate.count * heard), order) == ()


def test_all_that_is_told_is_of_an_su_that_did_not_slip(monkeypatch: pytest.MonkeyPatch) -> None:
    """All samples have the last word about slips: goodness of fit is that of what they leave."""

    def explained(
        recordings: Sequence[Recording],
        evident: tuple[Amendment, ...],
        first: tuple[Logs, Structure, Solution | None],
        _: object,
        clock: Clock,
        *__: object,
        **___: object,
    ) -> Solution:
        search = Search(recordings, first[0].settings, clock, evident, first[0])
        (log,), name = first[0].sampled, first[1].certain_tree.su_names[-1]
        middle = (0, float(np.median(log.motion.grid.time)))
        slipped = Slipped(name, f"{name}_before", Moment(middle, middle))
        solution = search.attempt((*evident, slipped), None).solution
        assert slipped.earlier in solution.found.tree.su_names
        return replace(solution, faults=(Fault("loose", name, sus=(name, slipped.earlier)),))

    monkeypatch.setattr(explanation, "explain", explained)
    found = calibrate(retimed(sound(five=True).recording))
    assert found.faults == ()
    assert found.goodness.by_su.dof.shape == (found.model.tree.n_sus,)


@pytest.mark.parametrize("logs", [1, 2])
def test_names_swapped_on_one_segment_are_set_right(logs: int, tmp_path: Path) -> None:
    second = GivenSu("link_j2", (0.05, 0.02, 0.07), (0.3, 0.2, 1.0))
    robot = robot_of(chain(3, turns=1.4), tmp_path, SkinLayout(given=(second,)))
    both = Sound(robot, SETTINGS, simulate(robot, SETTINGS))
    names = [su.name for su in both.simulation.truth.sus if su.link == second.link]
    other = {names[0]: names[1], names[1]: names[0]}
    before, after = in_two(both)
    renamed = tuple(replace(su, name=other.get(su.name, su.name)) for su in after.sus)
    after = replace(after, sus=tuple(sorted(renamed, key=lambda su: su.name)))
    given = [before, after] if logs == 2 else [joined(before, after)]
    found = calibrate([retimed(log) for log in given], PATTERNS)
    assert {(f.kind, f.subject) for f in found.faults} == {("swapped", name) for name in names}
    assert found.estimate.misfit < 1.5


def joined(first: Recording, second: Recording) -> Recording:
    """Two parts of a log as one."""
    after = second.start - first.start

    def times(a: SuStream | JointStream, b: SuStream | JointStream) -> np.ndarray:
        return np.concatenate([a.time, b.time + after])

    joints = tuple(
        replace(a, time=times(a, b), position=np.concatenate([a.position, b.position]))
        for a, b in zip(first.joints, second.joints, strict=True)
    )
    sus = tuple(
        replace(
            a,
            time=times(a, b),
            specific_force=np.concatenate([a.specific_force, b.specific_force]),
        )
        for a, b in zip(first.sus, second.sus, strict=True)
    )
    return replace(first, joints=joints, sus=sus)


@pytest.mark.parametrize("segment", [0, 2])
def test_an_su_may_be_mirrored_on_any_segment(segment: int) -> None:
    # Across a level first axis, its SU negated would read as one with a bias.
    made = simulate(small_arm(3), replace(SETTINGS, base_rpy=(-0.9, 0.0, 0.0)))
    (name,) = (su.name for su in made.truth.sus if su.joint == segment)
    log = made.recording
    negated = tuple(
        replace(su, specific_force=-su.specific_force) if su.name == name else su for su in log.sus
    )
    found = calibrate(retimed(replace(log, sus=negated)), PATTERNS)
    assert [(f.kind, f.subject) for f in found.faults] == [("mirrored", name)]
    assert found.estimate.misfit < 1.5


def test_two_logs_of_a_sound_robot_have_no_fault() -> None:
    assert calibrate([retimed(log) for log in in_two(sound())]).faults == ()


# Streams alone.


def test_names_go_where_the_tree_says_what_their_sus_feel() -> None:
    """Also beside a bit that is wrong, and only where it makes a difference."""
    joints = ("a", "b", "c")
    tree = KinematicTree(
        joints, np.array([-1, 0, 1]), ("revolute",) * 3, ("s", "t", "u", "v"),
        np.array([0, 1, 2, 2]),
    )  # fmt: skip
    felt = np.array([[1, 1, 0], [1, 0, 0], [1, 1, 1], [1, 1, 1]])
    dynamic = np.where(felt, 20.0, 0.05)
    dynamic[2, 2] = 0.9
    seen = Activity(
        tree.su_names, joints, np.full((4, 3), np.nan), dynamic, np.zeros(3),
        np.ones(3, dtype=bool), np.ones(4, dtype=bool),
    )  # fmt: skip
    np.testing.assert_array_equal(named_as_felt(tree, seen).su_joint, [1, 0, 2, 2])
    same = replace(seen, dynamic=dynamic[[1, 0, 2, 3]])
    np.testing.assert_array_equal(named_as_felt(tree, same).su_joint, tree.su_joint)


def test_each_fault_is_told_once() -> None:
    a, b = Fault("dead", "su_1", log=0), Fault("dead", "su_2", log=0)
    assert distinct([a, b, replace(a, log=1)]) == (a, b)


def test_what_only_a_slipping_su_felt_is_no_contact() -> None:
    slip = Fault("loose", "su_1", sus=("su_1", "su_1_before"))
    same = Fault("contact", "joint_7", sus=("su_1",))
    hit = Fault("contact", "joint_2", sus=("su_1", "su_2"))
    assert without_slips([same, slip, hit]) == (slip, hit)
    assert without_slips([same, hit]) == (same, hit)


def test_the_slip_of_a_recording_is_drawn_anew_by_its_generator() -> None:
    def words(seed: int) -> str:
        return FAULTS["silent"](sound(), np.random.default_rng(seed)).words

    assert words(0) == words(0) != words(1)


def test_two_logs_hold_all_of_the_recording() -> None:
    first, second = in_two(sound())
    whole: Recording = sound().recording
    for i, su in enumerate(whole.sus):
        assert len(first.sus[i].time) + len(second.sus[i].time) == len(su.time)
    assert second.joints[0].time[0] >= 0.0
