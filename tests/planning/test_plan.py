"""Plans with a model: nothing touches, poses tell most, files are exact, and the loop closes."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from skin2urdf.cli.main import main
from skin2urdf.errors import PlanError, Skin2UrdfError, UnreadableInputError, UsageError
from skin2urdf.model.records import KinematicModel
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.planning.collisions import CollisionChecker
from skin2urdf.planning.files import approach_time, as_csv, as_yaml, read_trajectory, rounded
from skin2urdf.planning.information import (
    Criterion,
    choose,
    known_before,
    merits,
    pattern_information,
    spread_out,
)
from skin2urdf.planning.limits import Given, read_limits
from skin2urdf.planning.patterns import draw_tones, pattern
from skin2urdf.planning.pieces import strain, transfer
from skin2urdf.planning.plan import make_plan
from skin2urdf.planning.poses import free_poses
from skin2urdf.planning.records import Limits, Plan, PlanSettings
from skin2urdf.planning.roadmap import Roadmap
from skin2urdf.planning.robots import Told, robot_of_limits, robot_of_model
from skin2urdf.planning.srdf import links_that_may_touch
from skin2urdf.planning.trajectory import JointTrajectory
from skin2urdf.simulation.mechanism import Mechanism, read_urdf
from skin2urdf.simulation.robots import load_robot

FOLDED = np.array([0.0, 2.85, 2.85])
"""The hand in the upper arm or the base."""


def test_the_plan_holds_its_limits_and_its_time(plan: Plan, limits: Limits) -> None:
    assert strain(rounded(plan.trajectory), limits).max() <= 1.0
    assert plan.trajectory.duration == pytest.approx(60.0, abs=1e-6)
    assert plan.phases[0].start == 0.0
    assert plan.phases[-1].end == pytest.approx(60.0, abs=1e-6)
    for before, after in zip(plan.phases, plan.phases[1:], strict=False):
        assert before.end == pytest.approx(after.start, abs=1e-9)
    assert any("acceleration" in note for note in plan.notes)


def test_readings_stay_within_the_range_of_the_sensors(
    plan: Plan, limits: Limits, model: KinematicModel
) -> None:
    """From pose to pose as well; the arm moves as fast as its limits let it where it may."""
    most = 1.25 * 9.81
    gentle = make_plan(limits, PlanSettings(minutes=1.0, candidates=40, full_scale=most), model)

    def largest(motion: JointTrajectory) -> float:
        q, qd, qdd, _ = motion.at(np.arange(0.0, motion.duration, 0.005))
        f = specific_forces(model, q, qd, qdd, np.array([0.0, 0.0, 9.81]))
        return float(np.linalg.norm(f, axis=2).max())

    assert largest(plan.trajectory) > most
    assert largest(gentle.trajectory) < most


def test_nothing_touches_along_a_plan(plan: Plan, checker: CollisionChecker) -> None:
    assert checker.touches(FOLDED)
    assert not checker.is_free(FOLDED)
    assert plan.checked == checker.n_pairs > 0
    time = np.arange(0.0, plan.trajectory.duration, 0.01)
    assert not any(checker.touches(q) for q in plan.trajectory.at(time)[0])


def test_a_way_through_the_robot_is_seen(checker: CollisionChecker, limits: Limits) -> None:
    # The hand swings through the base while the upper arm hangs beside it.
    start, goal, upright = np.array([[0.0, -2.3, -2.8], [0.0, -2.9, -0.05], [0.0, 0.0, 0.0]])
    assert checker.is_free(start)
    assert checker.is_free(goal)
    assert not checker.is_path_free(transfer(start, goal, limits))
    assert checker.is_path_free(transfer(start, upright, limits))
    road = Roadmap(np.array([start, goal, upright]), limits, checker.is_path_free)
    way = road.way(0, 1)
    assert way is not None
    np.testing.assert_array_equal(way[0].position[-1], upright)
    assert all(checker.is_path_free(piece) for piece in way)


def _path_free(checker: CollisionChecker, piece: JointTrajectory, n_poses: int) -> bool:
    """Whether a piece's path is said to be free, which all poses along it have to agree with."""
    along = piece.at(np.linspace(0.0, piece.duration, n_poses))[0]
    free = checker.is_path_free(piece)
    if free:
        assert not any(checker.touches(q) for q in along)
    else:
        assert not all(checker.is_free(q) for q in along)
    return free


