"""The first line: every doubt lowers the verdict, and says why."""

from __future__ import annotations

import re
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrated import calibration

from skin2urdf.arrays import F64
from skin2urdf.calibration.refusal import check_fit
from skin2urdf.calibration.result import BAD_MISFIT, Calibration
from skin2urdf.errors import BadFitError
from skin2urdf.estimation.trajectory.fit import held
from skin2urdf.estimation.trajectory.gears import Ratios
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import MOST_SLACK
from skin2urdf.estimation.uncertainty.goodness import Share
from skin2urdf.estimation.uncertainty.health import why_bad
from skin2urdf.estimation.uncertainty.physics import (
    IMPOSSIBLE_SLACK,
    physics_found,
    why_unexplained,
)
from skin2urdf.faults import Fault
from skin2urdf.notes import Note
from skin2urdf.output import not_to_be_saved
from skin2urdf.report.document import as_document
from skin2urdf.report.findings import findings, is_to_repair


def line(found: Calibration) -> str:
    return findings(found).verdict


def against(found: Calibration) -> list[tuple[str, tuple[str, ...]]]:
    """Kinds and names of what speaks against a result; every one has words in the first line."""
    doubts = findings(found).doubts
    assert all(doubt.words and doubt.words in line(found) for doubt in doubts)
    return [(doubt.kind, doubt.names) for doubt in doubts]


def missing() -> tuple[str, tuple[str, ...]]:
    """The doubt about the SUs that the log does not determine."""
    tree, verdicts = calibration().model.tree, calibration().observability.su_verdict
    names = zip(tree.su_names, verdicts, strict=True)
    return "SUs open", tuple(name for name, verdict in names if verdict != "determined")


def with_misfit(
    pose: int | slice = slice(None), su: int | slice = slice(None), times: float = 1e3
) -> Calibration:
    """The calibration with some blocks so many times worse."""
    blocks = calibration().goodness.by_block
    factors = np.ones(blocks.chi2.shape)
    factors[pose, su] = times
    worse = Share(blocks.chi2 * factors, blocks.dof)
    return replace(calibration(), goodness=replace(calibration().goodness, by_block=worse))


def with_observability(**changes: Any) -> Calibration:
    return replace(calibration(), observability=replace(calibration().observability, **changes))


def test_a_good_result_tells_its_accuracy_and_what_is_missing() -> None:
    found = findings(calibration())
    assert 0 < found.expected_position <= found.worst_position < 1e-3
    first = found.verdict
    assert first.startswith("good: 6 joints, 7 SUs; ")
    assert f"{found.worst_position * 1e3:.2f} mm" in first
    assert against(calibration()) == [missing()]
    assert len(missing()[1]) == 2
    assert first.endswith(f"({', '.join(missing()[1])})")


def test_without_anything_missing_there_is_no_doubt() -> None:
    assert against(with_observability(su_verdict=("determined",) * 7)) == []


def test_many_names_are_cut_short() -> None:
    found = with_observability(su_verdict=("weak",) * 7)
    names = found.model.tree.su_names
    assert against(found) == [("SUs open", names)]
    assert [name in line(found) for name in names] == [True] * 3 + [False] * 4
    assert np.isnan(findings(found).worst_position)
    assert " mm" not in line(found)


def test_a_fault_makes_a_good_fit_fair() -> None:
    fault = Fault("loose", "su_x", begin=12.0)
    found = replace(calibration(), faults=(fault,))
    assert found.quality == "fair"
    assert line(found).startswith("fair: ")
    assert against(found) == [("faults", ("su_x",)), missing()]


def test_a_base_that_gives_way_makes_a_good_fit_fair() -> None:
    along = calibration().along
    assert along is not None
    found = replace(calibration(), along=replace(along, causes=("base",)))
    assert found.quality == "fair"
    assert against(found) == [("soft base", ()), missing()]


def test_joints_that_moved_alike_make_a_good_fit_fair() -> None:
    found = replace(calibration(), notes=(Note("moved alike", joints=("j_1", "j_2")),))
    assert found.quality == "fair"
    assert is_to_repair(found)
    assert against(found) == [("joints alike", ("j_1", "j_2")), missing()]


