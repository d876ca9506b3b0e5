"""From activity to a tree: nesting, repair, refusal, joint types."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from simulated import changed_sus, features_of, simulation, simulation_of, tree_of
from synthetic import random_features, random_state, random_tree, serial_tree

from skin2urdf.arrays import F64, Bool
from skin2urdf.errors import StructureError
from skin2urdf.notes import Detail, Note, of_kind
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.records import Features
from skin2urdf.simulation import RobotSpec, Simulation
from skin2urdf.structure.activity import Activity, activity
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.tree import kinematic_tree, nested

SURE = 3.0
"""Evidence no repair touches."""

TWO_ARMS = """<?xml version="1.0"?>
<robot name="two_arms">
  <link name="stand"/>
  {links}
  <joint name="lift" type="prismatic"><origin xyz="0 0 0.4"/>
    <parent link="stand"/><child link="torso"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.5" effort="500" velocity="1"/></joint>
  <joint name="left_1" type="revolute"><origin xyz="0 0.2 0.3" rpy="0.2 0 0"/>
    <parent link="torso"/><child link="left_upper"/><axis xyz="0 1 0"/>{turn}</joint>
  <joint name="left_2" type="revolute"><origin xyz="0.3 0 0"/>
    <parent link="left_upper"/><child link="left_lower"/><axis xyz="0 0 1"/>{turn}</joint>
  <joint name="right_1" type="revolute"><origin xyz="0 -0.2 0.3"/>
    <parent link="torso"/><child link="right_upper"/><axis xyz="1 0 0"/>{turn}</joint>
  <joint name="right_2" type="revolute"><origin xyz="0.3 0 0"/>
    <parent link="right_upper"/><child link="right_lower"/><axis xyz="0 1 0"/>{turn}</joint>
