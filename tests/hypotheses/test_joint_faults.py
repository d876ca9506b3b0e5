"""Wrong encoders are named and corrected, hits are left out, and sound joints are not named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_robots import small_arm
from simulated import (
    PATTERNS,
    SHORT,
    changed_joints,
    features_of,
    held_against,
    simulation,
    simulation_of,
)

from skin2urdf.arrays import F64
from skin2urdf.calibration import by_physics
from skin2urdf.calibration.by_physics import without_false_hits
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.calibration.rounds import (
    Solution,
    estimate_once,
    estimate_robot,
    find_structure,
    predicted_curvature,
    sample_logs,
    take_features,
)
from skin2urdf.calibration.samples import fit_samples
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.arising import narrowed, turning_between
from skin2urdf.hypotheses.changes import turns_within
from skin2urdf.hypotheses.corrected import Corrected, errors_of, with_another
from skin2urdf.hypotheses.encoder import sharpened, sized_by_the_fit, without_doubtful_scales
from skin2urdf.hypotheses.records import Attempt
from skin2urdf.hypotheses.sense import TURNED, felt_at_rest
from skin2urdf.hypotheses.suspicions import suspicions
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.signals.contact import disturbances
from skin2urdf.signals.encoders import (
    corrected,
    corrected_features,
    leaps,
    reversal,
    standstill,
    turning_for,
)
from skin2urdf.signals.records import EncoderError
from skin2urdf.simulation import Simulation, SimulationSettings
from skin2urdf.simulation.faults import Sound
from skin2urdf.simulation.joint_faults import JOINT_FAULTS

OPTIONS: dict[str, Any] = {**SHORT, "excite": "all", "seed": 3}
JOINT = "j1"


@cache
def simulated(**options: object) -> Simulation:
    return simulation_of(small_arm(3), **{**OPTIONS, **options})


def recording(**options: object) -> Recording:
    return retimed(simulated(**options).recording)


@cache
def sound(settings: CalibrationSettings | None = None) -> Calibration:
    """The recording as it is."""
    return calibrate(recording(), settings)


def misreported(r: Recording, change: Callable[[F64, F64], F64], name: str = JOINT) -> Recording:
    """A recording in which one encoder reports a function of time and true position."""

    def wrong(joint: JointStream) -> JointStream:
        if joint.name != name:
            return joint
        return replace(joint, position=change(joint.time, joint.position))

    return changed_joints(r, wrong)


def position_error(found: Calibration, folder: Path) -> float:
    truth = simulated().truth.urdf
    return held_against(found, truth, folder).position.rms


@pytest.mark.parametrize(("degrees", "at"), [(1.0, 0.62), (-10.0, 0.45)])
def test_a_jump_is_named_with_its_time_and_size(degrees: float, at: float, tmp_path: Path) -> None:
    r = recording()
    t = at * r.duration
    wrong = misreported(r, lambda time, x: x + np.radians(degrees) * (time >= t))
    found = calibrate(wrong)
    (fault,) = found.faults
    assert (fault.kind, fault.subject) == ("encoder jump", JOINT)
    assert fault.unit == "rad"
    assert np.degrees(fault.size) == pytest.approx(degrees, abs=0.01)
    assert fault.begin == pytest.approx(t, abs=0.02)
    assert fault.log == 0
    assert 0 < np.degrees(fault.deviation) < 0.01
    assert found.quality == "fair"
    assert found.estimate.cost_per_dof < 1.3
    assert position_error(found, tmp_path) < 1.1 * position_error(sound(), tmp_path)


def solved(log: Recording) -> Solution:
    """What the patterns of a log say."""
    logs = sample_logs([log], CalibrationSettings(), Clock())
    first = take_features(logs, Clock())
    solution = estimate_robot(logs, first, find_structure(logs, first, Clock()), Clock())
    assert solution is not None
    return solution


@cache
def solved_panda() -> Solution:
    """An arm whose joints turn about every direction."""
    return solved(retimed(simulation("panda", **OPTIONS).recording))


@cache
def along_panda() -> MotionEstimate:
    """The same by all samples."""
    along = fit_samples(solved_panda(), lambda _: None)
    assert along is not None
    return along


def test_rests_tell_from_when_on_a_joint_counts_the_other_way() -> None:
    """Also those before the first pattern, and no other joint is taken for it."""
    found, features = solved_panda().found, solved_panda().features
    j, later = 3, 16
    d = features.dof_names.index(found.tree.joint_names[j])
    order = np.argsort(features.span[:, 0])
    q = np.array(features.q)
    q[order[:later], d] = 0.7 - q[order[:later], d]
    ratio = felt_at_rest(found, replace(features, q=q)).ratio[order]
    assert (ratio[:later, j] < TURNED).all()
    assert (ratio[later:, j] > 1 / TURNED).all()
    others = np.delete(ratio, j, axis=1)
    assert not (others[np.isfinite(others)] < TURNED).any()


def test_a_joint_has_turned_where_that_leaves_nothing_to_explain() -> None:
    """What one value to be mirrored about does for a single pose is no evidence."""
    found, features = solved_panda().found, solved_panda().features
    order = np.argsort(features.span[:, 0])
    turned = features.dof_names.index(found.tree.joint_names[3])
    motion = solved_panda().logs.sampled[0].motion
    assert not list(turns_within(found, features, motion))
    exchanged, late = np.array(features.coefficients), order[16:]
    exchanged[np.ix_(late, [2, 5])] = exchanged[np.ix_(late, [5, 2])]
    q = np.array(features.q)
    q[order[-1], turned] += 0.5
    assert not list(turns_within(found, replace(features, q=q, coefficients=exchanged), motion))
    # Rests before the first pattern have no more to say than gravity.
    early = features.span[:, 0] < 25.0
    q = np.array(features.q)
    q[early, turned] = 0.7 - q[early, turned]
    (turn,) = turns_within(found, replace(features, q=q), motion)
    assert turn.joint == 3
    assert turn.about == pytest.approx(0.7, abs=0.01)
    assert features.span[early, 0].max() < sum(turn.between) / 2 < features.span[~early, 1].min()


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_the_moves_tell_when_an_encoder_slipped(share: float) -> None:
    solution = solved_panda()
    (sampled,), features = solution.logs.sampled, solution.features
    time, joint, size = sampled.motion.grid.time, "panda_joint2", 0.1
    spans = features.span[np.argsort(features.span[:, 0])]
    gap = int(np.argmax(spans[1:, 0] - spans[:-1, 1]))
    end, begin = spans[gap, 1], spans[gap + 1, 0]
    known = EncoderError("offset", joint, size, 0, (end + begin) / 2, spread=(begin - end) / 2)
    at = end + share * (begin - end)
    q = np.array(sampled.motion.q)
    slip = size * (1 + np.tanh((time - at) / 0.06)) / 2
    q[:, sampled.motion.dof_names.index(joint)] += slip - size * (time >= known.begin)
    slipped = replace(sampled, motion=replace(sampled.motion, q=q))
    found = narrowed(known, solution.found, features, slipped)
    assert found.begin == pytest.approx(at, abs=0.05)
    assert 0.1 < found.spread < 0.5 * known.spread
    # Where no encoder has slipped, nothing tells.
    nothing = replace(known, size=1e-6)
    assert narrowed(nothing, solution.found, features, sampled) == nothing


@pytest.mark.parametrize(("kind", "known"), [("offset", 0.1), ("sign", 0.0)])
def test_a_wrong_encoder_is_corrected_by_as_much_as_the_fit_says(kind: str, known: float) -> None:
    """Also by what chance could have brought about, once it is known to be wrong.

    Where its sense changes, by what the value about which it is mirrored is off.
    """
    solution, joint, clock = solved_panda(), "panda_joint4", Clock()
    logs = solution.logs
    begin, size = 0.6 * logs.sampled[0].motion.grid.time[-1], 8e-5
    q = np.array(solution.features.q)
    later = solution.features.span.mean(axis=1) >= begin
    q[later, solution.features.dof_names.index(joint)] += size
    features = replace(solution.features, q=q)
    tree, state = solution.found.tree, solution.found.state
    found = estimate_once(logs, tree, features, state, clock)
    error = EncoderError(kind, joint, known or -1.0, 0, begin)
    disturbed = Attempt(
        (Corrected(error),), replace(solution, found=found, features=features), logs
    )
    after = sized_by_the_fit(disturbed, clock)
    *before, error = errors_of(after.amendments)
    assert [e.kind for e in before] == ["sign"] * (kind == "sign")
    assert (error.kind, error.begin) == ("offset", begin)
    assert error.size == pytest.approx(known + size, abs=size / 2)
    mended = after.solution
    np.testing.assert_allclose(mended.features.q, solution.features.q, atol=size / 2)
    score = {s.error.begin: s.gain for s in suspicions(mended.found, mended.features)
             if (s.error.kind, s.error.dof) == ("offset", joint)}  # fmt: skip
    assert score[min(score, key=lambda t: abs(t - begin))] < 0.01


def test_a_log_that_counts_the_other_way_does_so_about_zero() -> None:
    whole = Corrected(EncoderError("sign", "panda_joint4", -1.0, 0))
    now = Attempt((whole,), solved_panda(), solved_panda().logs)
    assert sized_by_the_fit(now, Clock()).amendments == (whole,)


def test_a_scale_that_is_not_certain_is_not_taken_off() -> None:
    """Nothing is said of it, and with it the robot would be of another size."""
    solution, joint, clock = solved_panda(), "panda_joint4", Clock()
    known = [s.error for s in suspicions(solution.found, solution.features)]
    (deviation,) = (e.deviation for e in known if (e.kind, e.dof) == ("scale", joint))

    def kept(size: float) -> Attempt:
        """Of two scales, of which one makes up for what is wrong with the features before."""
        doubtful = EncoderError("scale", joint, 1 + 3 * deviation)
        certain = EncoderError("scale", "panda_joint2", size)
        features = corrected_features(solution.features, doubtful)
        state = solution.found.state
        found = estimate_once(solution.logs, solution.found.tree, features, state, clock)
        both = replace(solution, found=found, features=features)
        last = Attempt((Corrected(doubtful), Corrected(certain)), both, solution.logs)
        return without_doubtful_scales(last, clock)

    after = kept(1.02)
    assert [e.dof for e in errors_of(after.amendments)] == ["panda_joint2"]
    np.testing.assert_allclose(after.solution.features.q, solution.features.q, rtol=1e-12)
    assert after.solution.found.misfit == pytest.approx(solution.found.misfit, rel=1e-6)
    assert kept(1.0 + 1e-9).amendments == ()


def test_an_error_that_the_features_contradict_needs_no_attempt() -> None:
    solution, joint, clock = solved_panda(), "panda_joint4", Clock()
    now = Attempt((), solution, solution.logs)
    assert sharpened(now, [EncoderError("scale", joint, 1.05)], clock) == []
    features = corrected_features(solution.features, EncoderError("scale", joint, 1 / 1.05))
    start = solution.found
    found = estimate_once(solution.logs, start.tree, features, start.state, clock)
    wrong = replace(now, solution=replace(solution, found=found, features=features))
    (known,) = sharpened(wrong, [EncoderError("scale", joint, 1.04)], clock)
    assert known.error.size == pytest.approx(1.05, abs=1e-4)


@pytest.mark.parametrize("factor", [1.02])
def test_a_wrong_scale_is_named_with_its_size(factor: float, tmp_path: Path) -> None:
    r = recording()
    wrong = misreported(r, lambda _, x: factor * x)
    found = calibrate(wrong, PATTERNS)
    (fault,) = found.faults
    assert (fault.kind, fault.subject) == ("encoder scale", JOINT)
    assert fault.size == pytest.approx(factor, abs=2e-4)
    assert abs(fault.size - factor) < 5 * fault.deviation
    assert position_error(found, tmp_path) < 1.1 * position_error(sound(PATTERNS), tmp_path)


@pytest.mark.parametrize(
    "options",
    [{"grade": "bma150"}, {"encoder_bits": 12}, {"encoder_bits": 12, "excite": "one"}],
)
def test_right_encoders_are_not_named(options: dict[str, object]) -> None:
    assert not sound().faults
    assert not calibrate(recording(**options), PATTERNS).faults


def test_all_samples_have_the_last_word_about_hits_alone() -> None:
    """What patterns show as a hit is none where nothing is left of all samples at its time."""
    solution = solved_panda()
    time = solution.logs.sampled[0].motion.grid.time
    begin, end = np.quantile(time, [0.5, 0.502])
    hit = Fault("contact", "panda_joint4", log=0, begin=begin, end=end)
    for fault, stays in ((hit, False), (replace(hit, kind="encoder jump"), True)):
        named = replace(solution, faults=(fault,))
        kept, _ = without_false_hits(named, along_panda(), solution.logs, solution, lambda _: None)
        assert (kept.faults == (fault,)) == stays


def test_nothing_that_yields_is_tried_with_a_hit_in_a_log_that_leaves_only_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It takes twenty times as long, and explains no hit."""
    most = list[float]()

    def watched(*_: object, **options: Any) -> object:
        most.append(options["most"])
        return along

    solution, along = solved_panda(), along_panda()
    monkeypatch.setattr(by_physics, "fit_samples", watched)
    named = replace(solution, faults=(Fault("contact", "panda_joint4", log=0, begin=9.0, end=9.3),))
    without_false_hits(named, along, solution.logs, solution, lambda _: None)
    monkeypatch.setattr(by_physics, "leaves_only_noise", lambda _: False)
    without_false_hits(named, along, solution.logs, solution, lambda _: None)
    assert most == [0.0, np.inf]