def test_ways_are_free_where_all_poses_along_them_are(
    checker: CollisionChecker, limits: Limits
) -> None:
    rng = np.random.default_rng(4)
    # The hand swings by the base, or through it.
    ends = np.array([[0.0, -2.3, -2.8], [0.0, -2.8, -0.05]])
    verdicts = []
    for start, goal in ends + rng.uniform(-0.3, 0.3, (40, 2, 3)).clip(-2.9 - ends, 2.9 - ends):
        if not (checker.is_free(start) and checker.is_free(goal)):
            continue
        verdicts.append(_path_free(checker, transfer(start, goal, limits), 200))
    assert 3 < sum(verdicts) < len(verdicts) - 3


def test_patterns_are_free_where_all_poses_along_them_are(
    checker: CollisionChecker, limits: Limits
) -> None:
    rng = np.random.default_rng(5)
    tones = draw_tones(3, (0.6, 2.6), rng)
    beside = np.array([0.0, -2.45, -2.6])
    verdicts = []
    for _ in range(30):
        pose = beside + rng.uniform(-0.2, 0.2, 3)
        size = rng.choice([-3.0, 3.0], 3) * rng.uniform(0.2, 1.0, 3)
        piece = pattern(pose, tones, size, 6.0, 0.5, limits)
        verdicts.append(_path_free(checker, piece, 2000))
    assert 3 < sum(verdicts) < len(verdicts) - 3


def test_links_that_may_touch_are_not_kept_apart(
    arm: Path, mechanism: Mechanism, limits: Limits, checker: CollisionChecker, tmp_path: Path
) -> None:
    srdf = tmp_path / "arm.srdf"
    srdf.write_text('<robot name="a"><disable_collisions link1="hand" link2="base"/></robot>')
    may_touch = links_that_may_touch(srdf)
    xml = read_urdf(load_robot(arm))
    loose = CollisionChecker(
        xml, arm, mechanism.joint_names, {}, (limits.lower, limits.upper), may_touch=may_touch
    )
    assert loose.n_pairs == checker.n_pairs - 1
    assert any("base" in words and "hand" in words for words in checker.crowded)
    assert not any("base" in words and "hand" in words for words in loose.crowded)


@pytest.mark.parametrize(
    "text", ["no xml", "<mujoco/>", '<robot><disable_collisions link1="a"/></robot>']
)
def test_what_is_no_srdf_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "bad.srdf").write_text(text)
    with pytest.raises(UnreadableInputError):
        links_that_may_touch(tmp_path / "bad.srdf")


class Narrow(CollisionChecker):
    """Has no room for swings of more than a third of a radian."""

    def is_path_free(self, piece: JointTrajectory) -> bool:
        """Whether a piece goes somewhere, or swings little."""
        swings = np.ptp(piece.position, axis=0).max()
        leads_back = np.allclose(piece.position[0], piece.position[-1])
        return not leads_back or bool(swings < 0.35)


def test_where_there_is_no_room_for_whole_patterns_they_are_smaller(
    arm: Path, mechanism: Mechanism, limits: Limits, model: KinematicModel, plan: Plan
) -> None:
    xml = read_urdf(load_robot(arm))
    narrow = Narrow(xml, arm, mechanism.joint_names, {}, (limits.lower, limits.upper))
    settings = PlanSettings(minutes=1.0, candidates=40)
    for known in (model, None):
        found = make_plan(limits, settings, known, narrow)
        assert len(found.poses) == len(plan.poses)
        for phase in found.phases:
            if phase.kind == "pattern":
                time = np.arange(phase.start, phase.end, 0.01)
                assert 0.05 < np.ptp(found.trajectory.at(time)[0], axis=0).max() < 0.35


def test_a_floor_keeps_the_arm_above_it(arm: Path, mechanism: Mechanism, limits: Limits) -> None:
    xml = read_urdf(load_robot(arm))
    above = CollisionChecker(
        xml, arm, mechanism.joint_names, {}, (limits.lower, limits.upper), floor=0.25
    )
    assert above.is_free(np.array([0.3, 0.0, 0.0]))
    assert not above.is_free(np.array([2.0, 0.0, 0.0]))


