"""An estimate from features made better by all samples of the logs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.ahead import Ahead, step_ahead
from skin2urdf.estimation.trajectory.attempt import BENDS, DRIFT, Explained
from skin2urdf.estimation.trajectory.carried_along import CarriedAlong, carried_along
from skin2urdf.estimation.trajectory.causes import explained
from skin2urdf.estimation.trajectory.clocks import with_likely_clocks
from skin2urdf.estimation.trajectory.deviations import su_covariances
from skin2urdf.estimation.trajectory.doubtful_fronts import (
    has_doubtful_fronts,
    without_doubtful_fronts,
)
from skin2urdf.estimation.trajectory.elastic import UnderKnown
from skin2urdf.estimation.trajectory.encoder_noise import (
    Shortening,
    hidden_lengths,
    whole_of,
    without_shortening,
)
from skin2urdf.estimation.trajectory.fit import Fitted, fit, held, leading
from skin2urdf.estimation.trajectory.following import follow_motion
from skin2urdf.estimation.trajectory.front_end import begin_front, droop, droop_variance
from skin2urdf.estimation.trajectory.gyro import gyro_deviations
from skin2urdf.estimation.trajectory.impossible_fronts import with_possible_fronts
from skin2urdf.estimation.trajectory.in_time import how_joints_were_read, with_times_open
from skin2urdf.estimation.trajectory.information import MotionInformation, motion_information
from skin2urdf.estimation.trajectory.leaning import with_leaning_base
from skin2urdf.estimation.trajectory.listening import found_gyros, listened
from skin2urdf.estimation.trajectory.misfit import (
    SPAN,
    misfit,
    misfit_of,
    misfit_of_links,
    misfit_of_sus,
    span_means,
)
from skin2urdf.estimation.trajectory.moving_base import FELT, MovingBase, standing_still
from skin2urdf.estimation.trajectory.priors import MotionPriors
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import NEAR, fit_with_products
from skin2urdf.estimation.trajectory.publishers import Late, with_deviations, with_publishers
from skin2urdf.estimation.trajectory.records import Gyros
from skin2urdf.estimation.trajectory.rocking import of_accelerations
from skin2urdf.estimation.trajectory.rounded import lost_in_averages, rounded_off_again
from skin2urdf.estimation.trajectory.senses import in_likelier_sense
from skin2urdf.estimation.trajectory.sensors import with_likely_sensors, with_sensors_alike
from skin2urdf.estimation.trajectory.shaken_loads import ShakenLoads
from skin2urdf.estimation.trajectory.slack import MOST_SLACK, lacking
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.estimation.trajectory.swaying import swaying
from skin2urdf.estimation.trajectory.time_scale import of_the_other_clock
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.estimation.trajectory.unsure import unsure
from skin2urdf.estimation.trajectory.warming import scale_drifts
from skin2urdf.estimation.trajectory.yielding import is_in_balance
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_OF_LINKS = 0.25
"""Part of a misfit that links have to be able to explain so that it is tried whether they yield:
half of what a cause has to explain to be added."""


@dataclass(frozen=True, eq=False)
class MotionEstimate:
    """What all samples along the logs say.

    Attributes:
        problem: the logs and what was known before.
        fitted: the fit.
        misfit: squares of mean residuals over spans of time, over what noise makes of them; up to 1
            where the model explains the readings.
        gyros: what was found of gyroscopes; None where no SU has one.
        causes: what was added to a rigid robot with steady sensors: ``elastic`` joints, a ``base``
            that gives way, ``tilts`` of one that moves by itself, ``play`` of joints, ``drift`` of
            biases, ``nonlinearity`` of sensors, ``harmonics`` and ``ripples`` of gears, ``clock``
            of joints and SUs that wander, ``lags`` of joints that are read one after another,
            joints ``smoothed`` by their driver, ``slack`` from place to place.
        tried: misfit with each cause that was tried, chosen or not.
        under_known: what joints yield under torques that are known, the first of what encoders do
            not see; None where none do, or torques are not known.
        late: clocks of publishers of joint states; None where none is off.
        corrected: what the noise of encoders does to lengths and was taken off.
        hidden: parts (J,) and (U, n) of the gradient, each of something that it hides, or that
            nothing tells of the clock of a limb.
        loads: what it does through the loads that links bend under; None where they do not.
        wander: per log (N,) by how much later its readings were taken as clocks wander [s]; ()
            where they do not.
        left_to_one: whether no cause was tried, as what is left is the change of a single SU.
        ages: (D,) by how much older the positions of each joint are than those of all in the mean,
            under one stamp [s]; 0 where all are as old as each other.
        smoothing: (D,) by how much each joint is further per acceleration than it was read [s^2];
            0 where none is smoothed.
        moving_base: motion of the base that SUs on it felt, which was taken off what all read; None
            where they felt none.
        unreached: part of a joint's accelerations, the largest, that the last term of the series
            makes up by which smoothing is undone; what is beyond it is left.
    """

    problem: MotionProblem
    fitted: Fitted
    misfit: float
    gyros: Gyros | None = None
    causes: tuple[str, ...] = ()
    tried: Mapping[str, float] = field(default_factory=dict)
    under_known: UnderKnown | None = None
    late: Late | None = None
    corrected: tuple[Shortening, ...] = ()
    hidden: tuple[tuple[F64, F64], ...] = ()
    loads: ShakenLoads | None = None
    wander: tuple[F64, ...] = ()
    left_to_one: bool = False
    ages: F64 = field(default_factory=lambda: np.zeros(0))
    smoothing: F64 = field(default_factory=lambda: np.zeros(0))
    unreached: float = 0.0
    moving_base: MovingBase | None = None

    @property
    def state(self) -> State:
        """Placements, gravity's directions, bias and shape."""
        return self.fitted.state.placements

    @property
    def positions(self) -> F64:
        """(N, D) positions of the joints where samples are compared, in all logs [rad or m]."""
        return np.concatenate([log.q[log.kept] for log in self.problem.logs])

    @property
    def positions_of_joints(self) -> dict[str, F64]:
        """The same by the names of joints, each (N,)."""
        return dict(zip(self.problem.tree.joint_names, self.positions.T, strict=True))

    @cached_property
    def information(self) -> MotionInformation:
        """What the fit is worth: a quarter of the work, for those who ask."""
        problem, fitted = with_leaning_base(self.problem, self.fitted)
        sways = swaying(problem, fitted.state)
        again = rounded_off_again(problem.logs)
        lost = lost_in_averages(problem.logs)
        kinds = {"sways": sways, "again": again, "lost": lost}
        groups = {kind: each for kind, each in kinds.items() if each is not None}
        defects, rounding = [], None
        if groups:
            seen = lacking(problem, fitted, list(groups.values()))
            number = {kind: i for i, kind in enumerate(groups)}
            if sways is not None:
                defects.append(seen.pull(number["sways"]))
            if again is not None:
                rounding = seen.pulls(number["again"])
            if lost is not None:
                defects += zip(*seen.pulls(number["lost"]), strict=True)
        if self.moving_base is not None:
            defects += self.moving_base.unsure(problem, fitted)
        end = self.problem.layout.unseen.stop
        none = np.zeros(problem.layout.unseen.stop - end)
        lacks = [*self._unsure_of(again), *self.hidden, (self.ahead.joint, self.ahead.su)]
        defects += [(np.insert(joint, end, none), own) for joint, own in lacks]
        return motion_information(problem, fitted, defects, rounding, misfit=self.misfit)

    def _unsure_of(self, again: Unseen | None) -> list[tuple[F64, F64]]:
        """Parts of the gradient by which what was taken off for encoders' noise may be off.

        Args:
            again: what encoders round off, drawn anew.
        """
        through = self.loads.off if self.loads is not None else []
        if not self.corrected:
            return through
        groups = [each.joints for each in self.corrected]
        *each_off, all_off = unsure(
            self.problem, self.fitted, again, [*groups, np.concatenate(groups)]
        )
        joint, su = self.fitted.shaken.pull(self.problem, self.fitted.state)
        return [
            *((off * c.joint, off * c.su) for off, c in zip(each_off, self.corrected, strict=True)),
            (all_off * joint, all_off * su),
            *through,
        ]

    @cached_property
    def ahead(self) -> Ahead:
        """The step that the fit did not take."""
        return step_ahead(self.fitted, whole_of(self.corrected) if self.corrected else None)

    @property
    def misfit_of_sus(self) -> F64:
        """(U,) the misfit of each SU alone; NaN for one without samples."""
        return misfit_of_sus(*self._span_means)

    @cached_property
    def unexplained(self) -> Bool:
        """(U,) SUs of which is left what follows the joints' positions or accelerations."""
        follow = follow_motion(self.fitted, self.problem.tree.prismatic)
        return np.asarray(follow | self.carried_along.unexplained)

    @cached_property
    def carried_along(self) -> CarriedAlong:
        """SUs of which is left what follows accelerations, and whose these are."""
        return carried_along(self.fitted)

    @property
    def scatter(self) -> float:
        """By how much the misfit of one SU exceeds 1 by chance, five standard deviations."""
        return 5.0 * float(np.sqrt(2 / (3 * max(1, len(self._span_means[0])))))

    @cached_property
    def _span_means(self) -> tuple[F64, F64]:
        return span_means(self.problem, self.fitted.predicted, self.fitted.weights, SPAN)

    @property
    def droops(self) -> F64:
        """(U,) what each SU's own low-pass takes away, per square of angular frequency [s^2]."""
        return droop(self.fitted.state.front)

    @property
    def base_motion(self) -> F64:
        """(6,) by how much the base shifts along and turns about its axes, largest less smallest.

        In metres and radians; 0 where it does not give way.
        """
        return np.asarray(np.max([np.ptp(x, axis=0) for x in self._base_motions], axis=0))

    @cached_property
    def _base_motions(self) -> tuple[F64, ...]:
        return self.problem.base_motions(self.fitted.state)

    @property
    def tilt_of_base(self) -> float:
        """Angle by which the base turns about where it is in the mean of a log, rms [rad]."""
        turns = [x[:, 3:] - x[:, 3:].mean(axis=0) for x in self._base_motions]
        return float(np.sqrt((np.concatenate(turns) ** 2).sum(axis=1).mean()))

    def compliance(self, covariance: F64) -> tuple[F64, F64]:
        """(D,) what each joint yields per torque that is known, and its standard deviation.

        Args:
            covariance: (J, J) of the joint part, in the layout's order.

        Returns:
            In rad/(N m) or m/N; NaN of joints that bear nothing, and where no torques are known.
        """
        elastic, D = self.under_known, self.problem.tree.n_joints
        if elastic is None:
            return np.full(D, np.nan), np.full(D, np.nan)
        n, first = elastic.n_numbers, self.problem.layout.unseen.start
        own = slice(first, first + n)
        return elastic.compliances(self.fitted.state.unseen[:n], covariance[own, own], D)

    @cached_property
    def su_covariances(self) -> F64:
        """(U, n, n) of each SU's own coordinates, as the layout has them."""
        return su_covariances(self.fitted.equations)

    @property
    def droop_deviations(self) -> F64:
        """(U,) standard deviations of the droops [s^2]."""
        front = self.problem.layout.front
        return np.sqrt(droop_variance(self.su_covariances[:, front, front]))

    @property
    def drifts(self) -> F64:
        """(U,) by how much each SU's bias changes within a log, largest less smallest [m/s^2]."""
        knots = self.fitted.state.knots
        ranges = [np.ptp(k, axis=0).max(axis=1) for k in knots if len(k)]
        return np.max(ranges, axis=0) if ranges else np.zeros(self.problem.tree.n_sus)

    @property
    def scale_drifts(self) -> F64:
        """(U, 3) by how much the scale of each axis changes within a log [1]."""
        return scale_drifts(self.fitted.state)

    @property
    def wandering(self) -> tuple[float, ...]:
        """Per log, by how much clocks of joints and SUs wander: largest less smallest lag [s].

        Without what an offset and a drift make of it.
        """
        return tuple(
            float(
                np.ptp(late - np.polyval(np.polyfit(log.since_middle, late, 1), log.since_middle))
            )
            for log, late in zip(self.problem.logs, self.wander, strict=False)
        )

    @property
    def curvature(self) -> tuple[F64, F64]:
        """(U, 3) what an axis reads beyond a straight line, per square, and standard deviations.

        In s^2/m; 0 where axes are straight.
        """
        found, at = self.fitted.state.curvature, self.problem.layout.curvature
        if not found.size:
            none = np.zeros((self.problem.tree.n_sus, 3))
            return none, none
        variances = np.einsum("uii->ui", self.su_covariances)[:, at]
        return found, np.sqrt(variances.clip(0.0))

    @property
    def slack(self) -> float:
        """What encoders leave of a joint's position from place to place, its learnt size [rad]."""
        return float(self.problem.priors.unseen[-1]) if "slack" in self.causes else 0.0

    @property
    def slack_is_none(self) -> bool:
        """Whether joints would have to be off by more than any slack: something else is wrong."""
        return self.slack >= MOST_SLACK

    @cached_property
    def widest_slack(self) -> tuple[F64, ...]:
        """Per log (D,) by how much each joint's slack differs between two places [rad or m].

        The learnt size is common to all joints; one that crosses its play shows more of it.
        """
        D, unseen = self.problem.tree.n_joints, self.problem.unseen
        if unseen is None or not self.slack:
            return tuple(np.zeros(D) for _ in self.problem.logs)
        # Slack is what was added last, and all its numbers are of one size.
        of_slack = self.problem.priors.unseen == self.slack
        x = unseen.units * np.where(of_slack, self.fitted.state.unseen, 0.0)[unseen.number]
        of_joint = [unseen.joint == j for j in range(D)]
        return tuple(
            np.array([np.ptp(each[:, unseen.columns[mine]] @ x[mine]) for mine in of_joint])
            for each in unseen.on_grid
        )

    @property
    def deflections(self) -> F64:
        """(D,) by how much each link is beyond its encoder at most [rad or m]; 0 where it is not.

        Joints that yield, gears that are uneven and slack, together.
        """
        logs = self.problem.deflections(self.fitted.state)
        return np.asarray(np.abs(np.concatenate(logs)).max(axis=0, initial=0.0))


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
        problem, fitted, moving_base = standing_still(problem, fitted)
    mended = np.zeros_like(clock) if mended is None else mended
    about, there = with_likely_clocks(problem, fitted, begin, mended, iterations)
    if there is not fitted:
        # Which way a joint turns shows at the right times.
        problem, fitted = about, in_likelier_sense(about, there, iterations)
    problem, fitted, contradict = listened(problem, fitted)
    problem, fitted, late = with_publishers(
        problem, fitted, begin, lambda about, at: misfit_of(about, at, SPAN)
    )

    def look(without: Collection[str], unless_one_changed: bool = False) -> Explained:
        found = Explained(problem, fitted)
        if look_further:
            found = explained(
                problem, fitted, most, only_known=only_known, without=without,
                unless_one_changed=unless_one_changed,
            )  # fmt: skip
        return with_likely_sensors(with_times_open(found), iterations)

    asked_without = without
    if look_further and not _links_may_explain(problem, fitted):
        without = {*without, *BENDS}
    found = look(without, unless_one_changed)
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
        found.wander, found.left_to_one, *how_joints_were_read(found), moving_base,
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
    fitted = in_likelier_sense(problem, fitted, iterations)
    problem, fitted = fit_with_products(problem, fitted, iterations)
    return with_possible_fronts(problem, fitted, iterations)


def _links_may_explain(problem: MotionProblem, fitted: Fitted) -> bool:
    """Whether what is left over may be for the most part due to links that yield."""
    means = span_means(problem, fitted.predicted, fitted.weights, SPAN)
    of_links = misfit_of_links(*means, problem.tree.su_joint)
    return of_links > _OF_LINKS * misfit(*means)


def motion_priors(
    sensors: Priors, *, gravity: float, front: tuple[F64, F64], gyro: bool = True
) -> MotionPriors:
    """What is commonly known before logs are read.

    Args:
        sensors: of bias, scale and cross-axis.
        gravity: standard deviation of its magnitude [m/s^2].
        front: mean and standard deviation (2,) of sensors' front ends [s^2].
        gyro: whether gyroscopes have errors.
    """
    return MotionPriors(
        sensors=sensors,
        gravity=gravity,
        front=np.stack(front),
        lag=1.0,
        drift=1e-2,
        bias_walk=0.0,
        unseen=np.zeros(0),
        gyro=gyro_deviations(float(front[1].max())) * gyro,
    )
