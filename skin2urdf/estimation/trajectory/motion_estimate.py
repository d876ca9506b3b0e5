"""What all samples along the logs say, and what that is worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.ahead import Ahead, step_ahead
from skin2urdf.estimation.trajectory.attempt import PLAY
from skin2urdf.estimation.trajectory.carried_along import CarriedAlong, carried_along
from skin2urdf.estimation.trajectory.deviations import su_covariances
from skin2urdf.estimation.trajectory.elastic import UnderKnown
from skin2urdf.estimation.trajectory.encoder_noise import (
    Shortening,
    whole_of,
)
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.following import follow_motion
from skin2urdf.estimation.trajectory.front_end import droop, droop_variance
from skin2urdf.estimation.trajectory.gears import Ratios, Uneven
from skin2urdf.estimation.trajectory.information import MotionInformation, motion_information
from skin2urdf.estimation.trajectory.leaning import with_leaning_base, with_pulls_on_leaning
from skin2urdf.estimation.trajectory.misfit import (
    SPAN,
    misfit_of_sus,
    span_means,
)
from skin2urdf.estimation.trajectory.moving_base import MovingBase
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.publishers import Late
from skin2urdf.estimation.trajectory.records import Gyros
from skin2urdf.estimation.trajectory.rounded import lost_in_averages, rounded_off_again
from skin2urdf.estimation.trajectory.shaken_loads import ShakenLoads
from skin2urdf.estimation.trajectory.slack import LEVER, MOST_SLACK, lacking
from skin2urdf.estimation.trajectory.swaying import swaying
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.estimation.trajectory.unsure import unsure
from skin2urdf.estimation.trajectory.warming import scale_drifts


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
            biases and ``warming`` scales, ``nonlinearity`` of sensors, joints of another ``ratio``
            than they are said to have, ``harmonics`` and ``ripples`` of gears and encoders, zeros
            that ``creep`` and those ``homed`` in between, ``clock`` of joints and SUs that wander,
            ``lags`` of joints that are read one after another, joints ``smoothed`` by their driver,
            ``slack`` from place to place.
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
        left_to_place: whether none was, as an SU on a vertical joint may sit on the base instead.
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
    left_to_place: bool = False
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
        lacks = [*self._unsure_of(again), *self.hidden, (self.ahead.joint, self.ahead.su)]
        defects += with_pulls_on_leaning(self.problem, self.fitted, lacks)
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
    def ratios(self) -> F64:
        """(D,) by how much further each joint moves than its encoder says, over that [1]."""
        own = [x for group, x in self._unseen if isinstance(group, Ratios)]
        return own[0] if own else np.zeros(self.problem.tree.n_joints)

    @cached_property
    def unevenness(self) -> F64:
        """(D,) by how much uneven gears and encoders alone put each link off at most [rad].

        0 where none do, whatever else puts a link off.
        """
        D, logs = self.problem.tree.n_joints, self.problem.logs
        off = [np.zeros((len(log.kept), D)) for log in logs]
        for group, x in self._unseen:
            if isinstance(group, Uneven):
                for g, log in enumerate(logs):
                    off[g] += (group.moved(log, g, x).q - log.q)[log.kept]
        return np.asarray(np.abs(np.concatenate(off)).max(axis=0, initial=0.0))

    @property
    def _unseen(self) -> list[tuple[Unseen, F64]]:
        """Groups of what encoders do not see, each with its numbers (S,)."""
        unseen = self.problem.unseen
        groups = () if unseen is None else unseen.several or (unseen,)
        ends = np.cumsum([group.n_numbers for group in groups])[:-1].astype(np.int64)
        return list(zip(groups, np.split(self.fitted.state.unseen, ends), strict=False))

    @property
    def slack(self) -> float:
        """What encoders leave of a joint's position from place to place, its learnt size [rad]."""
        return float(self.problem.priors.unseen[-1]) if "slack" in self.causes else 0.0

    @property
    def slack_is_none(self) -> bool:
        """Whether joints would have to be off by more than any slack: something else is wrong."""
        if PLAY not in self.causes:
            return self.slack >= MOST_SLACK
        unit = np.where(self.problem.tree.prismatic, LEVER, 1.0)
        return max(self.slack, float((self.deflections / unit).max())) >= MOST_SLACK

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