def test_whatever_moves_stays_above_the_floor(
    arm: Path, mechanism: Mechanism, limits: Limits, checker: CollisionChecker
) -> None:
    """The link behind the first joint too; the base may stand in the floor."""
    xml = read_urdf(load_robot(arm))
    ranges = limits.lower, limits.upper
    above = CollisionChecker(xml, arm, mechanism.joint_names, {}, ranges, floor=0.2)
    assert above.n_pairs == checker.n_pairs + 3
    upright = np.array([1.9, -1.9, 0.0])
    assert checker.is_free(upright)
    assert not above.is_free(upright)
    for floor in (100.0, np.inf, np.nan):
        with pytest.raises(UsageError) as caught:
            CollisionChecker(xml, arm, mechanism.joint_names, {}, ranges, floor=floor)
        assert caught.value.argument == "--floor"


@pytest.mark.parametrize("bare", [True, False])
def test_a_floor_needs_shapes(arm: Path, mechanism: Mechanism, bare: bool) -> None:
    xml = read_urdf(load_robot(arm))
    for link in xml.iter("link") if bare else ():
        for shape in link.findall("collision"):
            link.remove(shape)
    with pytest.raises(UsageError) as caught:
        robot_of_model(arm, xml, mechanism, Told(floor=0.0, collisions=bare))
    assert caught.value.argument == "--floor"
    known = {"j0": Given(lower=-1.0, upper=1.0, velocity=1.0)}
    with pytest.raises(UsageError):
        robot_of_limits(Told(known, floor=0.0))


def test_free_poses_are_free_even_where_hardly_any_is() -> None:
    low, high = -np.ones(6), np.ones(6)

    def is_free(q: np.ndarray) -> bool:
        return bool(np.abs(np.diff(q)).max() < 0.5)

    poses = free_poses(low, high, 30, is_free, np.random.default_rng(0))
    assert all(is_free(q) for q in poses)
    assert np.ptp(poses, axis=0).min() > 0.3
    with pytest.raises(PlanError):
        free_poses(low, high, 3, lambda _: False, np.random.default_rng(0))


def test_chosen_poses_tell_more_than_others(model: KinematicModel) -> None:
    rng = np.random.default_rng(0)
    tones = draw_tones(3, (0.6, 2.6), rng)
    poses = rng.uniform(-2.5, 2.5, (40, 3))
    _, state, known = known_before(model)
    told = pattern_information(model, state, poses, tones, np.full((40, 3), 2.0), 4.0, 0.4, rng)
    criteria: tuple[Criterion, ...] = ("determinant", "trace")
    for criterion in criteria:
        best = choose(known, told, 5, criterion, lambda _: True, 2)

        def worth(which: list[int], criterion: Criterion = criterion) -> float:
            base = known
            for c in which[:-1]:
                base = base.plus(told, c)
            return float(merits(base, told, np.array(which[-1:]), criterion)[0])

        drawn = [worth(list(rng.choice(40, 5, replace=False))) for _ in range(40)]
        assert worth(best) >= max(drawn)
        # Nothing that does not do is taken, however much it tells.
        others = choose(known, told, 5, criterion, lambda c, first=best[0]: c != first, 0)
        assert best[0] not in others


def test_information_is_that_of_pinocchios_frames(model: KinematicModel) -> None:
    """The information on an SU's place is what differences of predicted readings make of it."""
    rng = np.random.default_rng(1)
    tones = draw_tones(3, (0.6, 2.6), rng)
    pose = np.array([[0.4, -0.7, 1.1]])
    _, state, _ = known_before(model)
    drawn = np.random.default_rng(5)
    told = pattern_information(model, state, pose, tones, np.full((1, 3), 2.0), 4.0, 0.4, drawn)
    su = 3
    # Moving the SU by t adds (wd x + w x w x) t to what it feels; its columns are those of t.
    moved = np.array(model.T_joint_su)
    up = np.array([0.0, 0.0, 9.81])
    from skin2urdf.planning.patterns import waveform

    time = 0.4 + 3.2 * np.sort(np.random.default_rng(5).uniform(size=16))
    q, qd, qdd = (2.0 * x for x in waveform(tones, time, 4.0, 0.4))
    here = specific_forces(model, q + pose, qd, qdd, up)[:, su]
    columns = []
    for i in range(3):
        away = moved.copy()
        away[su, :3, 3] += 1e-4 * moved[su, :3, i]
        other = KinematicModel(model.tree, model.T_parent_joint, away)
        there = specific_forces(other, q + pose, qd, qdd, up)
        columns.append((there[:, su] - here).ravel() / 1e-4)
    gram = np.array(columns) @ np.array(columns).T
    block = told.su[0, su, :3, :3]
    np.testing.assert_allclose(block / block[0, 0], gram / gram[0, 0], rtol=1e-5, atol=1e-7)