</robot>
""".format(
    turn='<limit lower="-2" upper="2" effort="100" velocity="3"/>',
    links="".join(
        f'<link name="{n}"><inertial><origin xyz="0.15 0 0"/><mass value="1"/><inertia ixx="0.01"'
        ' ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>'
        for n in ("torso", "left_upper", "left_lower", "right_upper", "right_lower")
    ),
)
"""A prismatic lift that carries two arms."""


@pytest.fixture(scope="module")
def two_arms(tmp_path_factory: pytest.TempPathFactory) -> Simulation:
    path = tmp_path_factory.mktemp("robot") / "two_arms.urdf"
    path.write_text(TWO_ARMS)
    return simulation_of(RobotSpec("two_arms", path), seed=2)


def true_chains(truth_urdf: str, su_names: Sequence[str]) -> dict[str, list[str]]:
    """Names of the joints before every SU, from the RS outwards."""
    model = pin.buildModelFromXML(truth_urdf)
    return {
        name: [
            model.names[j]
            for j in list(model.supports[model.frames[model.getFrameId(name)].parentJoint])[1:]
        ]
        for name in su_names
    }


def chains(tree: KinematicTree) -> dict[str, list[str]]:
    return {
        name: [tree.joint_names[j] for j in tree.chain(int(joint))]
        for name, joint in zip(tree.su_names, tree.su_joint, strict=True)
    }


@pytest.mark.parametrize(
    ("robot", "options"),
    [
        ("panda", {}),
        ("panda", {"upright": True}),
        ("ur10", {"excite": "all"}),
        ("z1", {"excite": "all", "upright": True}),
        ("xarm7", {"grade": "bma150"}),
        ("so101", {"grade": "bma150", "upright": True, "excite": "all"}),
        ("panda", {"sus_per_segment": 2, "sus_on_base": 2}),
    ],
)
def test_the_tree_of_an_arm_is_right(robot: str, options: dict[str, Any]) -> None:
    sim = simulation(robot, **options)
    tree = tree_of(features_of(sim.recording))
    assert chains(tree) == true_chains(sim.truth.urdf, tree.su_names)
    assert set(tree.joint_types) == {"revolute"}
    assert tree.notes == ()


def test_a_lift_with_two_arms(two_arms: Simulation) -> None:
    tree = tree_of(features_of(two_arms.recording))
    assert chains(tree) == true_chains(two_arms.truth.urdf, tree.su_names)
    types = dict(zip(tree.joint_names, tree.joint_types, strict=True))
    assert types.pop("lift") == "prismatic"
    assert set(types.values()) == {"revolute"}


def test_sus_at_the_tips_leave_the_order_of_a_segments_joints_open(two_arms: Simulation) -> None:
    """Joints with the same SUs beyond them form one multi-DoF joint."""
    full = true_chains(two_arms.truth.urdf, [s.name for s in two_arms.recording.sus])
    tips = {name for name, chain in full.items() if len(chain) == 3}
    recording = changed_sus(two_arms.recording, lambda su: su if su.name in tips else None)
    tree = tree_of(features_of(recording))
    assert {name: set(chain) for name, chain in chains(tree).items()} == {
        name: set(full[name]) for name in tips
    }
    assert {chain[0] for chain in chains(tree).values()} == {"lift"}
    assert of_kind(tree.notes, "bare base")


@pytest.mark.parametrize("seed", range(5))
def test_random_trees_from_features_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_tree(rng, 8, 10, prismatic=0.25)
    state = random_state(rng, truth, intrinsics=0.2)
    features = random_features(rng, truth, state, 8, noise=0.02)
    tree = tree_of(features)
    expected = {name: set(chain) for name, chain in chains(truth).items()}
    assert {name: set(chain) for name, chain in chains(tree).items()} == expected
    kind = dict(zip(truth.joint_names, truth.joint_types, strict=True))
    assert all(kind[n] == t for n, t in zip(tree.joint_names, tree.joint_types, strict=True))
    assert (tree.parent < np.arange(tree.n_joints)).all()


def seen(evidence: F64, heard: Bool | None = None, excited: Bool | None = None) -> Activity:
    """Activity whose evidence is the given one."""
    U, D = evidence.shape
    return Activity(
        tuple(f"su{u}" for u in range(U)),
        tuple(f"joint{d}" for d in range(D)),
        np.full((U, D), np.nan),
        np.exp(evidence),
        np.ones(D),
        np.ones(D, dtype=bool) if excited is None else excited,
        np.ones(U, dtype=bool) if heard is None else heard,
    )


def features_like(activity: Activity) -> Features:
    """Any features with the names of an activity matrix; they decide joint types only."""
    rng = np.random.default_rng(0)
    U, D = activity.matrix.shape
    tree = serial_tree(D)
    tree = KinematicTree(
        tree.joint_names, tree.parent, tree.joint_types,
        tuple(f"su{u}" for u in range(U)), np.full(U, D - 1),
    )  # fmt: skip
    return random_features(rng, tree, random_state(rng, tree), 3, noise=0.02, shuffle=False)


def built(activity: Activity) -> KinematicTree:
    return kinematic_tree(activity, features_like(activity))


def serial_evidence(n: int, size: float = SURE) -> F64:
    """Evidence of a chain with one SU on the base and one on every segment."""
    return np.where(np.arange(n + 1)[:, None] > np.arange(n), size, -size)


@given(n=st.integers(3, 7), data=st.data())
@settings(max_examples=60, deadline=None)
def test_one_uncertain_wrong_bit_is_repaired_and_said(n: int, data: st.DataObject) -> None:
    evidence = serial_evidence(n)
    truth = evidence > 0
    u, d = data.draw(st.integers(1, n)), data.draw(st.integers(0, n - 1))
    evidence[u, d] = -np.sign(evidence[u, d]) * 0.2
    bits, notes = nested(evidence, [f"su{i}" for i in range(n + 1)], [f"j{i}" for i in range(n)])
    wrong = (evidence > 0) != truth
    if notes:
        np.testing.assert_array_equal(bits, truth)
        taken: Detail = "active" if truth[u, d] else "inactive"
        assert notes == [Note("undecided", (f"su{u}",), (f"j{d}",), taken)]
    else:
        # Another tree altogether fits the changed bits: nothing contradicts them.
        np.testing.assert_array_equal(bits, evidence > 0)
        assert wrong.sum() == 1
        _assert_nested(bits)


def _assert_nested(bits: Bool) -> None:
    for a in bits.T:
        for b in bits.T:
            assert not ((a & b).any() and (a & ~b).any() and (b & ~a).any())


def test_a_wrong_bit_in_a_chain_ends_in_the_right_tree() -> None:
    """The third SU misses the first DoF, by a hair."""
    evidence = serial_evidence(4)
    evidence[3, 0] = -0.1
    tree = built(seen(evidence))
    np.testing.assert_array_equal(tree.su_joint, [-1, 0, 1, 2, 3])
    np.testing.assert_array_equal(tree.parent, [-1, 0, 1, 2])
    assert Note("undecided", ("su3",), ("joint0",), "active") in tree.notes


def test_contradicting_bits_that_are_certain_are_refused_by_name() -> None:
    """A closed loop: su1 moves with joint0 and joint1, su0 and su2 with one of them each."""
    evidence = np.array([[SURE, -SURE, -SURE], [SURE, SURE, -SURE], [-SURE, SURE, -SURE]])
    evidence = np.vstack([evidence, [-SURE, -SURE, SURE]])
    with pytest.raises(StructureError) as caught:
        built(seen(evidence))
    assert set(caught.value.dofs) == {"joint0", "joint1"}
    assert set(caught.value.sus) <= {"su0", "su1", "su2"}
    assert caught.value.sus
    assert "joint0" in str(caught.value)
    assert "mimic" in caught.value.remedy
    assert caught.value.exit_status == 1


@given(st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_whatever_is_accepted_nests(seed: int) -> None:
    rng = np.random.default_rng(seed)
    evidence = rng.normal(0, 1.0, (rng.integers(1, 7), rng.integers(1, 6)))
    sus = [f"su{i}" for i in range(len(evidence))]
    dofs = [f"j{i}" for i in range(evidence.shape[1])]
    refused: list[StructureError] = []
    try:
        bits, notes = nested(evidence, sus, dofs)
    except StructureError as error:
        refused.append(error)
    if refused:
        assert set(refused[0].sus) <= set(sus)
        assert refused[0].remedy
        return
    _assert_nested(bits)
    changed = (bits != (evidence > 0)).sum()
    assert changed <= len(notes)
    # What is certain stays.
    certain = abs(evidence) > np.log(4.0)
    assert (bits == (evidence > 0))[certain].all()


def test_a_dof_that_no_su_feels_is_left_out_and_said() -> None:
    evidence = serial_evidence(4)[:-1]
    tree = built(seen(evidence))
    assert tree.joint_names == ("joint0", "joint1", "joint2")
    assert Note("joint left out", joints=("joint3",), detail="felt by none") in tree.notes


def test_a_dof_that_never_moved_is_left_out_with_another_word() -> None:
    evidence = serial_evidence(4)[:-1]
    tree = built(seen(evidence, excited=np.array([True, True, True, False])))
    assert Note("joint left out", joints=("joint3",), detail="never moved") in tree.notes


def test_an_su_without_readings_is_left_out_and_said() -> None:
    evidence = serial_evidence(3)
    heard = np.array([True, True, False, True])
    tree = built(seen(evidence, heard=heard))
    assert tree.su_names == ("su0", "su1", "su3")
    assert Note("su left out", ("su2",), detail="no readings") in tree.notes
    np.testing.assert_array_equal(tree.su_joint, [-1, 0, 2])


def test_no_activity_at_all_is_an_error_in_words() -> None:
    with pytest.raises(StructureError) as caught:
        built(seen(np.full((3, 2), -SURE)))
    assert caught.value.sus == caught.value.dofs == ()  # none contradicts another
    assert caught.value.remedy


def test_a_dropped_su_leaves_a_tree_with_a_bare_segment() -> None:
    sim = simulation("panda")
    names = [s.name for s in sim.recording.sus]
    full = true_chains(sim.truth.urdf, names)
    gone = next(name for name, chain in full.items() if len(chain) == 3)

    def keep(su: SuStream) -> SuStream | None:
        return None if su.name == gone else su

    tree = tree_of(features_of(changed_sus(sim.recording, keep)))
    found, expected = chains(tree), {n: c for n, c in full.items() if n != gone}
    assert {n: set(c) for n, c in found.items()} == {n: set(c) for n, c in expected.items()}
    assert gone not in tree.su_names


def test_a_lever_of_one_metre_does_not_make_a_joint_slide() -> None:
    """|tau| = 1 m/rad in every pose, as for a prismatic joint; the turning of gravity differs."""
    rng = np.random.default_rng(5)
    tree = serial_tree(1)
    state = random_state(rng, tree, intrinsics=0.0)
    T = state.T_joint_su.copy()
    T[0, :3, 3] = [1.0, 0.0, 0.2]
    features = random_features(rng, tree, replace(state, T_joint_su=T), 6, noise=0.02)
    np.testing.assert_allclose(np.linalg.norm(features.tau[:, 0, 0], axis=1), 1.0, atol=0.05)
    assert kinematic_tree(activity(features), features).joint_types == ("revolute",)


def humanoid(seed: int) -> Bool:
    """(29, 28) activity of a tree of 28 joints with an SU on every segment."""
    rng = np.random.default_rng(seed)
    active = np.zeros((29, 28), dtype=bool)
    for d in range(28):
        parent = int(rng.integers(-1, d)) if d and rng.random() < 0.25 else d - 1
        active[d + 1] = active[parent + 1]
        active[d + 1, d] = True
    return active


NAMES = [f"su{u}" for u in range(29)], [f"j{d}" for d in range(28)]


@given(seed=st.integers(0, 10_000), flips=st.integers(1, 4))
@example(seed=205, flips=4)
@settings(max_examples=60, deadline=None)
def test_undecided_bits_of_a_humanoid_never_spoil_right_ones(seed: int, flips: int) -> None:
    """What the rest decides is repaired; another tree at most keeps what it was given."""
    rng = np.random.default_rng(seed)
    truth = humanoid(seed)
    evidence = np.where(truth, 1, -1) * rng.uniform(1.5, 5.0, truth.shape)
    changed = np.zeros(truth.size, dtype=bool)
    changed[rng.choice(truth.size, flips, replace=False)] = True
    changed = changed.reshape(truth.shape)
    evidence[changed] *= -rng.uniform(0.0, 0.25, flips)
    bits, notes = nested(evidence, *NAMES)
    _assert_nested(bits)
    assert not (bits != truth)[~changed].any()
    repaired = (bits == truth) & changed
    assert len(notes) == repaired.sum()
    for u, d in zip(*np.nonzero(repaired), strict=True):
        assert ((f"su{u}",), (f"j{d}",)) in [(note.sus, note.joints) for note in notes]


def test_most_undecided_bits_of_a_humanoid_are_decided_by_the_rest() -> None:
    """The others lead to a tree as good: an SU may as well sit one segment further out."""
    decided = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        truth = humanoid(seed)
        evidence = np.where(truth, 3.0, -3.0)
        evidence.flat[rng.integers(truth.size)] *= -0.2
        decided += bool((nested(evidence, *NAMES)[0] == truth).all())
    assert decided >= 85


@given(st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_a_certain_contradiction_is_refused_with_its_su_and_dof(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = humanoid(seed)
    evidence = np.where(truth, SURE, -SURE)
    u, d = int(rng.integers(29)), int(rng.integers(28))
    evidence[u, d] *= -1
    refused: list[StructureError] = []
    try:
        bits, notes = nested(evidence, *NAMES)
    except StructureError as error:
        refused.append(error)
    if refused:
        assert f"j{d}" in refused[0].dofs
        assert refused[0].remedy
    else:
        np.testing.assert_array_equal(bits, evidence > 0)
        assert notes == []