def test_leaps_are_found_to_their_sample_and_size() -> None:
    r = recording()
    begin, end = 30.0, 30.002
    wrong = misreported(r, lambda t, x: x + 0.05 * ((t >= begin) & (t < end)) - 0.3 * (t > 50))
    found = leaps(wrong, 2)
    assert [e.size for e in found] == pytest.approx([0.05, -0.05, -0.3], abs=2e-3)
    assert [e.begin for e in found] == pytest.approx([30.0, 30.002, 50.0], abs=5e-3)
    assert {(e.kind, e.dof, e.log) for e in found} == {("offset", JOINT, 2)}
    assert not leaps(r, 0)


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("ends", [False, True])
def test_what_a_track_sets_out_from_is_no_leap(samples: int, ends: bool) -> None:
    """All of the log would be off by what three samples say."""
    r = recording()
    (track,) = (j for j in r.joints if j.name == JOINT)
    x = track.position.copy()
    x[slice(-samples, None) if ends else slice(samples)] += 0.1
    assert not leaps(replace(r, joints=(replace(track, position=x),)), 0)


def test_samples_sent_twice_and_pauses_are_no_leaps() -> None:
    r = recording()
    (joint,) = (j for j in r.joints if j.name == JOINT)
    fast = int(np.argmax(np.abs(np.diff(joint.position))))
    rows = np.insert(np.arange(len(joint.time)), fast, fast)
    twice = replace(joint, time=joint.time[rows], position=joint.position[rows])
    late = np.where(np.arange(len(rows)) == fast + 1, 1e-5, 0.0)
    twice = replace(twice, time=twice.time + late)
    before = np.arange(len(joint.time)) <= fast
    later = np.abs(np.diff(joint.position, append=0.0)) < 1e-4
    later &= joint.time > joint.time[fast] + 2.0
    kept = before | (np.arange(len(before)) >= np.flatnonzero(later)[0])
    paused = replace(joint, time=joint.time[kept], position=joint.position[kept])
    for track in (twice, paused):
        assert not leaps(replace(r, joints=(track,)), 0)