def test_poses_without_a_model_fill_the_ranges() -> None:
    rng = np.random.default_rng(0)
    poses = rng.uniform(-1.0, 1.0, (100, 2))
    chosen = spread_out(poses, 6, lambda _: True, np.full(2, 2.0))
    apart = np.linalg.norm(poses[chosen][:, None] - poses[chosen], axis=2)
    assert apart[np.triu_indices(6, 1)].min() > 0.6


def test_yaml_is_a_joint_trajectory_to_the_last_field(plan: Plan, tmp_path: Path) -> None:
    short = JointTrajectory(
        plan.trajectory.joint_names,
        plan.trajectory.time[:40] + 4.0,
        plan.trajectory.position[:40],
        plan.trajectory.velocity[:40],
        plan.trajectory.acceleration[:40],
    )
    path = tmp_path / "plan.yaml"
    path.write_text(as_yaml(short, "made for a test"), encoding="utf-8")
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert list(data) == ["header", "joint_names", "points"]
    assert data["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert data["joint_names"] == ["j0", "j1", "j2"]
    fields = ["positions", "velocities", "accelerations", "effort", "time_from_start"]
    kept = rounded(short)
    for k, point in enumerate(data["points"]):
        assert list(point) == fields
        np.testing.assert_allclose(point["positions"], short.position[k], atol=1e-9)
        np.testing.assert_allclose(point["velocities"], short.velocity[k], atol=1e-8)
        np.testing.assert_allclose(point["accelerations"], short.acceleration[k], atol=1e-7)
        assert all(isinstance(x, float) for x in point["positions"])
        assert point["effort"] == []
        stamp = point["time_from_start"]
        assert isinstance(stamp["sec"], int)
        assert 0 <= stamp["nanosec"] < 1_000_000_000
    back = read_trajectory(path)
    for name in ("time", "position", "velocity", "acceleration"):
        np.testing.assert_allclose(getattr(back, name), getattr(kept, name), rtol=0, atol=1e-12)
    path.write_text(json.dumps({"trajectory": data}), encoding="utf-8")
    np.testing.assert_array_equal(read_trajectory(path).position, back.position)
    rows = list(csv.reader(io.StringIO(as_csv(short))))
    assert rows[0][:4] == ["time", "position j0", "position j1", "position j2"]
    np.testing.assert_allclose(
        np.array(rows[1:], dtype=float)[:, 1:4], short.position, rtol=0, atol=1e-9
    )


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[1, 2",
        "joint_names: [a]",
        "joint_names: [a]\npoints: []",
        "joint_names: [a]\npoints: [{positions: [0], time_from_start: {sec: 0, nanosec: 0}}]",
    ],
)
def test_what_is_no_trajectory_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableInputError):
        read_trajectory(path)


def test_the_first_point_is_reached_from_anywhere_within_limits(plan: Plan, limits: Limits) -> None:
    start = plan.trajectory.position[:1]
    time = np.array([0.0, approach_time(start[0], limits)])
    for end in (limits.lower, limits.upper):
        way = JointTrajectory(
            limits.joint_names, time, np.vstack([end, start]), np.zeros((2, 3)), np.zeros((2, 3))
        )
        assert strain(way, limits)[1:].max() <= 1.0


