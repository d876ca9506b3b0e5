"""SUs that slipped, or whose bias stepped, as all samples show: one SU before, and one after.

Features around poses tell of slips of some degrees. What is left of all samples tells of smaller
ones, of logs without any pattern, and of biases that step, with which orientations stay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.calibration.by_physics import gained, worth_of
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.calibration.rounds import Logs, Solution, relinearise, take_features
from skin2urdf.calibration.samples import fit_samples, rejected, with_samples
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.estimation.problem.state import N_PLACEMENT, State
from skin2urdf.estimation.solve.estimate import estimate
from skin2urdf.estimation.trajectory.deviations import change_covariance
from skin2urdf.estimation.trajectory.displaced import Displaced, displaced
from skin2urdf.estimation.trajectory.misfit import MOST_OF_IT
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.faults import Fault
from skin2urdf.geometry.so3 import rotation_log
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.hypotheses.slip import (
    LEAST_SHIFT,
    LEAST_TURN,
    PLACED,
    Moment,
    Slipped,
    as_one,
    fresh,
    like_an_encoder,
)
from skin2urdf.structure.chain_fit import LEVER
from skin2urdf.structure.gravity import gravity_features, gravity_windows
from skin2urdf.structure.ordering import places_of
from skin2urdf.structure.records import KinematicTree

_FAR = 5.0
"""Standard deviations from which a change is certain, of a turn or shift from which it is no jump
of an encoder, and of slack from which it is none: of a thousand SUs none is so far by chance."""


def with_sus_apart(
    solution: Solution, along: MotionEstimate, clock: Clock, *, of_patterns: bool
) -> tuple[Solution, MotionEstimate]:
    """The robot with SUs taken apart that changed at some time, where that explains their readings.

    One SU after the other is, as long as the model leaves more of any than noise, most of that is
    gone with the change, and the fit with it leaves hardly more than noise. Several that changed at
    one moment did not do so by themselves, and stay as they were: an encoder that jumps makes all
    SUs beyond it look so.

    Args:
        solution: the estimate.
        along: the fit of all samples.
        clock: runs the stages.
        of_patterns: whether the estimate rests on patterns, rather than on rests and moves.

    Returns:
        The solution and its fit, with what has changed among its faults.
    """
    begun, changes = (solution, along), list[Slipped]()
    while (change := _changed(solution, along, clock)) is not None:
        if any(_at_once(change.at, other.at) for other in changes):
            return begun
        apart = _taken_apart(solution, along, change, of_patterns, clock)
        if apart is None:
            break
        solution, along = apart
        changes.append(change)
    return solution, along


def with_sus_together(
    solution: Solution, along: MotionEstimate, clock: Clock
) -> tuple[Solution, MotionEstimate]:
    """The robot without the slips that features told and that all samples do not need.

    Features of a wrong tree show slips that the right one explains, and coarse encoders bend them
    by more than they tell: with both placements all samples are then hardly likelier than with one.

    Args:
        solution: the estimate, with slips of features among its faults.
        along: the fit of all samples.
        clock: runs the stages.
    """
    worth = worth_of(N_PLACEMENT, along)
    for fault in solution.faults:
        if fault.kind != "loose" or not set(fault.sus) <= set(along.problem.tree.su_names):
            continue
        if _needed(along, *fault.sus) > worth:
            continue
        together = _together(solution, along, fault, clock)
        if together is not None and gained(together[1], along) <= worth:
            solution, along = together
    return solution, along


def _needed(along: MotionEstimate, name: str, earlier: str) -> float:
    """Logarithm of the likelihood that all samples lose without an SU's change, as far as linear.

    The bias changes as well there, so that no less is lost than that.
    """
    second, first = (along.problem.tree.su_names.index(n) for n in (name, earlier))
    change, covariance = _change(along, first, second), _covariance(along, first, second)
    return 0.5 * len(change) * _distance(change, covariance)


def _together(
    solution: Solution, along: MotionEstimate, fault: Fault, clock: Clock
) -> tuple[Solution, MotionEstimate] | None:
    """With one SU in place of two; None where that leaves more than noise."""
    name, earlier = fault.sus
    logs, tree = as_one(solution.logs, solution.found.tree, name, earlier)
    state = _of_sus(along.state, places_of(tree.su_names, along.problem.tree.su_names))
    try:
        whole = _estimated(replace(solution, logs=logs), tree, state, True, clock)
    except Skin2UrdfError:
        return None
    whole = replace(whole, faults=tuple(f for f in solution.faults if f is not fault))
    again = clock.run("all samples", lambda tell: fit_samples(whole, tell, without=rejected(along)))
    if again is None or not again.misfit_of_sus[tree.su_names.index(name)] <= GOOD_FIT:
        return None
    return whole, again


def _changed(solution: Solution, along: MotionEstimate, clock: Clock) -> Slipped | None:
    """The SU that changed for certain and explains most by that; None where there is none."""
    suspicious = np.nan_to_num(along.misfit_of_sus) > GOOD_FIT
    if not suspicious.any():
        return None
    seen = clock.run("all samples", lambda _: displaced(along.problem, along.fitted, suspicious))
    if not seen or seen[0].share < MOST_OF_IT:
        return None
    name = along.problem.tree.su_names[seen[0].su]
    earlier = fresh(f"{name}_before", solution.logs.su_names)
    return Slipped(name, earlier, _moment(seen[0], solution.logs))


def _taken_apart(
    solution: Solution, along: MotionEstimate, change: Slipped, of_patterns: bool, clock: Clock
) -> tuple[Solution, MotionEstimate] | None:
    """With an SU taken apart; None where that does not explain its readings."""
    logs, tree = change.of_placements(solution.logs, solution.found.tree)
    names = along.problem.tree.su_names
    state = _of_sus(along.state, np.append(np.arange(len(names)), names.index(change.name)))
    try:
        apart = _estimated(replace(solution, logs=logs), tree, state, of_patterns, clock)
    except Skin2UrdfError:
        return None
    # What all other SUs do not show, this one alone would not either.
    again = clock.run("all samples", lambda tell: fit_samples(apart, tell, without=rejected(along)))
    if again is None:
        return None
    both = [again.problem.tree.su_names.index(n) for n in (change.earlier, change.name)]
    if not again.misfit_of_sus[both].max() <= GOOD_FIT:
        return None
    fault = _fault(again, change)
    if fault is None or _may_be_slack(fault, again):
        return None
    found, closely = with_samples(apart.found, again), _closely(again, *both)
    if fault.kind == "loose" and like_an_encoder(found, change.name, change.earlier, closely):
        fault = replace(fault, detail="or its encoder")
    return replace(apart, faults=(*apart.faults, fault)), again


def _moment(change: Displaced, logs: Logs) -> Moment:
    """When an SU changed, in the times of the logs."""

    def of_log(log: int, time: float) -> tuple[int, float]:
        return log, time + logs.sampled[log].motion.grid.start

    return Moment(of_log(*change.until), of_log(*change.since))


def _at_once(one: Moment, other: Moment) -> bool:
    """Whether two changes may have come at the same time."""
    return one.until <= other.since and other.until <= one.since


def _of_sus(state: State, sus: Int) -> State:
    """A state with the SUs of some numbers, be they fewer or more."""
    return State(
        state.T_parent_joint, state.T_joint_su[sus], state.up, state.bias[sus], state.shape[sus]
    )


def _estimated(
    solution: Solution, tree: KinematicTree, start: State, of_patterns: bool, clock: Clock
) -> Solution:
    """The estimate of other logs and another tree from features of its kind.

    Raises:
        InsufficientDataError: an SU has too little to one side of its change.
    """
    logs = solution.logs
    if of_patterns:
        known = dict(zip(solution.features.su_names, solution.features.latency, strict=True))
        latency = np.array([known.get(name, 0.0) for name in logs.su_names])
        features = take_features(logs, clock, latency=latency)
        found, features = relinearise(logs, tree, features, clock, start=start)
        return replace(solution, found=found, features=features)
    features = gravity_features(gravity_windows(logs.sampled, logs.su_names), logs.sampled)
    settings = logs.settings.estimation
    found = clock.run(
        "estimation",
        lambda tell: estimate(features, tree, settings, start, search=False, tell=tell),
    )
    return replace(solution, found=found, features=features)


def retold(solution: Solution, along: MotionEstimate) -> Solution:
    """The solution with what changed of SUs as all samples tell it.

    Features tell a turn from a bias that steps in few poses.

    Args:
        solution: an estimate, with slips among its faults.
        along: the fit of all samples of its logs.
    """

    def again(fault: Fault) -> Fault:
        names = fault.sus if fault.kind == "loose" else ()
        known = bool(names) and set(names) <= set(along.problem.tree.su_names)
        return (_of_all_samples(fault, along) if known else None) or fault

    return replace(solution, faults=tuple(map(again, solution.faults)))


def _fault(along: MotionEstimate, change: Slipped) -> Fault | None:
    """What has changed, as all samples tell it; None where they do not."""
    (log, begin), (end_log, end) = change.at.until, change.at.since
    fault = Fault(
        "loose", change.name, log=log, begin=begin, end=end, end_log=end_log,
        sus=(change.name, change.earlier),
    )  # fmt: skip
    return _of_all_samples(fault, along)


def _of_all_samples(fault: Fault, along: MotionEstimate) -> Fault | None:
    """What has changed: where the SU sits, or its bias, whichever the readings need more.

    None where they do not need any change for certain.
    """
    second, first = (along.problem.tree.su_names.index(n) for n in fault.sus)
    change, covariance = _change(along, first, second), _covariance(along, first, second)
    shift, turn, bias = change[:3], change[3:N_PLACEMENT], change[N_PLACEMENT:]
    placed = _is_placed(along, first, second)
    of_placement = slice(0 if placed else 3, N_PLACEMENT)
    of_bias = slice(N_PLACEMENT, len(covariance))
    far = _distance(change[of_placement], covariance[of_placement, of_placement])
    matters = np.linalg.norm(turn) > LEAST_TURN or (placed and np.linalg.norm(shift) > LEAST_SHIFT)
    own = covariance[of_bias, of_bias]
    everything = slice(of_placement.start, None)
    if _distance(change[everything], covariance[everything, everything]) < _FAR**2:
        return None
    if matters and far > _distance(bias, own):
        distance = float(np.linalg.norm(shift)) if placed else np.nan
        return replace(fault, size=distance, unit="m", turn=float(np.linalg.norm(turn)))
    size = float(np.linalg.norm(bias))
    deviation = float(np.sqrt(bias @ own @ bias)) / max(size, 1e-300)
    return replace(
        fault, kind="bias step", size=size / GRAVITY, unit="g", deviation=deviation / GRAVITY,
        turn=np.nan,
    )  # fmt: skip


def _may_be_slack(fault: Fault, along: MotionEstimate) -> bool:
    """Whether a change is no more than what joints do that lie elsewhere within their slack.

    A link that is turned by an angle tilts gravity by so many g, and shifts what is at an arm's end
    by that part of the arm.
    """
    if fault.kind == "bias step":
        return fault.size < _FAR * along.slack
    return max(fault.turn, float(np.nan_to_num(fault.size)) / LEVER) < _FAR * along.slack


def _distance(change: F64, covariance: F64) -> float:
    """Square of a change over its covariance, per number."""
    return float(change @ np.linalg.pinv(covariance, hermitian=True) @ change) / len(change)


def _closely(along: MotionEstimate, first: int, second: int) -> tuple[float, float]:
    """Turn [rad] and shift [m] that a change between two SUs may have beside what it seems to be.

    The shift is infinite where it is not known where both SUs are.
    """
    variance = np.diag(_covariance(along, first, second))
    turn, shift = _FAR * np.sqrt([variance[3:6].max(), variance[:3].max()])
    return float(turn), float(shift) if _is_placed(along, first, second) else np.inf


def _is_placed(along: MotionEstimate, first: int, second: int) -> bool:
    """Whether it is known where two SUs are."""
    variances = np.einsum("uii->ui", along.su_covariances[[first, second]])[:, :3]
    return bool(variances.max() < PLACED**2)


def _change(along: MotionEstimate, first: int, second: int) -> F64:
    """(9,) shift [m], turn [rad] and change of bias [m/s^2] from one SU to another."""
    T, bias = along.state.T_joint_su, along.state.bias
    moved = np.linalg.inv(T[first]) @ T[second]
    turn = rotation_log(moved[:3, :3])
    return np.concatenate([moved[:3, 3], turn, bias[second] - bias[first]])


def _covariance(along: MotionEstimate, first: int, second: int) -> F64:
    """(9, 9) of the change of placement and bias between two SUs, each seen in its own frame."""
    own = change_covariance(along.fitted.equations, first, second)
    return np.asarray(max(1.0, along.misfit) * own[: N_PLACEMENT + 3, : N_PLACEMENT + 3])