def test_one_wrong_sample_moves_no_zero() -> None:
    r = retimed(simulation("panda", **OPTIONS).recording)
    (joint,) = (j for j in r.joints if j.name == "panda_joint4")
    slow = replace(joint, time=joint.time[::4], position=joint.position[::4])
    bend = int(np.argmax(np.abs(np.diff(slow.position, 2))))
    x = np.array(slow.position)
    x[bend + 2] += 0.3
    there, back = leaps(replace(r, joints=(replace(slow, position=x),)), 0)
    assert there.size == -back.size == pytest.approx(0.3, abs=5e-3)


def test_features_are_corrected_as_the_recording_is() -> None:
    r = recording()
    error = EncoderError("scale", JOINT, 1.25)
    raw, exact = features_of(r), features_of(corrected([r], [error])[0])
    features = corrected_features(raw, error)
    assert features.q == pytest.approx(exact.q, abs=1e-3)
    a, b = features.coefficients, exact.coefficients
    assert a == pytest.approx(b, abs=0.02 * np.abs(b).max())
    ratio = features.information.diagonal() / np.maximum(exact.information.diagonal(), 1e-12)
    assert np.median(ratio[ratio > 0]) == pytest.approx(1.0, rel=0.05)
    middle = raw.span.mean(axis=1)
    begin = float(np.median(middle))
    shifted = corrected_features(raw, EncoderError("offset", JOINT, 0.1, 0, begin))
    d = raw.dof_names.index(JOINT)
    moved = np.zeros(raw.q.shape)
    moved[middle > begin, d] = 0.1
    assert 0 < moved.sum() < 0.1 * raw.n_poses
    assert raw.q - shifted.q == pytest.approx(moved)


