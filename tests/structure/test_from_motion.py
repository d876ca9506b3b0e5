"""Trees from recordings in which several joints move at once and nothing is excited."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joint_paths import JointPath
from mujoco_robot import random_arm, record
from random_robots import Joint, random_joints, robot_of
from simulated import changed_sus

from skin2urdf.errors import StructureError
from skin2urdf.notes import of_kind
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.features import extract_features
from skin2urdf.signals.sampling import Sampled, sample_recording, sampled_together
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.motion_settings import MotionSettings
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.structure.activity import activity
from skin2urdf.structure.from_motion import MotionTree, trees_from_motion, trees_of_both_kinds
from skin2urdf.structure.still import turned_all_the_same

SQUARE = (np.pi / 2, 0.0, 0.0)
HIDDEN = (
    Joint("vertical", -1, "revolute"),
    Joint("swings", 0, "revolute", rpy=SQUARE),
    Joint("slides", 1, "prismatic", rpy=(0.4, 0.0, 0.0), limits=(-0.2, 0.2)),
    Joint("turns", 2, "revolute", rpy=(0.5, 0.3, 0.0)),
)
PALLETISER = (
    Joint("vertical", -1, "revolute", (0.2, 0.0, 0.06)),
    Joint("lifts", 0, "revolute", (0.04, 0.0, 0.19), (-np.pi / 2, 0.0, 0.0)),
    Joint("bends", 1, "revolute", (0.07, 0.07, 0.16)),
    Joint("slides", 2, "prismatic", (0.0, -0.03, 0.18), limits=(-0.3, 0.3)),
)
PARALLEL = (
    Joint("first", -1, "revolute", rpy=SQUARE),
    Joint("second", 0, "revolute", xyz=(0.3, 0.0, 0.02)),
    Joint("third", 1, "revolute", xyz=(0.25, 0.0, 0.03)),
)


def sampled_of(joints: tuple[Joint, ...], folder: Path, n_poses: int = 12) -> Sampled:
    """An upright robot that goes from pose to pose, an SU on every segment, on the grid."""
    settings = SimulationSettings(
        n_poses=n_poses, seed=1, excite="none", upright=True, imu_rate=250.0, joint_rate=125.0
    )
    layout = SkinLayout(sus_per_segment=1, sus_on_base=1)
    recording = retimed(simulate(robot_of(joints, folder, layout), settings).recording)
    return sampled(recording)


def sampled(recording: Recording) -> Sampled:
    return sample_recording(
        recording, [j.name for j in recording.joints], [s.name for s in recording.sus]
    )


def found_in(log: Sampled, sus: list[int]) -> tuple[MotionTree, ...]:
    some = replace(log, readings=log.readings[:, sus], valid=log.valid[:, sus])
    return trees_from_motion([some], [f"su{u}" for u in sus])


def chain(found: MotionTree, su: int) -> list[str]:
    tree = found.tree
    at = int(tree.su_joint[tree.su_names.index(f"su{su}")])
    return [tree.joint_names[j] for j in tree.chain(at)]


def test_vertical_and_sliding_joints_show_in_accelerations(tmp_path: Path) -> None:
    log = sampled_of(HIDDEN, tmp_path)
    U = log.readings.shape[1]
    found = found_in(log, list(range(U)))[0]
    assert found.tree.joint_names == ("vertical", "swings", "slides", "turns")
    assert found.tree.parent.tolist() == [-1, 0, 1, 2]
    assert found.tree.joint_types == ("revolute", "revolute", "prismatic", "revolute")
    assert sorted(found.tree.su_joint) == [-1, 0, 1, 2, 3]
    assert found.axes[0] == pytest.approx([0, 0, 1], abs=1e-6)
    assert abs(found.axes[0] @ found.axes[1]) < np.sin(np.deg2rad(1.0))
    # 0.4 rad about the axis of the URDF's second joint's x, which is square to both.
    assert abs(found.axes[1] @ found.axes[2]) == pytest.approx(np.cos(0.4), abs=0.02)
    assert found.misfit < 0.01


def test_a_push_is_not_taken_for_a_swing_about_a_far_axis(tmp_path: Path) -> None:
    """Moves that never rest: gravity and accelerations are seen together from the beginning."""
    joints = (
        Joint("first", -1, "revolute", limits=(-0.2, 0.2)),
        Joint("slides", 0, "prismatic", (0.02, 0.03, 0.25), (0.3, 0.2, 0.0), (1.0, 0.0, 0.0),
              limits=(-0.15, 0.15)),
        Joint("turns", 1, "revolute", rpy=(0.5, 0.3, 0.0)),
    )  # fmt: skip
    settings = SimulationSettings(
        excite="series", minutes=0.5, seed=3, imu_rate=100.0, joint_rate=50.0
    )
    simulation = simulate(robot_of(joints, tmp_path, SkinLayout(1, 1)), settings)
    logs, names = sampled_together([retimed(simulation.recording)], must_rest=False)
    found, *_ = trees_from_motion(logs, names)
    assert found.tree.joint_types == ("revolute", "prismatic", "revolute")
    assert found.tree.parent.tolist() == [-1, 0, 1]


@pytest.mark.parametrize("seed", [1, 5])
def test_directions_that_a_slide_has_bent_do_not_make_it_turn(seed: int, tmp_path: Path) -> None:
    """In motion that never rests: bent so that it might turn the last SU, it pushes that by 1.1.

    With one seed another joint is put in beyond the others as well, for what it pushes.
    """
    settings = SimulationSettings(
        excite="series", minutes=0.8, seed=seed, upright=True, imu_rate=100.0, joint_rate=50.0
    )
    made = simulate(robot_of(PALLETISER, tmp_path, SkinLayout(1, 1)), settings)
    logs, names = sampled_together([retimed(made.recording)], must_rest=False)
    found, *_ = trees_from_motion(logs, names)
    assert found.tree.joint_types == ("revolute", "revolute", "revolute", "prismatic")
    assert found.tree.su_joint.tolist() == [su.joint for su in made.truth.sus]


def test_an_su_that_two_sliding_joints_push_and_none_turns_is_found(tmp_path: Path) -> None:
    """What it gains by either of them is spoilt by the other."""
    robot = robot_of(random_joints(np.random.default_rng(611001), 5), tmp_path)
    settings = SimulationSettings(excite="none", minutes=1.0, seed=611001, imu_rate=200.0)
    simulation = simulate(robot, settings)
    log = sampled(retimed(simulation.recording))
    found, *_ = found_in(log, list(range(log.readings.shape[1])))
    first, *_, branch = simulation.truth.joint_names
    su = [su.joint for su in simulation.truth.sus].index(4)
    assert chain(found, su) == [first, branch]


def test_moves_order_parallel_joints_without_an_su_in_between(tmp_path: Path) -> None:
    log = sampled_of(PARALLEL, tmp_path)
    sus = list(range(log.readings.shape[1]))
    whole = found_in(log, sus)[0]
    tip = next(u for u in sus if len(chain(whole, u)) == 3)
    base = next(u for u in sus if not chain(whole, u))
    best, *_ = found_in(log, [base, tip])
    assert chain(best, tip) == ["first", "second", "third"]


def test_an_order_that_nothing_shows_is_not_picked_silently(tmp_path: Path) -> None:
    log = sampled_of(PARALLEL[:2], tmp_path)
    sus = list(range(log.readings.shape[1]))
    whole = found_in(log, sus)[0]
    tip = next(u for u in sus if len(chain(whole, u)) == 2)
    # At rest alone, two parallel joints could as well follow each other the other way round.
    at_rest = np.zeros(len(log.motion.q), dtype=bool)
    for rest in log.rests:
        at_rest[rest.begin : rest.end] = True
    still = replace(log, valid=log.valid & at_rest[:, None])
    several = found_in(still, [tip])
    orders = {tuple(chain(found, tip)) for found in several}
    assert orders == {("first", "second"), ("second", "first")}
    # The one that comes first says so.
    (note,) = of_kind(several[0].tree.notes, "other order")
    assert {note.joints, note.instead} == orders


def test_joints_that_no_su_feels_make_no_tree(tmp_path: Path) -> None:
    log = sampled_of(PARALLEL[:1], tmp_path)
    whole = found_in(log, [0, 1])[0]
    base = next(u for u in (0, 1) if not chain(whole, u))
    with pytest.raises(StructureError):
        found_in(log, [base])


def test_one_su_beyond_joints_that_all_move_at_once_makes_no_tree(tmp_path: Path) -> None:
    further = (
        Joint(f"j{i}", i - 1, "revolute", xyz=(0.2, 0.0, 0.1), rpy=(1.2, 0.3 * i, 0.0))
        for i in range(1, 4)
    )
    bent = (Joint("j0", -1, "revolute", rpy=SQUARE), *further)
    log = sampled_of(bent, tmp_path, n_poses=4)
    whole = found_in(log, list(range(log.readings.shape[1])))[0]
    (tip,) = (u for u in range(len(whole.tree.su_joint)) if len(chain(whole, u)) == 4)
    with pytest.raises(StructureError):
        found_in(log, [tip])


def test_gyroscopes_tell_an_su_on_a_vertical_axis_from_one_on_the_base(tmp_path: Path) -> None:
    settings = SimulationSettings(
        seed=1, excite="none", minutes=0.7, upright=True, imu_rate=250.0, joint_rate=125.0,
        gyro="cheap",
    )  # fmt: skip
    # On the axis itself, where nothing but a turn is felt; and one further out.
    given = (
        GivenSu("link_vertical", (0.0, 0.0, 0.1), (0.3, 0.2, 0.1)),
        GivenSu("link_swings", (0.1, 0.05, 0.02), (0.0, 0.4, 0.0)),
    )
    layout = SkinLayout(sus_per_segment=0, sus_on_base=1, given=given)
    recording = retimed(simulate(robot_of(HIDDEN[:2], tmp_path, layout), settings).recording)
    log = sampled(recording)
    names = [su.name for su in recording.sus]

    seen = trees_from_motion([log], names)[0].tree
    assert sorted(seen.chains().values(), key=len) == [[], ["vertical"], ["vertical", "swings"]]
    assert turned_all_the_same([log], names, seen) == ()
    deaf = trees_from_motion([replace(log, turning=None)], names)[0].tree
    assert sorted(deaf.chains().values(), key=len) == [[], [], ["vertical", "swings"]]
    # Where nothing else shows it, gyroscopes still tell that such a tree is wrong.
    (wrong,) = turned_all_the_same([log], names, deaf)
    assert seen.chains()[wrong] == ["vertical"]


@pytest.mark.parametrize("seed", [7405, 7407])
def test_moves_that_a_servo_rings_after_are_no_patterns(seed: int) -> None:
    """However exact the encoders are: what they show at rest is not what a pattern is."""
    settings = SimulationSettings(
        seed=seed, excite="none", minutes=1.0, encoder_bits=None, jitter=0.0, imu_rate=250.0
    )
    recording = retimed(simulate(load_robot("panda"), settings).recording)
    features = extract_features([sampled(recording)], [su.name for su in recording.sus])
    assert not activity(features).patterns_felt


@pytest.mark.parametrize("seed", [2, 4])
def test_joints_may_all_move_fast_and_never_rest(seed: int) -> None:
    """What gravity does is small beside accelerations, and known as well as these are modelled."""
    n = 6
    path = JointPath([0.0] * n)
    path.swing({d: 1.4 * (-1) ** d for d in range(n)}, seconds=60.0, hertz=0.35)
    sus, joints = [f"skin_{k}" for k in range(n + 1)], [f"m{d}" for d in range(n)]
    recording = record(random_arm(seed, n), path, sus, joints, np.random.default_rng(seed))
    tree = trees_from_motion([sampled(recording)], [su.name for su in recording.sus])[0].tree
    assert set(tree.su_names) == set(sus)
    for su, joint in zip(tree.su_names, tree.su_joint, strict=True):
        chain = [tree.joint_names[j] for j in tree.chain(int(joint))]
        assert chain == joints[: sus.index(su)]


@pytest.mark.parametrize(("seed", "band"), [(3, (0.1, 0.5)), (4, (0.2, 0.6))])
def test_what_fast_motion_turns_gravity_by_hides_no_upright_joint(
    seed: int, band: tuple[float, float]
) -> None:
    """The joint was taken to slide behind the next one, or left to noise, and its SU to the base.

    An SU that feels accelerations as large as gravity has to be turned from slower moments.
    """
    settings = SimulationSettings(
        seed=seed, excite="series", minutes=0.5, upright=True, imu_rate=100.0, joint_rate=50.0,
        motion=MotionSettings(series_band=band),
    )  # fmt: skip
    simulation = simulate(load_robot("ur5"), settings)
    recording = retimed(simulation.recording)
    tree = trees_from_motion(*sampled_together([recording], must_rest=False))[0].tree
    assert list(tree.parent) == [-1, 0, 1, 2, 3, 4]
    assert tree.joint_types == ("revolute",) * 6
    assert tree.su_joint.tolist() == [su.joint for su in simulation.truth.sus]


@pytest.mark.parametrize("seed", [10, 14])
def test_what_a_slide_pushes_by_leaves_no_su_without_a_place(seed: int, tmp_path: Path) -> None:
    """It is felt beyond the slide, by SUs of which gravity has to show the joints."""
    joints = random_joints(np.random.default_rng(seed), 6)
    settings = SimulationSettings(
        seed=seed, excite="series", minutes=0.7, imu_rate=250.0, joint_rate=125.0
    )
    layout = SkinLayout(sus_per_segment=1, sus_on_base=1)
    made = simulate(robot_of(joints, tmp_path, layout), settings)
    recording = retimed(made.recording)
    sus = [su.name for su in recording.sus]
    log = sample_recording(recording, [j.name for j in recording.joints], sus, must_rest=False)
    tree = trees_from_motion([log], sus)[0].tree
    assert set(tree.su_names) == set(sus)
    slides = {joint.name for joint in joints if joint.kind == "prismatic"}
    found = zip(tree.joint_names, tree.joint_types, strict=True)
    assert {name for name, kind in found if kind == "prismatic"} == slides


def test_an_su_on_the_base_that_drifts_stays_there(tmp_path: Path) -> None:
    """By 25 mg, which is far more than its noise."""
    settings = SimulationSettings(n_poses=12, seed=2, excite="none", upright=True)
    layout = SkinLayout(sus_per_segment=1, sus_on_base=1)
    recording = retimed(simulate(robot_of(PARALLEL, tmp_path, layout), settings).recording)
    names = [su.name for su in recording.sus]
    (base,) = _on_base(trees_from_motion([sampled(recording)], names)[0])

    def drifting(su: SuStream) -> SuStream:
        warmth = 1 - np.exp(-su.time / 60)
        felt = su.specific_force + 0.25 * warmth[:, None] * (1.0, -0.5, 0.3)
        return replace(su, specific_force=felt) if su.name == base else su

    moved = changed_sus(recording, drifting)
    found = trees_from_motion([sampled(moved)], names)[0]
    assert sorted(found.tree.su_names) == names
    assert _on_base(found) == [base]


def _on_base(found: MotionTree) -> list[str]:
    return [n for n, j in zip(found.tree.su_names, found.tree.su_joint, strict=True) if j < 0]


@pytest.mark.parametrize("arm", [0.0, 0.05])
def test_what_a_linkage_moves_is_told_from_what_nothing_moves(arm: float, tmp_path: Path) -> None:
    """A finger goes round with its drive without turning, or is not carried by it at all."""
    settings = SimulationSettings(seed=4, excite="none", minutes=1.0, imu_rate=200.0)
    layout = SkinLayout(sus_per_segment=1, sus_on_base=1)
    made = retimed(simulate(robot_of(PARALLEL, tmp_path, layout), settings).recording)
    names = [su.name for su in made.sus]
    tree = trees_from_motion([sampled(made)], names)[0].tree
    finger = tree.su_names[int(np.argmax(tree.su_joint))]
    w, most = 3.0, 0.4

    def carried(su: SuStream) -> SuStream:
        turn, speed = most * (1 - np.cos(w * su.time)), most * w * np.sin(w * su.time)
        rate = most * w**2 * np.cos(w * su.time)
        to, away = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
        along = rate * np.cos(turn) - speed**2 * np.sin(turn)
        across = -rate * np.sin(turn) - speed**2 * np.cos(turn)
        felt = arm * (along[:, None] * to + across[:, None] * away)
        return replace(su, specific_force=su.specific_force + felt) if su.name == finger else su

    time = made.joints[0].time
    drive = JointStream("drive", time, most * (1 - np.cos(w * time)))
    log = replace(changed_sus(made, carried), joints=(*made.joints, drive))
    both, _ = sampled_together([log], must_rest=False)
    notes = trees_from_motion(both, names)[0].tree.notes
    moved = [(note.sus, note.joints) for note in of_kind(notes, "moves otherwise")]
    assert moved == ([((finger,), ("drive",))] if arm else [])


def test_joints_that_gravity_shows_in_moves_alone_are_sought_in_no_rests() -> None:
    """At rest in one pose all of them may be vertical or slide: twelve took ten minutes to try."""
    path = JointPath([0.0] * 4).rest(2.0)
    path.swing({d: 0.8 * (-1) ** d for d in range(4)}, seconds=40.0, hertz=1.5).rest(2.0)
    sus, joints = [f"skin_{k}" for k in range(5)], [f"m{d}" for d in range(4)]
    recording = record(random_arm(3, 4), path, sus, joints, np.random.default_rng(3))
    ((found,),) = trees_of_both_kinds([sampled(recording)], [su.name for su in recording.sus])
    assert found.tree.chains() == {su: joints[:k] for k, su in enumerate(sus)}


def test_fingers_that_close_on_each_other_are_slides_of_their_own() -> None:
    """Both move by as much at all times, so that either position suits what moves both SUs."""
    carry = random_arm(8, 2)
    finger = replace(carry.joints[1], axis=(1.0, 0.0, 0.0), mass=0.2, parent=1, slides=True)
    other = replace(finger, axis=(-1.0, 0.0, 0.0), su_xyz=(-0.05, 0.02, 0.1))
    arm = replace(carry, joints=(*carry.joints, finger, other))
    rng = np.random.default_rng(3)
    path = JointPath([0.0] * 4).rest(1.0)
    for turned in rng.uniform(-1.2, 1.2, (14, 2)):
        apart = float(rng.uniform(0.0, 0.08))
        path.move([*turned, apart, apart], 0.9).rest(0.5)
    sus, joints = ["base", "a", "b", "left", "right"], ["m0", "m1", "left", "right"]
    recording = record(arm, path, sus, joints, rng)
    tree = trees_from_motion([sampled(recording)], [su.name for su in recording.sus])[0].tree
    chains = tree.chains()
    assert sorted(map(tuple, (chains["left"], chains["right"]))) == [
        ("m0", "m1", "left"),
        ("m0", "m1", "right"),
    ]
    assert chains["b"] == ["m0", "m1"]
