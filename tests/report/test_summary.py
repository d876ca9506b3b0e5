"""The summary: a verdict that can be believed, then tables, then what is not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated import calibration

from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.trajectory.curved import with_curves
from skin2urdf.estimation.trajectory.elastic import UnderKnown
from skin2urdf.estimation.trajectory.gears import Uneven
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.unseen import together
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.records import OpenDirection
from skin2urdf.notes import Note
from skin2urdf.report.branches import between_branches
from skin2urdf.report.document import as_document
from skin2urdf.report.findings import findings
from skin2urdf.report.notes import note_words
from skin2urdf.report.stiffness import stiffness_words
from skin2urdf.report.summary import as_text
from skin2urdf.report.tables import bullets, number, span, table
from skin2urdf.report.words import frames_at_zero


def unwrapped(text: str) -> str:
    """A text without the breaks inside its points."""
    return text.replace("\n    ", " ")


def with_misfit(misfit: float) -> Calibration:
    along = calibration().along
    assert along is not None
    return replace(calibration(), along=replace(along, misfit=misfit))


@pytest.mark.parametrize(
    ("misfit", "quality"), [(0.98, "good"), (7.0, "fair"), (900.0, "bad"), (float("nan"), "bad")]
)
def test_the_first_line_is_the_verdict(misfit: float, quality: str) -> None:
    first = as_text(with_misfit(misfit)).splitlines()[0]
    assert first.startswith(f"{quality}: 6 joints, 7 SUs; ")
    assert f" {misfit:.2g} " in first


def test_every_joint_and_su_has_its_row() -> None:
    lines = as_text(calibration()).splitlines()
    tree = calibration().model.tree
    for j, name in enumerate(tree.joint_names):
        row = next(line for line in lines if line.startswith(f"{name} ")).split()
        low, high = np.rad2deg(calibration().limits[j])
        assert row[1] == "revolute"
        assert row[2] == ("base" if j == 0 else tree.joint_names[j - 1])
        assert row[3:7] == [f"{low:.0f}", "..", f"{high:.0f}", "deg"]
        assert row[-1] == calibration().observability.joint_verdict[j].split()[-1]
    for u, name in enumerate(tree.su_names):
        row = next(line for line in lines if line.startswith(f"{name} ")).split()
        joint = int(tree.su_joint[u])
        assert row[1] == ("base" if joint < 0 else tree.joint_names[joint])
        assert row[-1] == calibration().observability.su_verdict[u].split()[-1]
        assert f" {calibration().goodness.by_su.per_dof[u]:.2f} " in " ".join(row)


def test_how_well_poses_are_predicted_is_told() -> None:
    line = as_text(calibration()).splitlines()[2]
    times = np.sqrt(calibration().goodness.prediction)
    assert f"{times:.2f}" in line.split()


def test_what_is_not_known_comes_with_what_to_record() -> None:
    first = calibration().model.tree.joint_names[0]
    unknown = [each for of_su in findings(calibration()).unknown for each in of_su]
    kinds = {(each.part, each.joint, each.cause) for each in unknown}
    assert {("slide", first, "one joint"), ("turn", first, "vertical axis")} <= kinds
    text = unwrapped(as_text(calibration()))
    assert all(str(each) in text for each in unknown)


def test_notes_are_shown() -> None:
    found = calibration()
    assert found.along is not None
    deaf = replace(found, along=replace(found.along, gyros=None))
    note = Note("unit g", ("su_1",))
    (words,) = note_words([note])
    assert words in unwrapped(as_text(replace(deaf, notes=(note,))))
    assert words not in unwrapped(as_text(replace(deaf, notes=())))


def yielding(deflections: dict[int, float]) -> Calibration:
    """The calibration with joints that yield by constant deflections."""
    along = calibration().along
    assert along is not None
    problem = along.problem
    joints = np.array(list(deflections), dtype=np.int64)
    elastic = UnderKnown(
        joint=joints,
        damping=np.zeros(len(joints), dtype=bool),
        size=np.full(len(joints), 2.0),
        motions=tuple(np.ones((len(log.q), len(joints))) for log in problem.logs),
    )
    priors = replace(problem.priors, unseen=np.ones(len(joints)))
    bent = MotionProblem(problem.tree, problem.logs, priors, unseen=elastic)
    state = replace(along.fitted.state, unseen=np.array(list(deflections.values())))
    fitted = replace(along.fitted, problem=bent, state=state)
    return replace(
        calibration(),
        # What was taken off belongs to the coordinates of a stiff robot.
        along=replace(along, problem=bent, fitted=fitted, corrected=(), causes=("elastic",)),
    )


def test_joints_that_yield_are_told_with_their_deflections() -> None:
    first, second, third = calibration().model.tree.joint_names[:3]
    soft = yielding({0: 2e-3, 2: -4.5e-3})
    text = as_text(soft)
    assert f"{first} by {number(2.0)} mrad, {third} by {number(4.5)} mrad" in text
    assert f"{second} by" not in text
    samples = as_document(soft)["samples"]
    assert samples["joints"][third]["largest_deflection"] == pytest.approx(4.5e-3)
    assert samples["joints"][second]["largest_deflection"] == 0.0
    assert f"{first} by" not in as_text(calibration())


def test_stiffness_is_told_where_torques_are_known() -> None:
    first, _, third = calibration().model.tree.joint_names[:3]
    soft = yielding({0: 2e-3, 2: -4.5e-3})
    assert soft.along is not None
    elastic = soft.along.problem.unseen
    assert isinstance(elastic, UnderKnown)
    known = replace(soft, along=replace(soft.along, under_known=elastic))
    # Numbers of unseen motion stand behind gravity's size.
    seen, size = known.observability, soft.along.problem.layout.unseen.stop
    covariance = replace(seen.covariance, joint=1e-8 * np.eye(size))
    known = replace(known, observability=replace(seen, covariance=covariance))
    joints = as_document(known)["samples"]["joints"]
    assert joints[first]["compliance"] == pytest.approx(1e-3)
    assert joints[third]["compliance"] == pytest.approx(-2.25e-3)
    assert joints[first]["compliance_sd"] == pytest.approx(5e-5)
    assert as_document(soft)["samples"]["joints"][first]["compliance"] is None


def test_springs_of_one_robot_all_yield_in_one_sense() -> None:
    compliance, deviation = np.array([1e-3, np.nan, 2e-4, -4e-5]), np.array([1e-5, 0, 1e-5, 1e-5])
    slides = [False, False, True, False]
    told = stiffness_words("abcd", slides, compliance, deviation)
    assert [words.split(":")[0] for words in told] == ["a", "c", "d"]
    # What yields against its torque by four deviations is no spring of 25 kNm/rad.
    for words, k in zip(told, (1.0, 5.0, 50.0), strict=True):
        assert f" {number(k)} " in words
    # Torques of the load are those of the drive with another sign.
    assert stiffness_words("abcd", slides, -compliance, deviation) == told


def test_uneven_gears_and_slack_are_told_with_their_sizes() -> None:
    along = yielding({0: 2e-4, 1: 1e-4}).along
    assert along is not None
    first, second = calibration().model.tree.joint_names[:2]
    elastic, logs = along.problem.unseen, along.problem.logs
    assert elastic is not None
    uneven = Uneven(np.array([0]), tuple(np.ones((len(log.q), 1)) for log in logs))
    priors = replace(along.problem.priors, unseen=np.array([1e-3, 1e-3, 7e-5]))
    problem = MotionProblem(along.problem.tree, logs, priors, unseen=together([elastic, uneven]))
    state = along.fitted.state
    state = replace(state, unseen=np.append(state.unseen, -3e-5))
    along = replace(
        along, problem=problem, fitted=replace(along.fitted, problem=problem, state=state),
        causes=("elastic", "harmonics", "slack"),
    )  # fmt: skip
    found = replace(calibration(), along=along)
    text = as_text(found)
    # What yields is told of all together, what is uneven of that alone.
    assert f"{first} by {number(0.17)} mrad, {second} by {number(0.1)} mrad" in text
    assert f"{first} by {number(0.03)} mrad;" in text
    assert f"{number(0.07)} mrad" in text
    samples = as_document(found)["samples"]
    assert samples["slack"] == 7e-5
    assert samples["causes"] == ["elastic", "harmonics", "slack"]
    told = [joint["unevenness"] for joint in samples["joints"].values()]
    assert told == pytest.approx([3e-5, *np.zeros(len(told) - 1)])
    assert as_document(calibration())["samples"]["slack"] == 0.0


def test_curved_axes_are_told_with_their_size() -> None:
    along = calibration().along
    assert along is not None
    problem, fitted = with_curves(along.problem, along.fitted, 1e-4)
    curvature = np.zeros((problem.tree.n_sus, 3))
    curvature[1, 2] = -2.5e-3 / (4 * GRAVITY)
    fitted = replace(fitted, state=replace(fitted.state, curvature=curvature))
    curved = replace(along, problem=problem, fitted=fitted, corrected=(), causes=("nonlinearity",))
    found = replace(calibration(), along=curved)
    assert f"{number(0.25)} % of 4 g" in as_text(found)
    assert "% of 4 g" not in as_text(calibration())
    sus = as_document(found)["samples"]["sus"]
    names = problem.tree.su_names
    assert sus[names[1]]["curvature"][2] == curvature[1, 2]
    assert sus[names[1]]["curvature_sd"][2] > 0
    straight = as_document(calibration())["samples"]["sus"][names[1]]
    assert not np.any([straight["curvature"], straight["curvature_sd"]])


def test_clocks_that_wander_are_told_by_how_much() -> None:
    along = calibration().along
    assert along is not None
    (log,) = along.problem.logs
    # A wave beside what an offset and a drift make of it.
    late = 0.1 + 1e-4 * log.since_middle + 4e-3 * np.cos(log.since_middle)
    found = replace(calibration(), along=replace(along, causes=("clock",), wander=(late,)))
    (wanders,) = as_document(found)["samples"]["clocks_wander"]
    assert wanders == pytest.approx(8e-3, rel=0.05)
    assert f"{number(1e3 * wanders)} ms" in as_text(found)
    assert as_document(calibration())["samples"]["clocks_wander"] == []


def test_open_directions_between_branches_are_told() -> None:
    first, second, *_ = calibration().model.tree.joint_names
    frame = calibration().T_canonical_joint[1]
    along = frames_at_zero(calibration().model)[1, :3, :3].T @ [0.0, 0.0, 1.0]
    slide = OpenDirection({second: np.r_[frame[:3, :3].T @ along, 0.0, 0.0, 0.0]}, {})
    observability = replace(calibration().observability, open_directions=(slide,))
    changed = replace(calibration(), observability=observability)
    (words,) = findings(changed).between_branches
    assert (words.part, words.joint, words.cause) == ("slide", first, "one joint")
    assert (second in words.what, words.remedy) == (True, "")
    assert str(words) in unwrapped(as_text(changed))


def test_an_axis_that_may_be_elsewhere_is_told() -> None:
    _, second, third, *_ = calibration().model.tree.joint_names
    axis = OpenDirection({second: np.eye(6)[0], third: np.eye(6)[1]}, {})
    (words,) = between_branches(calibration().model, [axis], np.eye(3)[2:])
    assert (words.part, words.joint, words.cause) == ("direction", second, "little motion")
    assert second in words.remedy
    first, su = calibration().model.tree.joint_names[0], calibration().model.tree.su_names[1]
    tilt = OpenDirection({first: np.eye(6)[3]}, {su: np.eye(6)[3]})
    (words,) = between_branches(calibration().model, [tilt], np.eye(3)[2:])
    assert (words.part, words.joint, words.cause) == ("tilt", first, "bias")
    fourth = calibration().model.tree.joint_names[3]
    several = OpenDirection({second: np.eye(6)[0], fourth: np.eye(6)[1]}, {})
    (words,) = between_branches(calibration().model, [several], np.eye(3)[2:])
    assert (words.part, words.joint, words.cause) == ("direction", "", "little motion")
    assert all(name in words.what for name in (second, fourth))


def test_without_an_observable_su_no_error_is_promised() -> None:
    observability = calibration().observability
    nothing = replace(
        observability, su_unobservable=tuple(np.eye(6) for _ in observability.su_unobservable)
    )
    changed = replace(calibration(), observability=nothing)
    assert np.isnan(findings(changed).expected_position)
    assert "nan" not in as_text(changed)


def test_expected_errors_are_small_and_positive() -> None:
    found = findings(calibration())
    assert 0 < found.expected_position < 1e-3
    assert 0 < found.expected_orientation < np.deg2rad(0.1)


def test_tables_line_up() -> None:
    lines = table(("name", "n"), [("a", "1.0"), ("long name", "10.0")], "<>")
    assert lines == ["name          n", "---------------", "a           1.0", "long name  10.0"]
    assert bullets("Notes", []) == []
    assert span(-90.2, 44.9) == "-90 .. 45"
    assert number(float("nan")) == "-"
    assert number(-0.001) == "0.00"