def test_errors_are_taken_off_their_log_and_joint() -> None:
    r = recording()
    errors = [EncoderError("offset", JOINT, 0.1, 1, 20.0), EncoderError("scale", JOINT, 2.0)]
    first, second = corrected([r, r], errors)
    j = [joint.name for joint in r.joints].index(JOINT)
    x, t = r.joints[j].position, r.joints[j].time
    assert first.joints[j].position == pytest.approx(x / 2)
    assert second.joints[j].position == pytest.approx((x - 0.1 * (t >= 20)) / 2)
    assert first.joints[j - 1] is r.joints[j - 1]


@pytest.mark.parametrize(("goes_on", "part"), [(False, 0.66), (True, 0.71283)])
def test_a_sense_that_changes_in_a_log_is_named_with_its_time(
    goes_on: bool, part: float, tmp_path: Path
) -> None:
    """The position takes the other sign while it moves, or is counted backwards where it turns."""
    r = recording()
    t = part * r.duration

    def wrong(time: F64, x: F64) -> F64:
        about = x[np.searchsorted(time, t) - 1] if goes_on else 0.0
        return np.where(time < t, x, 2 * about - x)

    turned = misreported(r, wrong)
    found = calibrate(turned, PATTERNS)
    (fault,) = found.faults
    assert (fault.kind, fault.subject) == ("encoder sign", JOINT)
    assert (fault.log, fault.begin) == (0, pytest.approx(t, abs=0.02))
    assert fault.to_repair
    assert position_error(found, tmp_path) < 1.1 * position_error(sound(PATTERNS), tmp_path)


