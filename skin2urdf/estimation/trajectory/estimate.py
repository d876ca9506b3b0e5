"""An estimate from features made better by all samples of the logs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.attempt import BASE, BENDS, DRIFT, Explained
from skin2urdf.estimation.trajectory.causes import explained
from skin2urdf.estimation.trajectory.clocks import with_likely_clocks
from skin2urdf.estimation.trajectory.doubtful_fronts import (
    has_doubtful_fronts,
    without_doubtful_fronts,
)
from skin2urdf.estimation.trajectory.encoder_noise import (
    Shortening,
    hidden_lengths,
    without_shortening,
)
from skin2urdf.estimation.trajectory.fit import Fitted, fit, held, leading
from skin2urdf.estimation.trajectory.front_end import begin_front
from skin2urdf.estimation.trajectory.impossible_fronts import with_possible_fronts
from skin2urdf.estimation.trajectory.in_time import how_joints_were_read, with_times_open
from skin2urdf.estimation.trajectory.listening import found_gyros, listened
from skin2urdf.estimation.trajectory.misfit import (
    SPAN,
    misfit,
    misfit_of,
    misfit_of_links,
    span_means,
)
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.moving_base import FELT, standing_still
from skin2urdf.estimation.trajectory.priors import MotionPriors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import NEAR, fit_with_products
from skin2urdf.estimation.trajectory.publishers import with_deviations, with_publishers
from skin2urdf.estimation.trajectory.rocking import of_accelerations
from skin2urdf.estimation.trajectory.senses import in_likelier_sense
from skin2urdf.estimation.trajectory.sensors import with_likely_sensors, with_sensors_alike
from skin2urdf.estimation.trajectory.shaken_loads import ShakenLoads
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.time_scale import of_the_other_clock
from skin2urdf.estimation.trajectory.yielding import is_in_balance
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_OF_LINKS = 0.25
"""Part of a misfit that links have to be able to explain so that it is tried whether they yield:
half of what a cause has to explain to be added."""


def estimate_along(
    logs: Sequence[Trajectory],
    tree: KinematicTree,
    start: State,
    priors: MotionPriors,
    latency: F64,
    tell: Callable[[float], None] = lambda _: None,
    *,
    look_further: bool = True,
    only_known: bool = False,
    without: Collection[str] = (),
    most: float = np.inf,
    unless_one_changed: bool = False,
    unless_on_the_base: bool = False,
    iterations: int = 30,
    lengths: bool = True,
    alike: bool = False,
    mended: F64 | None = None,
) -> MotionEstimate:
    """Fit all samples of all logs.

    Args:
        logs: trajectories, with columns in the tree's order.
        tree: the structure.
        start: placements to begin with.
        priors: what is known before.
        latency: (U,) lag of each SU's clock to begin with [s].
        tell: told the share of the work that is done.
        look_further: whether elastic joints and drifting biases are tried where noise and
            placements do not explain the readings.
        only_known: then nothing but joints that yield under known torques is.
        without: causes of what drifts and bends that need not be tried, and ``felt`` for motion of
            the base that SUs on it feel.
        most: misfit beyond which they are not tried either.
        unless_one_changed: nor, if so, where the change of one SU explains what is left.
        unless_on_the_base: nor, if so, where an SU on a vertical first joint may sit on the base.
        iterations: linearisations, at most, of a first fit and of the last.
        lengths: whether what the noise of encoders does to lengths is taken off.
        alike: whether what the samples show of some sensors tells how good the others are.
        mended: (G, U, 2) latency [s] and drift [1] that were taken off each SU's stamps before.
    """
    U, G = tree.n_sus, len(logs)
    problem = MotionProblem(tree, logs, priors)
    clock = np.zeros((G, U, 2))
    clock[:, :, 0] = latency
    begin = MotionState(
        placements=start,
        gravity=priors.sensors.gravity,
        front=np.tile(begin_front(priors.front), (U, 1)),
        clock=clock,
        knots=tuple(np.zeros((n, U, 3)) for n in problem.layout.n_knots),
        unseen=np.zeros(problem.layout.n_unseen),
        gyro=np.zeros((U, problem.layout.gyro.stop - problem.layout.gyro.start)),
    )
    problem, fitted = _of_a_rigid_robot(problem, begin, iterations, lambda part: tell(0.7 * part))
    tell(0.7)
    moving_base = None
    if look_further and FELT not in without:
        problem, fitted, moving_base = standing_still(problem, fitted, yields=BASE not in without)
    mended = np.zeros_like(clock) if mended is None else mended
    about, there = with_likely_clocks(problem, fitted, begin, mended, iterations)
    if there is not fitted:
        # Which way a joint turns shows at the right times.
        problem, fitted = about, in_likelier_sense(about, there, start, iterations)
    problem, fitted, contradict = listened(problem, fitted)
    problem, fitted, late = with_publishers(
        problem, fitted, begin, lambda about, at: misfit_of(about, at, SPAN)
    )

    def look(without: Collection[str], *, unless: bool = False) -> Explained:
        found = Explained(problem, fitted)
        if look_further:
            found = explained(
                problem, fitted, most, only_known=only_known, without=without,
                unless_one_changed=unless and unless_one_changed,
                unless_on_the_base=unless and unless_on_the_base,
            )  # fmt: skip
        return with_likely_sensors(with_times_open(found), iterations)

    asked_without = without
    if look_further and not _links_may_explain(problem, fitted):
        without = {*without, *BENDS}
    found = look(without, unless=True)
    lengths = lengths and not (found.left_to_one or found.left_to_place)
    if found.causes and not are_plausible(found.fitted.state.placements).all():
        # What no sensor is has stood for another cause.
        others = {*without, *found.causes}
        other = look(others)
        if are_plausible(other.fitted.state.placements).all():
            found, without = other, others
    ended = _ended(found, mended, lengths=lengths, alike=alike)
    if alike and not is_in_balance(ended.problem, ended.fitted):
        # What sensors have in common changes loads that the log hardly tells by too much.
        ended = _ended(found, mended, lengths=lengths, alike=False)
    if not is_in_balance(ended.problem, ended.fitted):
        # Whatever yields so is nothing that carries loads.
        found = look({*without, *BENDS})
        ended = _ended(found, mended, lengths=lengths, alike=alike)
    problem, fitted = ended.problem, ended.fitted
    left = misfit_of(problem, fitted, SPAN)
    if late is not None:
        late = with_deviations(late, problem, fitted, left)
    tell(1.0)
    gyros = found_gyros(problem, fitted, contradict)
    what = found.causes, found.tried, found.under_known
    estimate = MotionEstimate(
        problem, fitted, left, gyros, *what, late, ended.corrected, ended.hidden, ended.loads,
        found.wander, found.left_to_one, found.left_to_place, *how_joints_were_read(found),
        moving_base,
    )  # fmt: skip
    if moving_base is not None and DRIFT in found.causes:
        # Sensors that warm up together all feel what one of them on the base does; up to a misfit
        # of 1 no more than noise is left of either.
        standing = estimate_along(
            logs, tree, start, priors, latency, tell, only_known=only_known,
            without={*asked_without, FELT}, most=most, unless_one_changed=unless_one_changed,
            iterations=iterations, lengths=lengths, alike=alike, mended=mended,
        )  # fmt: skip
        if standing.misfit <= max(left, 1.0) and set(standing.causes) <= set(found.causes):
            return standing
    return estimate


@dataclass(frozen=True, eq=False)
class _Ended:
    """A fit without what the noise of encoders does to it; attributes as those of the estimate."""

    problem: MotionProblem
    fitted: Fitted
    corrected: tuple[Shortening, ...] = ()
    hidden: tuple[tuple[F64, F64], ...] = ()
    loads: ShakenLoads | None = None


def _ended(found: Explained, mended: F64, *, lengths: bool, alike: bool) -> _Ended:
    """What explains the readings, with sensors alike and lengths as they are without noise."""
    problem, fitted = found.problem, found.fitted
    if alike:
        problem, fitted = with_sensors_alike(problem, fitted)
    if not lengths:
        return _Ended(problem, fitted)
    fitted, corrected, loads = without_shortening(problem, fitted)
    drift = mended[..., 1] + fitted.state.clock[..., 1]
    hidden = (
        *hidden_lengths(problem, fitted, corrected),
        *of_the_other_clock(problem, fitted, drift),
        *of_accelerations(problem, fitted),
    )
    return _Ended(problem, fitted, corrected, hidden, loads)


def _of_a_rigid_robot(
    problem: MotionProblem,
    begin: MotionState,
    iterations: int,
    tell: Callable[[float], None],
) -> tuple[MotionProblem, Fitted]:
    """The fit of a rigid robot with what readings hold beyond low-passed motion.

    Where samples are many, part of them leads so near that all of them are gone through as seldom
    as can be.
    """
    few = leading(problem)
    about, fitted = _led(few or problem, begin, iterations, tell)
    doubtful = has_doubtful_fronts(fitted)
    if doubtful:
        about, fitted = without_doubtful_fronts(about, fitted, iterations)
    if few is None:
        return about, fitted
    problem, fitted = fit_with_products(problem, held(problem, fitted.state), iterations)
    if not doubtful and has_doubtful_fronts(fitted):
        problem, fitted = without_doubtful_fronts(problem, fitted, iterations)
    return problem, fitted


def _led(
    problem: MotionProblem, begin: MotionState, iterations: int, tell: Callable[[float], None]
) -> tuple[MotionProblem, Fitted]:
    """The fit from where it begins, with joints in the likelier sense, and products of motions."""
    fitted = fit(problem, begin, iterations=iterations, tolerance=NEAR, tell=tell)
    fitted = in_likelier_sense(problem, fitted, begin.placements, iterations)
    problem, fitted = fit_with_products(problem, fitted, iterations)
    return with_possible_fronts(problem, fitted, iterations)


def _links_may_explain(problem: MotionProblem, fitted: Fitted) -> bool:
    """Whether what is left over may be for the most part due to links that yield."""
    means = span_means(problem, fitted.predicted, fitted.weights, SPAN)
    of_links = misfit_of_links(*means, problem.tree.su_joint)
    return of_links > _OF_LINKS * misfit(*means)