def test_sus_that_a_linkage_moves_make_a_good_fit_fair() -> None:
    found = replace(calibration(), notes=(Note("moves otherwise", ("su_x",), ("drive",)),))
    assert found.quality == "fair"
    assert against(found) == [("SUs moved otherwise", ("su_x",)), missing()]


def test_motion_that_is_smoothed_away_makes_it_bad() -> None:
    along = calibration().along
    assert along is not None
    found = replace(calibration(), along=replace(along, unreached=0.5))
    assert found.quality == "bad"
    assert ("smoothed away", ()) in against(found)


def test_joints_in_an_untold_order_make_a_good_fit_fair() -> None:
    first, second, *_ = names = calibration().model.tree.joint_names
    told = Note("other order", joints=names[:2], instead=(second, first), size=0.02)
    found = replace(calibration(), notes=(told,))
    assert found.quality == "fair"
    assert against(found) == [("orders open", (first, second)), missing()]
    assert findings(found).doubts[0].number == pytest.approx(0.02)
    assert is_to_repair(found)


def test_an_order_that_moves_no_su_elsewhere_does_not_matter() -> None:
    first, second, *_ = names = calibration().model.tree.joint_names
    alike = Note("other order", joints=names[:2], instead=(second, first), size=1e-6)
    found = replace(calibration(), notes=(alike,))
    assert found.quality == "good"
    assert not is_to_repair(found)


def test_a_joint_of_another_ratio_has_to_be_set_right() -> None:
    along = calibration().along
    assert along is not None
    problem, state = along.problem, along.fitted.state
    D = problem.tree.n_joints
    of = Ratios(np.arange(D), tuple(log.q for log in problem.logs))
    geared = MotionProblem(
        problem.tree, problem.logs, replace(problem.priors, unseen=np.full(D, 0.01)), unseen=of
    )
    wrong = np.zeros(D)
    wrong[:2] = -0.03, 1e-4
    fitted = replace(along.fitted, problem=geared, state=replace(state, unseen=wrong))
    causes = ("ratio",)
    geared_too = replace(along, problem=geared, fitted=fitted, corrected=(), causes=causes)
    found = replace(calibration(), along=geared_too)
    first = problem.tree.joint_names[0]
    assert found.quality == "fair"
    assert against(found) == [("wrong ratios", (first,)), missing()]
    assert is_to_repair(found)
    assert as_document(found)["samples"]["joints"][first]["ratio_error"] == -0.03
    assert not calibration().wrong_ratios


def test_a_base_that_moves_by_itself_makes_a_good_fit_fair() -> None:
    found = replace(calibration(), notes=(Note("base moves", size=0.01),))
    assert found.quality == "fair"
    assert against(found) == [("moving base", ()), missing()]


def leaving(what: Callable[[F64], F64], scale: float) -> Calibration:
    """The calibration with readings of its last SU that hold more, made of joints' positions."""
    found, along = calibration(), calibration().along
    assert along is not None
    (log,), (predicted,) = along.problem.logs, along.fitted.predicted
    residual, readings = predicted.residual.copy(), log.readings.copy()
    more = scale * what(log.q[log.kept])
    residual[:, -1, :3] += more
    readings[log.kept, -1] += more
    changed = replace(
        along.fitted,
        problem=along.problem.again(logs=[replace(log, readings=readings)]),
        predicted=(replace(predicted, residual=residual),),
    )
    return replace(found, along=replace(along, fitted=changed))


def test_an_su_that_feels_motion_its_place_does_not_explain_makes_it_bad() -> None:
    """What is left passes for noise of its sensor, which does not follow the motion."""
    name = calibration().model.tree.su_names[-1]
    noise = np.random.default_rng(3)
    wrong = leaving(lambda q: np.sin(q[:, [1, 2, 3]]), 5.0)
    assert (wrong.quality, wrong.unexplained) == ("bad", (name,))
    assert ("SUs unexplained", (name,)) in against(wrong)
    assert replace(wrong, faults=(Fault("loose", name),)).unexplained == ()
    assert leaving(lambda q: noise.normal(size=(len(q), 3)), 5.0).unexplained == ()
    assert leaving(lambda q: np.sin(q[:, [1, 2, 3]]), 0.2).unexplained == ()


