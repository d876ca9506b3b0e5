"""Of trees that rests and moves do not tell apart, all samples tell which one is right."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from random_robots import small_arm
from simulated import features_of, simulation_of, tree_of

from skin2urdf.calibration import at_rest, rounds
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.rounds import Logs, Structure, find_structure, sample_logs, take_features
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import StructureError
from skin2urdf.notes import of_kind
from skin2urdf.recording.records import Recording
from skin2urdf.structure.from_motion import MotionTree, doubt, trees_of_both_kinds
from skin2urdf.structure.records import KinematicTree


@pytest.fixture(scope="module")
def moved() -> tuple[Logs, Structure]:
    made = simulation_of(small_arm(3), excite="none", minutes=0.8)
    clock = Clock(None)
    logs = sample_logs([made.recording], CalibrationSettings(), clock)
    return logs, find_structure(logs, take_features(logs, clock), clock)


def one_joint_less(found: MotionTree) -> MotionTree:
    """The same tree, but for an SU that sits on the segment before its own."""
    tree = found.tree
    u = next(u for u, joint in enumerate(tree.su_joint) if tree.parent[joint] >= 0)
    su_joint = tree.su_joint.copy()
    su_joint[u] = tree.parent[su_joint[u]]
    return replace(found, tree=replace(tree, su_joint=su_joint))


@pytest.mark.parametrize("wrong_first", [True, False])
def test_all_samples_tell_which_of_several_trees_is_right(
    moved: tuple[Logs, Structure], wrong_first: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs, structure = moved
    right = trees_of_both_kinds(logs.sampled, logs.su_names)[0][0]
    wrong = one_joint_less(right)
    first, second = (wrong, right) if wrong_first else (right, wrong)
    notes = (*first.tree.notes, doubt(first.tree, second.tree))
    told = replace(first, tree=replace(first.tree, notes=notes))

    def found(*_: Any, **__: Any) -> list[tuple[MotionTree, ...]]:
        return [(told, second)]

    monkeypatch.setattr(at_rest, "trees_of_both_kinds", found)
    solution = at_rest.estimate_at_rest(logs, structure, Clock(None))
    assert solution.found.tree.is_like(right.tree)
    assert not of_kind(solution.found.tree.notes, "other order")


@pytest.fixture
def contradicted(monkeypatch: pytest.MonkeyPatch) -> tuple[Recording, KinematicTree]:
    """A recording of patterns that contradict every tree from now on, and the right one."""
    made = simulation_of(small_arm(3), n_poses=3, seed=5, imu_rate=250.0, joint_rate=125.0)
    true = tree_of(features_of(made.recording))

    def refused(*_: Any) -> None:
        raise StructureError("no tree")

    monkeypatch.setattr(rounds, "kinematic_tree", refused)
    return made.recording, true


def test_where_patterns_contradict_every_tree_moves_are_asked(
    contradicted: tuple[Recording, KinematicTree],
) -> None:
    """What was taken for patterns may have been none: rests and moves show a tree all the same."""
    recording, true = contradicted
    found = calibrate(recording)
    assert found.model.tree.is_like(true)
    assert found.quality == "good"


def test_an_su_that_changed_does_not_hide_what_moves_say(
    contradicted: tuple[Recording, KinematicTree],
) -> None:
    recording, _ = contradicted
    su = recording.sus[0]
    force = su.specific_force + 0.2 * (np.arange(len(su.time))[:, None] > 0.6 * len(su.time))
    stepped = replace(su, specific_force=force)
    found = calibrate(replace(recording, sus=(stepped, *recording.sus[1:])))
    assert [(fault.kind, fault.subject) for fault in found.faults] == [("bias step", su.name)]