def test_limits_come_as_moveit_and_ros2_control_have_them(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(
        "joint_limits:\n  a: {has_velocity_limits: true, max_velocity: 2.0, max_jerk: 50,"
        " has_acceleration_limits: false, max_acceleration: 0}\n"
        "  b: {type: prismatic, min_position: 0, max_position: 0.4}\n",
        encoding="utf-8",
    )
    given = read_limits(path)
    assert given["a"].velocity == 2.0
    assert given["a"].jerk == 50.0
    assert given["a"].acceleration is None
    assert given["b"].prismatic
    assert given["b"].upper == 0.4
    toml = tmp_path / "limits.toml"
    toml.write_text("[joint_limits.a]\nmax_velocity = 2.0\nmax_jerk = 50\n", encoding="utf-8")
    assert read_limits(toml)["a"] == given["a"]
    for wrong in ("", "a: 3", "joint_limits: {a: {max_speed: 3}}", "{", "a: {max_jerk: fast}"):
        path.write_text(wrong, encoding="utf-8")
        with pytest.raises(UnreadableInputError):
            read_limits(path)


def test_from_plan_over_recording_to_the_robot(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, log, truth, robot = (
        str(tmp_path / name) for name in ("plan.yaml", "log.mcap", "truth.urdf", "robot.urdf")
    )
    words = [
        "plan",
        "--model",
        str(arm),
        "-o",
        plan,
        "--minutes",
        "0.7",
        "--json",
        "--grade",
        "mems",
    ]
    tilt = ["--base-rpy", "25", "15", "0"]
    assert main([*words, *tilt, "--json", "--plot", str(tmp_path / "plan.png")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (tmp_path / "plan.png").stat().st_size > 20_000
    assert told["seconds"] == pytest.approx(42.0, abs=1e-6)
    assert max(told["share_of_limits"].values()) <= 1.0
    foreseen = told["expected"]["mems"]["su_position_mm"]["SU beyond j2"]

    rates = ["--imu-rate", "100", "--joint-rate", "100"]
    words = ["simulate", str(arm), "--plan", plan, "-o", log, "--truth", truth, *tilt, *rates]
    assert main([*words, "--quiet"]) == 0
    assert main(["calibrate", log, "-o", robot, "--gravity", "9.81", "--quiet"]) == 0
    assert main(["compare", robot, truth, "--json"]) == 0
    held = json.loads(capsys.readouterr().out)
    assert held["tree_equal"]
    # A fifth of the readings, and an SU in another place: the same size.
    assert held["overall"]["position_mm"]["rms"] < 6 * foreseen

    # What shrinks the uncertainties that are left, with the limits of the model.
    beside = str(tmp_path / "robot.json")
    more = str(tmp_path / "more.yaml")
    words = [
        "plan",
        "--after",
        beside,
        "--model",
        str(arm),
        "-o",
        more,
        "--minutes",
        "0.4",
        "--grade",
        "mems",
    ]
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["shrinking_mm"]
    assert all(each["after"] < each["before"] for each in told["shrinking_mm"])
    assert not any(phase["kind"] == "structural" for phase in told["phases"])


def test_the_command_line_refuses_in_words(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "plan.yaml")
    bad = tmp_path / "bad.yaml"
    bad.write_text("joint_limits: {elbow: {max_velocity: 1}}", encoding="utf-8")
    tight = tmp_path / "tight.yaml"
    tight.write_text("j0: {min_position: 1, max_position: 0.5}", encoding="utf-8")
    model = ["--model", str(arm)]
    for words in (
        [],
        [*model, "--minutes", "0.1"],
        [*model, "--minutes", "nan"],
        [*model, "--share", "2"],
        [*model, "--range", "0.5"],
        [*model, "--limits", str(bad)],
        [*model, "--limits", str(tight)],
        [*model, "--sus", "no_such_*"],
        ["--after", str(tight)],
        ["--limits", str(tmp_path / "none.yaml")],
        [*model, "--floor", "100"],
        [*model, "--floor", "0", "--no-collisions"],
        [*model, "--csv", out],
        [*model, "--srdf", str(arm.with_name("none.srdf"))],
    ):
        assert main(["plan", "-o", out, *words]) == 2, words
        told = capsys.readouterr()
        assert "->" in told.err
    assert not Path(out).exists()


def test_a_plan_for_another_robot_is_refused(plan: Plan) -> None:
    from skin2urdf.simulation import SimulationSettings, load_robot, simulate

    with pytest.raises(Skin2UrdfError, match="j0"):
        simulate(load_robot("ur3"), SimulationSettings(plan=plan.trajectory))