def test_an_su_that_feels_a_joint_which_the_tree_lacks_makes_it_bad() -> None:
    along = calibration().along
    assert along is not None
    (log,) = along.problem.logs
    lacking = 1.5 * np.sin(2 * np.pi * 0.37 * np.arange(len(log.q)) / log.rate)[:, None]
    wrong = leaving(lambda _: np.tile(np.sin(lacking[log.kept]), 3), 5.0)
    assert wrong.unexplained == ()
    assert wrong.along is not None
    fitted = wrong.along.fitted
    (readings,) = (log.readings for log in fitted.problem.logs)
    known = fitted.problem.again(logs=[replace(log, readings=readings, left_out=lacking)])
    told = replace(wrong, along=replace(wrong.along, fitted=replace(fitted, problem=known)))
    assert told.unexplained == (calibration().model.tree.su_names[-1],)


def test_an_su_unlike_the_rest_makes_it_fair() -> None:
    found = with_misfit(su=4)
    name = found.model.tree.su_names[4]
    assert found.quality == "fair"
    assert against(found) == [("SUs misfit", (name,)), missing()]
    told = replace(found, faults=(Fault("loose", name),))
    assert against(told) == [("faults", (name,)), missing()]


def test_an_su_that_no_result_may_fit_as_badly_as_is_to_be_set_right() -> None:
    assert is_to_repair(with_misfit(su=4))
    assert with_misfit(su=4).not_of_this_model == (calibration().model.tree.su_names[4],)
    badly = with_misfit(su=4, times=20.0)
    assert badly.unlike_sus.odd[4]
    assert not is_to_repair(badly)
    assert not is_to_repair(calibration())


def test_a_pose_unlike_the_rest_makes_it_fair() -> None:
    found = with_misfit(pose=-1)
    n_poses = found.features.n_poses
    assert found.quality == "fair"
    (doubt,) = (d for d in findings(found).doubts if d.kind == "poses misfit")
    assert doubt.number == 1
    assert f" {n_poses} poses" in doubt.words


def test_poses_predicted_worse_than_stated_make_it_fair() -> None:
    fit = calibration().goodness
    held_out = Share(9.0 * fit.held_out.chi2, fit.held_out.dof)
    found = replace(calibration(), goodness=replace(fit, held_out=held_out))
    assert found.quality == "fair"
    (doubt,) = (d for d in findings(found).doubts if d.kind == "prediction")
    assert doubt.number == pytest.approx(3 * np.sqrt(fit.prediction))
    assert f"{doubt.number:.1f} times" in doubt.words


def test_errors_that_come_back_make_it_fair() -> None:
    lacking = with_observability(widening=4.0)
    assert lacking.quality == "fair"
    assert "2.0 times" in line(lacking)


def test_a_fit_that_has_not_arrived_makes_it_fair() -> None:
    found = calibration()
    assert found.along is not None
    problem, fitted = found.along.problem, found.along.fitted
    places = fitted.state.placements
    elsewhere = replace(fitted.state, placements=replace(places, bias=places.bias + 0.01))
    along = replace(found.along, fitted=held(problem, elsewhere))
    off = replace(found, along=along)
    assert off.quality == "fair"
    ((kind, _), *_) = against(off)
    assert kind == "not arrived"
    assert f"{along.ahead.share:.1f} times" in line(off)
    assert found.along.ahead.share < 1 < along.ahead.share


def test_poses_that_can_not_be_predicted_are_no_fault() -> None:
    fit = calibration().goodness
    nothing = Share(0 * fit.held_out.chi2, 0 * fit.held_out.dof)
    found = replace(calibration(), goodness=replace(fit, held_out=nothing))
    assert np.isnan(found.goodness.prediction)
    assert found.quality == "good"
    assert "nan" not in line(found)


def test_a_weak_joint_makes_it_fair() -> None:
    tree = calibration().model.tree
    found = with_observability(joint_verdict=("determined",) * 5 + ("weak",))
    assert found.quality == "fair"
    assert against(found) == [("weak joints", (tree.joint_names[5],)), missing()]


def test_joints_that_are_not_observable_are_named_and_must_be_few() -> None:
    """Where branches meet in one joint, no recording tells their place along its axis."""
    tree = calibration().model.tree
    found = with_observability(joint_verdict=("not observable",) + ("determined",) * 5)
    assert found.quality == "good"
    assert against(found) == [("joints open", (tree.joint_names[0],)), missing()]
    many = with_observability(joint_verdict=("not observable",) * 4 + ("determined",) * 2)
    assert many.quality == "fair"


