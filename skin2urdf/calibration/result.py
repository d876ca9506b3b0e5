"""The result of a calibration: everything the URDF, the JSON and the report are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.vertical import NEAREST
from skin2urdf.estimation.uncertainty.goodness import Goodness
from skin2urdf.estimation.uncertainty.observability import Observability
from skin2urdf.estimation.uncertainty.open_directions import ALIKE
from skin2urdf.estimation.uncertainty.outliers import (
    Unlike,
    poses_unlike_the_rest,
    sus_unlike_the_rest,
)
from skin2urdf.estimation.uncertainty.physics import IMPOSSIBLE_SLACK, physics_found
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.faults import Fault
from skin2urdf.geometry.se3 import inverse
from skin2urdf.model.records import KinematicModel, OpenDirection
from skin2urdf.model.several_axes import turned_about_several_axes
from skin2urdf.notes import Note, Noted, of_kind
from skin2urdf.signals.records import Features, JointClock, SuClock
from skin2urdf.structure.activity import Activity

Quality = Literal["good", "fair", "bad"]

GOOD_FIT = 2.0
"""Cost per degree of freedom up to which the model explains the data, and squared errors of
predicted poses, over stated variances, and errors that come back wherever the robot does the same,
over noise, up to which the stated uncertainty can be believed."""
BAD_FIT = 50.0
"""Cost per degree of freedom beyond which no URDF is written."""


HOPELESS_FIT = 1000.0
"""Cost per degree of freedom of the features beyond which all samples are not asked. Gears that
yield by 3 mrad leave 11, so that a degree, which fits of all samples can follow, leaves 400; a
joint whose encoder is bent by 0.2 rad leaves 9,000, and its samples lead nowhere."""

CHIEF = 0.1
"""Part of the largest error of an encoder from which a joint is named beside it."""
UNDONE = 0.3
"""Part of a joint's accelerations that the last term of what undoes a smoothing may make up: with a
tenth, of means over 120 ms in patterns, errors were as stated, with all of it, of 150 ms, six times
as large."""
BAD_MISFIT = 20.0
"""What all samples leave, over noise, beyond which no URDF is written. Gears that yield by 3 mrad
leave 11, and errors of 1.4 times what is then stated; a joint whose encoder is bent by 0.2 rad
leaves 43, biases of 5 mg that are denied 24, and nothing that is stated holds."""


@dataclass(frozen=True)
class Source:
    """One input log.

    Attributes:
        path: where it was read from.
        digest: SHA-256 of its bytes.
        duration: its length [s].
    """

    path: str
    digest: str
    duration: float


@dataclass(frozen=True)
class SuSource:
    """Where an SU's readings come from.

    Attributes:
        topic: the topic they came on.
        rate: readings per second [Hz].
        bandwidth: one-sided noise bandwidth [Hz] of what features were taken from; a noise density
            is the features' noise over the square root of twice that.
        twice_bandwidth: the same of what all samples are fitted to, which is low-passed twice.
        duration: of the longest log that holds it [s].
    """

    topic: str
    rate: float
    bandwidth: float
    twice_bandwidth: float
    duration: float


def wrong_ratios(along: MotionEstimate) -> dict[str, float]:
    """By how much further joints move than their encoders say, over that [1], by their names.

    Those are left out that do by a small part of what the one does that is most off.

    Args:
        along: the fit of all samples.
    """
    ratios, names = along.ratios, along.problem.tree.joint_names
    least = CHIEF * np.abs(ratios).max(initial=0.0)
    return {n: float(x) for n, x in zip(names, ratios, strict=True) if abs(x) > least}


@dataclass(frozen=True, eq=False)
class Calibration(Record):
    """A finished calibration.

    Attributes:
        model: the robot, in canonical frames (extended DH); base z is up.
        estimate: how it was found, in the estimation's frames.
        along: what all samples along the logs say; None where patterns alone count.
        observability: what of it the log determines; same frames as ``estimate``.
        goodness: how well it explains the features, part by part.
        features: the regressions around poses it rests on; None where the estimate was made
            from samples of logs without patterns around poses.
        activity: evidence of the structure.
        limits: (D, 2) range of each joint seen in the logs [rad or m].
        velocity: (D,) largest speed of each joint seen [rad/s or m/s].
        continuous: (D,) True where a joint turns without end.
        sources: the input logs.
        settings: the choices made.
        faults: what is wrong with SUs, encoders or the recording, and was mended or left out.
        notes: what else was found; what the reader says and what of the sensors is in words.
        seconds: time each stage took [s].
        clocks: for each log, the SUs whose clock ran differently from the joints'.
        su_sources: where the SUs' readings come from, by name.
        publishers: for each log, publishers of joint states whose clock is off that of most joints.
    """

    model: KinematicModel
    estimate: Estimate
    along: MotionEstimate | None
    observability: Observability
    goodness: Goodness
    features: Features | None
    activity: Activity
    limits: F64
    velocity: F64
    continuous: Bool
    sources: tuple[Source, ...]
    settings: CalibrationSettings
    faults: tuple[Fault, ...]
    notes: tuple[Noted, ...]
    seconds: dict[str, float]
    clocks: tuple[tuple[SuClock, ...], ...] = ()
    su_sources: Mapping[str, SuSource] = field(default_factory=dict)
    publishers: tuple[tuple[JointClock, ...], ...] = ()

    @property
    def T_canonical_joint(self) -> F64:
        """(D, 4, 4) the estimation's joint frames in those of ``model``, on the same axes."""
        tree = self.model.tree
        T = np.tile(np.eye(4), (tree.n_joints + 1, 1, 1))  # the last one is the RS, parent -1
        for j, parent in enumerate(tree.parent):
            estimated = T[parent] @ self.estimate.state.T_parent_joint[j]
            T[j] = inverse(self.model.T_parent_joint[j]) @ estimated
        return np.asarray(T[:-1])

    @property
    def open_directions(self) -> tuple[OpenDirection, ...]:
        """What the log leaves open between branches, in the frames of ``model`` and the URDF."""
        frames = dict(zip(self.model.tree.joint_names, self.T_canonical_joint, strict=True))
        return tuple(each.seen_from(frames) for each in self.observability.open_directions)

    @property
    def log_of_pose(self) -> Int:
        """(P,) log that each pose of the estimate comes from."""
        return self.estimate.cost.blocks.log

    @property
    def misfit(self) -> float:
        """What the model leaves of the readings over what noise makes of it; near 1 or below.

        Of all samples where they were fitted, else the features' cost per degree of freedom.
        """
        return self.estimate.cost_per_dof if self.along is None else self.along.misfit

    @property
    def largest_misfit(self) -> float:
        """The misfit beyond which nothing can be believed."""
        return BAD_FIT if self.along is None else BAD_MISFIT

    @cached_property
    def quality(self) -> Quality:
        """How far the result can be trusted: whether the model explains the readings, and more.

        It is good only if poses are predicted as well as stated, errors do not come back where the
        robot does the same, the fit of all samples has arrived, nothing is wrong with an SU, a pose
        or an encoder, no sensor would need an error that none has, every SU with readings has a
        place, and one alone, that nothing else moves, and joints one order, no joints have moved
        alike all along, no joint is weak, half of the joints are determined, and the base stands
        still, since lengths may else be off by more than is stated.

        It is bad where the readings are not explained, or by more slack than joints have, or where
        positions were smoothed by more than can be undone, or only in part while no SU that a
        recording could place is determined, or where most of these are not and most would need
        errors that no sensor has: then it is the model that is wrong, which SUs on the base fit
        whatever it is; and so it is where an SU feels motion that its place in the tree does not
        explain.

        What no recording can tell must not spoil it, such as where branches that meet in one joint
        sit along its axis.
        """
        if not self.misfit <= self.largest_misfit or self.needs_impossible_slack:
            return "bad"
        if self.is_smoothed_away:
            return "bad"
        if self.misfit > GOOD_FIT and self._placed and "determined" not in self._placed:
            return "bad"
        if self.unexplained or (self.mostly_open and self.mostly_implausible):
            return "bad"
        goodness, seen = self.goodness, self.observability
        explained = max(self.misfit, goodness.prediction, seen.widening) <= GOOD_FIT
        explained &= not self.not_arrived
        alike = not (self.unlike_sus.odd.any() or self.unlike_poses.odd.any() or self.feel_more)
        verdicts = seen.joint_verdict
        known = "weak" not in verdicts and 2 * verdicts.count("determined") >= len(verdicts)
        known &= not self.mostly_open
        sound = not self.faults and not self.base_gives_way and not self.without_a_place
        sound &= not (self.turn_of_base or self.tilt_of_base or self.wrong_ratios)
        sound &= not (self.of_two_places or self.open_orders or self.moved_alike)
        sound &= not self.moved_otherwise
        sound &= not self.implausible
        return "good" if explained and alike and known and sound else "fair"

    @property
    def without_a_place(self) -> tuple[str, ...]:
        """SUs that were left out because no place in the tree explains their readings."""
        left_out = of_kind(self.notes, "su left out")
        return tuple(su for note in left_out if note.detail == "no chain" for su in note.sus)

    @property
    def of_two_places(self) -> tuple[tuple[str, str], ...]:
        """SUs that may sit on the base as well as on a joint, whichever the tree has, and it.

        An SU on the base may always sit on a vertical axis itself; that does not count.
        """
        told = of_kind(self.notes, "vertical axis")
        doubtful = [n for n in told if n.detail == "active" or n.size > NEAREST]
        return tuple((su, note.joints[0]) for note in doubtful for su in note.sus)

    @property
    def open_orders(self) -> tuple[Note, ...]:
        """Orders of joints that the log does not tell from those taken, where SUs show which it is.

        Where both carry SUs alike to twice what is stated of one at most, no order matters.
        """
        seen = self.observability
        variances = np.einsum("uii->ui", seen.su_covariance)[:, :3].sum(axis=1)
        known = [verdict == "determined" for verdict in seen.su_verdict]
        alike = 2 * float(np.sqrt(variances[known].max(initial=0.0)))
        return tuple(n for n in of_kind(self.notes, "other order") if not n.size <= alike)

    @property
    def moved_otherwise(self) -> tuple[str, ...]:
        """SUs that a joint moves which is in no tree, as it neither turns nor slides them."""
        told = of_kind(self.notes, "moves otherwise")
        return tuple(dict.fromkeys(su for note in told for su in note.sus))

    @property
    def moved_alike(self) -> tuple[tuple[str, ...], ...]:
        """Joints that moved alike all along: what sits beyond one may sit beyond another."""
        return tuple(note.joints for note in of_kind(self.notes, "moved alike"))

    @property
    def unexplained(self) -> tuple[str, ...]:
        """SUs without a fault that feel motion which their place in the tree does not explain."""
        return () if self.along is None else unexplained_sus(self.along, self.faults)

    @property
    def carried_along(self) -> tuple[tuple[str, str], ...]:
        """Pairs of an SU and a joint that carries it along, although it does not turn it."""
        tree = self.model.tree
        return tuple(
            (tree.su_names[u], tree.joint_names[j])
            for u, j in self._not_turned
            if (u, j) not in self._pushed_back
        )

    @property
    def recoiling(self) -> tuple[tuple[str, str], ...]:
        """Pairs of an SU and a joint beyond it, from which it recoils; on the base one does."""
        tree = self.model.tree
        return tuple((tree.su_names[u], tree.joint_names[j]) for u, j in self._pushed_back)

    @cached_property
    def _not_turned(self) -> tuple[tuple[int, int], ...]:
        """Pairs of an SU and a joint whose accelerations it follows, and that does not turn it."""
        if self.along is None:
            return ()
        tree, joint = self.model.tree, self.along.carried_along.joint
        return tuple(
            (int(u), int(joint[u]))
            for u in np.flatnonzero(joint >= 0)
            if tree.su_names[u] in self.unexplained and joint[u] not in tree.chain(tree.su_joint[u])
        )

    @cached_property
    def _pushed_back(self) -> tuple[tuple[int, int], ...]:
        """Those of them whose joint comes after the SU, where one of these SUs is on the base.

        No joint carries along what is on the base: it gives way. Without any such SU what is pushed
        back looks like the plate of a parallelogram.
        """
        tree = self.model.tree
        before = tuple(
            (u, j) for u, j in self._not_turned if tree.su_joint[u] in (-1, *tree.chain(j)[:-1])
        )
        return before if any(tree.su_joint[u] < 0 for u, _ in before) else ()

    @property
    def feel_more(self) -> tuple[str, ...]:
        """SUs that feel more than the model and noise, where at least half of all feel no more.

        What links and joints do is felt by most: these SUs, or what carries them, are suspicious.
        """
        if self.along is None:
            return ()
        names, misfits = self.along.problem.tree.su_names, self.along.misfit_of_sus
        more = np.flatnonzero(misfits > GOOD_FIT)
        return tuple(names[u] for u in more) if 2 * len(more) <= len(names) else ()

    @property
    def not_arrived(self) -> bool:
        """Whether the fit of all samples ended where more is still to change than noise leaves."""
        return self.along is not None and self.along.ahead.is_most

    @property
    def physics(self) -> tuple[str, str] | None:
        """What was found that a rigid robot has not, and what to do about it; None if nothing."""
        if self.needs_impossible_slack:
            return IMPOSSIBLE_SLACK
        return None if self.along is None else physics_found(self.along.causes)

    @property
    def base_gives_way(self) -> bool:
        """Whether the base was found to move under the robot's load."""
        return self.along is not None and "base" in self.along.causes

    @property
    def wrong_ratios(self) -> dict[str, float]:
        """By how much further some joints move than their encoders say, over that [1]."""
        return {} if self.along is None else wrong_ratios(self.along)

    @property
    def is_smoothed_away(self) -> bool:
        """Whether fast motion was smoothed away before positions were logged, beyond recovery."""
        return self.along is not None and self.along.unreached > UNDONE

    @property
    def tilt_of_base(self) -> float:
        """Angle by which the base was found to tilt by itself, rms [rad]; 0 where it does not."""
        tilts = self.along is not None and "tilts" in self.along.causes
        return self.along.tilt_of_base if self.along is not None and tilts else 0.0

    @property
    def turn_of_base(self) -> float:
        """Angle by which the base turned in half a second while no joint moved [rad]; 0 if none.

        Nor where all samples follow it by what SUs on it feel.
        """
        if self.along is not None and self.along.moving_base is not None:
            return 0.0
        return max((note.size for note in of_kind(self.notes, "base moves")), default=0.0)

    @property
    def mostly_open(self) -> bool:
        """Whether more than half of the SUs that a recording could place are not determined.

        Those that no place in the tree explains are among them. Where all axes are parallel, none
        could be placed, and more than half of all are held against it.
        """
        placed = self._placed or list(self.observability.su_verdict)
        return 2 * placed.count("determined") < len(placed) + len(self.without_a_place)

    @property
    def implausible(self) -> tuple[str, ...]:
        """SUs that would need errors that no working sensor has: that, or their place, is wrong."""
        plausible = are_plausible(self.estimate.state)
        names = self.estimate.tree.su_names
        return tuple(name for name, may_be in zip(names, plausible, strict=True) if not may_be)

    @property
    def mostly_implausible(self) -> bool:
        """Whether most SUs that a recording could place need errors that no working sensor has.

        Where all axes are parallel, so that none could, most that joints move.
        """
        told = self._beyond if self._beyond.any() else self.model.tree.su_joint >= 0
        plausible = are_plausible(self.estimate.state)[told]
        return bool(2 * plausible.sum() < len(plausible))

    @property
    def needs_impossible_slack(self) -> bool:
        """Whether all samples are explained by joints that are further off than any encoder."""
        return self.along is not None and self.along.slack_is_none

    @property
    def _placed(self) -> list[str]:
        """Verdicts on SUs that a recording could place."""
        verdicts = self.observability.su_verdict
        return [v for v, b in zip(verdicts, self._beyond, strict=True) if b]

    @property
    def _beyond(self) -> Bool:
        """(U,) SUs that joints turn about axes which are not parallel; no other is ever placed."""
        return turned_about_several_axes(self.model, ALIKE)

    @property
    def unlike_sus(self) -> Unlike:
        """How the SUs fit, compared with each other."""
        return sus_unlike_the_rest(self.goodness.by_block)

    @property
    def not_of_this_model(self) -> tuple[str, ...]:
        """SUs without a fault that fit so badly, where others do not, that no result may be as bad.

        What is wrong with them, or with their place in the tree, is not known.
        """
        unlike, names = self.unlike_sus, self.model.tree.su_names
        known = {fault.subject for fault in self.faults if fault.to_repair}
        bad = unlike.odd & (np.nan_to_num(unlike.times) > BAD_FIT)
        return tuple(n for n, ill in zip(names, bad, strict=True) if ill and n not in known)

    @property
    def unlike_poses(self) -> Unlike:
        """How the poses fit, compared with each other."""
        return poses_unlike_the_rest(self.goodness.by_block, self.goodness.patterned)


def unexplained_sus(along: MotionEstimate, faults: Sequence[Fault]) -> tuple[str, ...]:
    """SUs without a fault that feel motion which their place in the tree does not explain.

    Args:
        along: the fit of all samples.
        faults: what is known to be wrong.
    """
    known = {fault.subject for fault in faults}
    names = np.array(along.problem.tree.su_names)[along.unexplained].tolist()
    return tuple(name for name in names if name not in known)
