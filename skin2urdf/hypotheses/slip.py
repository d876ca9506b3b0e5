"""SUs that slipped are taken apart: one SU for each of their placements."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import Bool, Int
from skin2urdf.calibration.rounds import Logs
from skin2urdf.estimation.problem.state import N_PLACEMENT
from skin2urdf.estimation.solve.arrow import factor
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.geometry.so3 import rotation_log
from skin2urdf.hypotheses.attempts import Search, of_logs
from skin2urdf.hypotheses.loose import Slip, slips
from skin2urdf.hypotheses.records import Amendment, Attempt, Candidate
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.records import KinematicTree

_STRADDLED = 4.0
"""Chi-squared per measurement of a pose, over the median, from which an SU slipped inside of it."""
_TURN, _SHIFT, _SHARE = np.deg2rad(0.2), 1e-3, 0.05
"""What an SU may move beside its joint [rad, m, and of the motion with the joint] and still be
taken for fixed, with the joint's encoder at fault: as much as poor encoders leave uncertain."""
PLACED = 0.01
"""Standard deviation [m] up to which a place counts as known."""
LEAST_TURN, LEAST_SHIFT = np.deg2rad(0.05), 0.3e-3
"""What a slip exceeds in one or the other [rad, m]."""
_TICK = 1e-6
"""Time [s] by which moments are apart: far less than samples, far more than rounding."""


@dataclass(frozen=True)
class Moment:
    """When an SU slipped: after ``until`` and before ``since``, each log and time [s]."""

    until: tuple[int, float]
    since: tuple[int, float]

    @classmethod
    def between(cls, features: Features, before: int, after: int) -> Moment:
        """From the end of one pose to the beginning of another."""
        return cls(
            (int(features.log[before]), float(features.span[before, 1])),
            (int(features.log[after]), float(features.span[after, 0])),
        )


@dataclass(frozen=True)
class Slipped(Amendment):
    """An SU that sits elsewhere from some moment on.

    Attributes:
        name: the SU, which keeps its name for its last placement.
        earlier: name of the SU that stands for the placement before.
        at: when it slipped.
    """

    name: str
    earlier: str
    at: Moment

    @property
    def key(self) -> Hashable:
        """The slip, whenever it was."""
        return "slip", self.name, self.earlier

    @property
    def subject(self) -> str:
        """The SU."""
        return self.name

    @property
    def parameters(self) -> int:
        """Those of another placement."""
        return N_PLACEMENT

    def of_placements(self, logs: Logs, tree: KinematicTree) -> tuple[Logs, KinematicTree]:
        """Logs and tree with one SU for each placement."""
        if self.name not in tree.su_names:
            return logs, tree
        u = logs.su_names.index(self.name)
        sampled = [_doubled(s, u, log, self.at) for log, s in enumerate(logs.sampled)]
        doubled = replace(logs, sampled=sampled, su_names=(*logs.su_names, self.earlier))
        if self.earlier in tree.su_names:
            return doubled, tree
        joint = tree.su_joint[tree.su_names.index(self.name)]
        names, joints = (*tree.su_names, self.earlier), np.append(tree.su_joint, joint)
        return doubled, replace(tree, su_names=names, su_joint=joints)