def test_a_bad_fit_promises_no_accuracy() -> None:
    along = calibration().along
    assert along is not None
    found = replace(calibration(), along=replace(along, misfit=900.0))
    assert line(found).startswith("bad: ")
    assert " mm" not in line(found)


def test_a_robot_of_which_all_sus_are_weak_is_bad_and_one_mostly_open_is_not_good() -> None:
    all_weak = with_observability(su_verdict=("weak",) * 7)
    assert all_weak.quality == "fair"
    assert all_weak.along is not None
    half_explained = replace(all_weak, along=replace(all_weak.along, misfit=7.0))
    assert half_explained.quality == "bad"
    # What a log can not show of some says nothing for the others.
    partly = with_observability(su_verdict=("weak",) * 4 + ("not observable",) * 3)
    assert replace(half_explained, observability=partly.observability).quality == "bad"
    assert all_weak.mostly_open
    assert against(all_weak) == [("SUs open", all_weak.model.tree.su_names)]
    # Rests alone show no position at all: what they show is worth something.
    rests = with_observability(su_verdict=("not observable",) * 7)
    assert rests.quality == "fair"
    assert rests.mostly_open
    assert not calibration().mostly_open


def test_rests_that_tell_how_sus_are_turned_are_of_use_and_others_are_not() -> None:
    none = ("not observable",) * 7
    directions = np.eye(6)
    shifts = with_observability(su_verdict=none, su_unobservable=(directions[:3],) * 7)
    assert findings(shifts).positions_open
    assert not is_to_repair(shifts)
    all_open = with_observability(su_verdict=none, su_unobservable=(directions,) * 7)
    assert findings(all_open).positions_open
    assert is_to_repair(all_open)
    most = (directions,) * 3 + (directions[:3],) * 4
    rests = with_observability(su_verdict=none, su_unobservable=most)
    assert not is_to_repair(rests)
    assert is_to_repair(replace(rests, notes=(*rests.notes, *lost("a", "b"))))


def lost(*sus: str) -> tuple[Note, ...]:
    """SUs whose readings no place in the tree explains."""
    return tuple(Note("su left out", sus=(su,), detail="no chain") for su in sus)


def test_a_tree_that_most_sus_fit_nowhere_in_is_of_no_use_before_they_do() -> None:
    """However well it explains the few that are left."""
    sound = calibration()
    placed = sound.observability.su_verdict.count("determined")
    few = replace(sound, notes=(*sound.notes, *lost("a", "b")))
    assert not few.mostly_open
    assert not is_to_repair(few)
    most = replace(sound, notes=(*sound.notes, *lost(*map(str, range(placed + 1)))))
    assert most.mostly_open
    assert is_to_repair(most)