@pytest.mark.parametrize("part", [0.3, 0.6])
def test_a_sense_that_changes_at_a_turning_point_shows_in_the_readings(part: float) -> None:
    """Its track looks as it would at other turning points near half of what positions add up to."""
    solution = solved(recording())
    (s,), found, features = solution.logs.sampled, solution.found, solution.features
    motion, j = s.motion, s.motion.dof_names.index(JOINT)
    time, x = motion.grid.time, motion.q[:, j]
    # Where it turns in its patterns, not where it rests.
    fast = np.abs(motion.qdd[1:, j]) > 1.0
    turning = np.flatnonzero((np.diff(np.sign(motion.qd[:, j])) != 0) & fast)
    at = int(turning[np.argmin(np.abs(turning - part * len(x)))])
    about = 2 * x[at]
    for late in (False, True):
        q = np.array(motion.q)
        other = slice(None, at) if late else slice(at, None)
        q[other, j] = about - q[other, j]
        misread = replace(s, motion=replace(motion, q=q))
        between = (float(time[at] - 8.0), float(time[at] + 5.0))
        begin, end = turning_between(JOINT, between, about, late, (found, features), misread)
        assert begin < time[at] < end
        assert end - begin < 1.0


def test_a_track_is_mirrored_where_it_turns_round() -> None:
    t = np.arange(0.0, 20.0, 0.008)
    x = 0.3 * np.sin(2.0 * t)
    n = 1300
    joint = JointStream("j", t, np.concatenate([x[:n], 2 * x[n - 1] - x[n:]]))
    at = reversal(joint, (4.0, 16.0))
    assert at is not None
    assert at == pytest.approx(t[n], abs=0.01)
    mended = corrected([Recording((joint,), ())], [EncoderError("sign", "j", -1.0, 0, at)])
    assert mended[0].joints[0].position == pytest.approx(x, abs=1e-3)