class Slips:
    """SUs that slipped."""

    rank: Literal[0, 1, 2] = 0

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:  # noqa: ARG002
        """Every SU whose readings fit two placements far better than one."""
        if now is None:
            return []
        found, features = now.solution.found, now.solution.features
        order = np.lexsort((features.span[:, 0], features.log))
        out = [
            self._candidate(slip, found, features, now.whole.su_names)
            for slip in slips(found, order)
        ]
        # An SU may slip while the robot is in a pose.
        for old in now.amendments:
            if not isinstance(old, Slipped):
                continue
            names = found.tree.su_names
            if old.name not in names or old.earlier not in names:
                continue
            inside = _straddled(found, old.name, old.earlier, old.at, features)
            if inside is not None:
                who = [names.index(old.name), names.index(old.earlier)]
                left = (found.chi2_by_block - found.count)[:, who].clip(min=0).sum()
                moved = replace(old, at=inside)
                out.append(Candidate("slip in a pose", (old.name,), (moved,), float(left)))
        return out

    def _candidate(
        self, slip: Slip, found: Estimate, features: Features, taken: Sequence[str]
    ) -> Candidate:
        name = found.tree.su_names[slip.su]
        earlier = fresh(f"{name}_before", taken)
        new = Slipped(name, earlier, Moment.between(features, slip.before, slip.after))

        def holds(after: Attempt) -> bool:
            there = after.solution.found
            if earlier not in there.tree.su_names or name not in there.tree.su_names:
                return False
            placed = np.isfinite(_moved(there, name, earlier)[0])
            closely = _TURN, _SHIFT if placed else np.inf
            jumped = like_an_encoder(there, name, earlier, closely)
            return not (jumped or _small(there, name, earlier))

        return Candidate(
            "slip", (name,), (new,), slip.drop, among=2 * features.n_poses, holds=holds
        )

    def findings(self, last: Attempt) -> Sequence[Fault]:
        """The slips with their sizes."""
        names = last.solution.found.tree.su_names
        return [
            _fault(last.solution.found, a)
            for a in last.amendments
            if isinstance(a, Slipped) and a.name in names and a.earlier in names
        ]


def _small(found: Estimate, name: str, earlier: str) -> bool:
    """Whether an SU moved by less than would matter: something else is wrong."""
    distance, turn = _moved(found, name, earlier)
    moving = found.tree.su_joint[found.tree.su_names.index(name)] >= 0
    return turn < LEAST_TURN and not (moving and distance > LEAST_SHIFT)


def _moved(found: Estimate, name: str, earlier: str) -> tuple[float, float]:
    """How far an SU moved [m] and turned [rad] when it slipped.

    The distance is NaN where only rests tell of one of its places: they show orientations.
    """
    names = found.tree.su_names
    both = [names.index(n) for n in (earlier, name)]
    before, after = found.state.T_joint_su[both]
    variance = factor(found.cost.at(found.state).normal_equations(), found.free).su_variance()
    placed = variance[both, :3].max() < PLACED**2
    distance = float(np.linalg.norm(after[:3, 3] - before[:3, 3]))
    turn = float(np.linalg.norm(rotation_log(before[:3, :3].T @ after[:3, :3])))
    return distance if placed else np.nan, turn


def like_an_encoder(found: Estimate, name: str, earlier: str, closely: tuple[float, float]) -> bool:
    """Whether a slip is what a jump of the encoder of the SU's joint would look like.

    Beyond that joint there are no other SUs, and the SU moved with the joint.

    Args:
        found: with both placements.
        name: the SU.
        earlier: that which stands for the placement before.
        closely: turn [rad] and shift [m] that it may have beside that of the joint; infinite where
            they are not known.
    """
    tree = found.tree
    first, second = (tree.su_names.index(n) for n in (earlier, name))
    joint = int(tree.su_joint[second])
    if joint < 0:
        return False
    beyond = {u for u, j in enumerate(tree.su_joint) if joint in tree.chain(int(j))}
    if beyond != {first, second}:
        return False
    T = found.state.T_joint_su
    moved = T[second] @ np.linalg.inv(T[first])
    turn, shift = rotation_log(moved[:3, :3]), moved[:3, 3]
    along = np.array([0.0, 0.0, 1.0])
    allowed = np.array(closely) + _SHARE * np.array([abs(turn[2]), abs(shift[2])])
    if tree.prismatic[joint]:
        rest = np.linalg.norm(turn), np.linalg.norm(shift - shift[2] * along)
    else:
        rest = np.linalg.norm(turn - turn[2] * along), np.linalg.norm(shift)
    return bool((np.array(rest) < allowed).all())