def test_sus_before_the_model_do_not_vouch_for_it() -> None:
    """Those on the base and on the first joint read what they would of any robot."""
    found = with_observability(su_verdict=("weak",) * 7)
    tree, state = found.model.tree, found.estimate.state
    beyond = (tree.su_joint >= 0) & (tree.parent[tree.su_joint] >= 0)
    worse = np.flatnonzero(beyond)[: beyond.sum() // 2 + 1]
    bias = np.array(state.bias)
    bias[worse] = 7.0
    assert 2 * len(worse) > beyond.sum()
    other = replace(found.estimate, state=replace(state, bias=bias))
    assert replace(found, estimate=other).quality == "bad"


def test_a_refusal_names_no_physics_where_most_sus_are_explained(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    along = calibration().along
    assert along is not None
    found, far = calibration().estimate, replace(along, misfit=60.0, tried={"drift": 60.0})
    left = np.where(np.arange(len(found.tree.su_names)) == 0, 500.0, 1.0)
    monkeypatch.setattr(MotionEstimate, "misfit_of_sus", left)
    with pytest.raises(BadFitError) as refused:
        check_fit(found, far)
    what, remedy = why_bad(found, BAD_MISFIT, (60.0, left))
    assert (str(refused.value), refused.value.remedy) == (what, remedy)


def test_a_refusal_names_the_physics_that_explains_most() -> None:
    along = calibration().along
    assert along is not None
    far = replace(along, misfit=60.0, tried={"drift": 800.0, "elastic": 60.0})
    with pytest.raises(BadFitError) as refused:
        check_fit(calibration().estimate, far)
    likely = why_unexplained(far.tried, 60.0, "", "")
    assert all(words.strip("; ") in str(refused.value) for words in likely[:1])
    assert likely != why_unexplained({"drift": 60.0}, 60.0, "", "")
    check_fit(calibration().estimate, along)


def test_a_bad_result_that_is_not_written_names_the_physics_that_was_found(tmp_path: Path) -> None:
    all_weak = with_observability(su_verdict=("weak",) * 7)
    assert all_weak.along is not None

    def refused(causes: tuple[str, ...]) -> BadFitError:
        assert all_weak.along is not None
        along = slackened(all_weak.along, 1e-4) if "slack" in causes else all_weak.along
        along = replace(along, misfit=7.0, causes=causes)
        return not_to_be_saved(replace(all_weak, along=along), tmp_path / "robot.urdf")

    plain, yields, loose = map(refused, ((), ("elastic",), ("elastic", "slack")))
    for each, causes in ((yields, ("elastic",)), (loose, ("elastic", "slack"))):
        found = physics_found(causes)
        assert found is not None
        assert found[0] in str(each)
        assert found[1] in each.remedy
        assert found[0] not in str(plain)
    assert physics_found(()) is None
    # Where nothing was found, the figures that make it bad are said.
    assert re.findall(r"\d+", str(plain).split("robot.urdf")[1])[:3] == ["7", "0", "7"]


def stepped(n: int, **changes: Any) -> Calibration:
    """The calibration with readings of the first SUs that step by 20 mg half-way."""
    found, along = calibration(), calibration().along
    assert along is not None
    predicted = []
    for log in along.fitted.predicted:
        residual = log.residual.copy()
        residual[len(residual) // 2 :, :n] += 0.2
        predicted.append(replace(log, residual=residual))
    fitted = replace(along.fitted, predicted=tuple(predicted))
    return replace(found, along=replace(along, fitted=fitted, **changes))


def test_an_su_that_feels_more_than_noise_makes_it_fair() -> None:
    name = calibration().estimate.tree.su_names[0]
    found = stepped(1)
    assert found.misfit < 2.0
    assert found.quality == "fair"
    assert ("SUs misfit", (name,)) in against(found)
    told = replace(found, faults=(Fault("stepped", name),))
    assert "SUs misfit" not in dict(against(told))


def slackened(along: MotionEstimate, size: float) -> MotionEstimate:
    """The same with slack of some size [rad]."""
    loose = copy(along.problem)
    loose.priors = replace(loose.priors, unseen=np.array([size]))
    return replace(along, problem=loose, causes=("slack",))


def test_joints_that_would_be_off_by_more_than_any_gear_allows_make_it_bad(tmp_path: Path) -> None:
    """A tree that lacks a joint is explained by joints that stand elsewhere in every place."""
    along = calibration().along
    assert along is not None

    def with_slack(size: float) -> Calibration:
        return replace(calibration(), along=slackened(along, size))

    some, impossible = with_slack(0.02), with_slack(MOST_SLACK)
    assert some.quality == "good"
    assert "impossible slack" not in dict(against(some))
    assert impossible.quality == "bad"
    assert ("impossible slack", ()) in against(impossible)
    refused = not_to_be_saved(impossible, tmp_path / "robot.urdf")
    what, remedy = IMPOSSIBLE_SLACK
    assert what in str(refused)
    assert remedy in refused.remedy


def test_a_bad_result_names_the_few_sus_that_are_not_explained(tmp_path: Path) -> None:
    """A joint that yields is felt by most SUs; a bias that steps is felt by its own."""

    def told_of(n: int) -> tuple[str, ...]:
        bad = stepped(n, misfit=7.0)
        refused = str(not_to_be_saved(bad, tmp_path / "robot.urdf"))
        assert all(name in refused for name in bad.feel_more)
        return bad.feel_more

    names = calibration().estimate.tree.su_names
    assert told_of(0) == ()
    assert told_of(1) == names[:1]
    assert told_of(len(names) // 2) == names[: len(names) // 2]
    assert told_of(len(names)) == ()