def test_a_slow_track_shows_where_it_turns_round() -> None:
    """Three encoder steps a sample, beside patterns that turn round ten times as sharply."""
    step, t = 5e-5, np.arange(0.0, 20.0, 0.004)
    size = 0.1 * np.clip((t - 10.0) / 2, 0.0, 1.0) ** 3
    x = 0.037 * t + size * np.sin(15.0 * t)
    n = int(np.searchsorted(t, 4.0))
    seen = np.round(x / step) * step
    turned = JointStream("j", t, np.concatenate([seen[:n], 2 * seen[n - 1] - seen[n:]]))
    assert reversal(turned, (1.0, 18.0)) == pytest.approx(t[n], abs=0.01)


def test_a_track_that_shows_nothing_turned_round_while_it_kept_still() -> None:
    t = np.arange(0.0, 20.0, 0.004)
    still = np.clip(t, 6.0, 8.0) - 6.0
    joint = JointStream("j", t, t - still)
    assert reversal(joint, (4.0, 16.0)) is None
    assert standstill(joint, (4.0, 16.0)) == pytest.approx(7.0, abs=0.02)


def test_of_several_standstills_the_longest_counts() -> None:
    t = np.arange(0.0, 20.0, 0.004)
    # It stands at 0 for a second, and at 0.8 for four.
    smooth = np.clip((t - 6.0) / 2, 0.0, 1.0)
    joint = JointStream("j", t, 0.8 * smooth**2 * (3 - 2 * smooth))
    assert standstill(joint, (5.0, 12.0)) == pytest.approx(10.0, abs=0.1)
    assert standstill(joint, (5.0, 7.0)) == pytest.approx(5.5, abs=0.1)