def _straddled(
    found: Estimate, name: str, earlier: str, at: Moment, features: Features
) -> Moment | None:
    """The moment without the pose beside it that its placement does not explain, if there is one.

    The SU slipped while the robot was in that pose.
    """
    per = found.chi2_by_block / np.maximum(found.count, 1)
    heard = found.count > 0
    first, second = (found.tree.su_names.index(n) for n in (earlier, name))
    order = np.lexsort((features.span[:, 0], features.log))
    ours, theirs = order[heard[order, first]], order[heard[order, second]]
    if min(len(ours), len(theirs)) < 2:
        return None
    last, next_ = int(ours[-1]), int(theirs[0])
    limit = _STRADDLED * max(1.0, float(np.median(per[heard])))
    if per[next_, second] > max(limit, per[last, first]):
        return replace(at, since=(int(features.log[next_]), float(features.span[next_, 1])))
    if per[last, first] > limit:
        return replace(at, until=(int(features.log[last]), float(features.span[last, 0])))
    return None


def fresh(name: str, taken: Sequence[str]) -> str:
    """A name like another one that is not taken."""
    while name in taken:
        name += "_"
    return name


def _doubled(sampled: Sampled, u: int, log: int, at: Moment) -> Sampled:
    """A log with one more SU, which has the readings of SU u before a moment; u those after it."""
    time = sampled.motion.grid.time

    def before(moment: tuple[int, float], inclusive: bool) -> Bool:
        if log != moment[0]:
            return np.full(len(time), log < moment[0])
        return np.asarray(time < moment[1] + (_TICK if inclusive else -_TICK))

    first = sampled.valid[:, u] & before(at.until, inclusive=True)
    second = sampled.valid[:, u] & ~before(at.since, inclusive=False)
    valid = np.concatenate([sampled.valid, first[:, None]], axis=1)
    valid[:, u] = second
    turning = sampled.turning
    if turning is not None:
        twice = turning.of(np.append(np.arange(valid.shape[1] - 1), u))
        both = np.ones_like(valid)
        both[:, u] = ~before(at.since, inclusive=False)
        both[:, -1] = before(at.until, inclusive=True)
        turning = twice.where(both)
    return replace(
        sampled,
        readings=np.concatenate([sampled.readings, sampled.readings[:, u : u + 1]], axis=1),
        valid=valid,
        computed=np.concatenate([sampled.computed, sampled.computed[:, u : u + 1]], axis=1),
        period=np.append(sampled.period, sampled.period[u]),
        digits=np.vstack([sampled.digits, sampled.digits[u]]),
        turning=turning,
    )


def as_one(logs: Logs, tree: KinematicTree, name: str, earlier: str) -> tuple[Logs, KinematicTree]:
    """Logs and tree with one SU again, of those that have one for each of its placements.

    Args:
        logs: with the readings of both.
        tree: with both.
        name: the SU.
        earlier: that which stands for the placement before.
    """
    u, v = map(logs.su_names.index, (name, earlier))
    others = np.flatnonzero(np.arange(len(logs.su_names)) != v)
    whole = replace(
        logs,
        sampled=[_as_one(s, u, v, others) for s in logs.sampled],
        su_names=tuple(logs.su_names[i] for i in others),
    )
    return whole, of_logs(tree, whole)


def _as_one(sampled: Sampled, u: int, v: int, others: Int) -> Sampled:
    """A log whose SU u has the readings of v as well, with the columns (U - 1,) other than v."""
    valid, turning = np.array(sampled.valid), sampled.turning
    valid[:, u] |= valid[:, v]
    if turning is not None:
        known = np.array(turning.valid)
        known[:, u] |= known[:, v]
        turning = replace(turning, valid=known).of(others)
    return replace(
        sampled,
        readings=sampled.readings[:, others],
        valid=valid[:, others],
        computed=sampled.computed[:, others],
        period=sampled.period[others],
        digits=sampled.digits[others],
        turning=turning,
    )


def _fault(found: Estimate, part: Slipped) -> Fault:
    """A slip with its size."""
    distance, turn = _moved(found, part.name, part.earlier)
    moving = found.tree.su_joint[found.tree.su_names.index(part.name)] >= 0
    (log, begin), (end_log, end) = part.at.until, part.at.since
    return Fault(
        "loose", part.name, log=log, begin=begin, end=end, end_log=end_log,
        size=distance if moving else np.nan, unit="m", turn=turn, sus=(part.name, part.earlier),
    )  # fmt: skip