def test_what_later_positions_are_off_by_tells_when_a_track_was_mirrored() -> None:
    step, t = 5e-5, np.arange(0.0, 20.0, 0.004)
    # It stands at 0 for a second, creeps by 1 mrad, and stands at that for two.
    x = 1e-3 * np.clip(t - 6.0, 0.0, 1.0) + 0.1 * np.clip(5.0 - t, 0.0, 5.0)
    x = np.round((x + 0.1 * np.clip(t - 9.0, 0.0, 11.0)) / step) * step
    n = int(np.searchsorted(t, 6.6))
    seen = JointStream("j", t, np.concatenate([x[:n], 2 * x[n - 1] - x[n:]]))
    (off,) = corrected([Recording((seen,), ())], [EncoderError("sign", "j", -1.0, 0, 8.0)])
    size = float(off.joints[0].position[-1] - x[-1])
    assert abs(size) > 3e-4
    at = turning_for(seen, 8.0, size)
    assert at == pytest.approx(t[n], abs=0.1)
    (mended,) = corrected([Recording((seen,), ())], [EncoderError("sign", "j", -1.0, 0, at)])
    assert np.abs(mended.joints[0].position - x).max() < 2.1 * step
    assert turning_for(seen, 8.0, 5.0) is None


def test_what_an_encoder_reports_while_it_slips_is_left_out() -> None:
    logs = sample_logs([retimed(recording())], CalibrationSettings(), Clock())
    slipping = EncoderError("offset", JOINT, 0.1, 0, 30.0, spread=1.0)
    (sampled,), (left,) = logs.sampled, Corrected(slipping).left_out(logs).sampled
    time = sampled.motion.grid.time
    during = np.abs(time - 30.0) < 1.0
    assert not left.valid[during].any()
    np.testing.assert_array_equal(left.valid[~during], sampled.valid[~during])
    leap = replace(slipping, spread=0.0)
    assert Corrected(leap).left_out(logs) is logs


def test_a_leap_that_is_not_the_whole_change_leaves_its_time_open() -> None:
    features = features_of(recording())
    end, begin = np.sort(features.span.ravel())[[1, 2]]
    middle, half = (end + begin) / 2, (begin - end) / 2
    leap = Corrected(EncoderError("offset", JOINT, 0.1, 0, middle + half / 2))
    rest = EncoderError("offset", JOINT, 0.02, 0, middle, spread=half)
    both = with_another([leap], rest, features).error
    assert both.size == pytest.approx(0.12)
    assert both.begin == leap.error.begin
    assert both.begin - both.spread <= end
    assert both.begin + both.spread >= begin
    exact = with_another([leap], replace(rest, size=1e-5), features).error
    assert exact.spread == 0


@pytest.mark.parametrize("kind", ["encoder_slip", "gear_ratio", "encoder_sign"])
def test_a_simulated_fault_is_named(kind: str) -> None:
    whole = Sound(small_arm(3), SimulationSettings(**OPTIONS), simulated())
    fault = JOINT_FAULTS[kind](whole, np.random.default_rng(1))
    found = calibrate([retimed(r) for r in fault.recordings], PATTERNS)
    assert [(f.kind, f.subject) for f in found.faults] == [(fault.kind, fault.subjects[0])]
    assert found.quality == "fair"
    assert found.estimate.cost_per_dof < 1.3


def test_a_short_hit_stands_out_beyond_the_band_of_the_patterns() -> None:
    """2 mrad in 30 ms: what of that is slow enough for the features is lost in their noise."""
    solution = solved(recording())
    (sampled,), features = solution.logs.sampled, solution.features
    curvature, grid = predicted_curvature(solution.found, features), sampled.motion.grid
    assert disturbances([sampled], features, curvature) == ()
    pose = features.n_poses // 2
    middle, length = features.span[pose].mean(), 0.03
    since = grid.time - middle
    gone = 2e-3 * np.cos(np.pi * since / length) ** 4 * (np.abs(since) < length / 2)
    push = np.gradient(np.gradient(gone, since), since)
    readings = sampled.readings + push[:, None, None] * features.tau[pose, :, -1]
    (found,) = disturbances([replace(sampled, readings=readings)], features, curvature)
    assert found.pose == pose
    assert found.time == pytest.approx(middle, abs=length)
