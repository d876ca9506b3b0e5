"""SUs that slipped are taken apart: one SU for each of their placements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.calibration.rounds import Logs, relinearise, take_features
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.solve.arrow import factor
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.geometry.so3 import rotation_log
from skin2urdf.hypotheses.loose import Slip, slips
from skin2urdf.signals.records import Features
from skin2urdf.signals.sampling import Sampled

_MOST = 4
"""Slips that are taken for such; a robot with more has another fault."""
_MOST_LEFT = 0.7
"""Share of the misfit that may stay where a slip was one of its causes."""
_LEFT = 0.1
"""Share of the misfit that may stay where slips were its cause."""
_STRADDLED = 4.0
"""Chi-squared per measurement of a pose, over the median, from which an SU slipped inside of it."""
_TURN, _SHIFT, _SHARE = np.deg2rad(0.2), 1e-3, 0.05
"""What an SU may move beside its joint [rad, m, and of the motion with the joint] and still be
taken for fixed, with the joint's encoder at fault: as much as poor encoders leave uncertain."""
_PLACED = 0.01
"""Standard deviation [m] up to which a place counts as known."""
_LEAST_TURN, _LEAST_SHIFT = np.deg2rad(0.05), 0.3e-3
"""What a slip exceeds in one or the other [rad, m]."""
_TICK = 1e-6


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
class Parted:
    """An SU that was taken apart.

    Attributes:
        name: the SU, which keeps its name for its last placement.
        earlier: name of the SU that stands for the placement before.
        at: when it slipped.
    """

    name: str
    earlier: str
    at: Moment


@dataclass(frozen=True, eq=False)
class Parting:
    """An estimate in which SUs were taken apart.

    Attributes:
        logs: the logs in which an SU has two names.
        found: the estimate.
        features: its features.
        parted: the SUs.
    """

    logs: Logs
    found: Estimate
    features: Features
    parted: tuple[Parted, ...] = ()

    @property
    def faults(self) -> list[Fault]:
        """The slips."""
        return [_fault(self.found, part) for part in self.parted]


def slips_parted(logs: Logs, found: Estimate, features: Features, clock: Clock) -> Parting:
    """Take apart what slipped, one SU at a time, if that explains what the estimate leaves.

    Args:
        logs: the logs.
        found: an estimate.
        features: its features.
        clock: runs the stages.

    Returns:
        The estimate with SUs taken apart; the given one where no slip is its misfit's cause.
    """
    first = now = Parting(logs, found, features)
    for _ in range(_MOST):
        order = np.lexsort((now.features.span[:, 0], now.features.log))
        loose = slips(now.found, order)
        if not loose:
            break
        new = _apart(now, loose[0], clock)
        if new is None or _excess(new.found) > _MOST_LEFT * _excess(now.found):
            return first
        now = new
    return now if _explained(first.found, now.found) else first


def _explained(before: Estimate, after: Estimate) -> bool:
    """Whether what the first estimate left beyond noise is gone, or nearly."""
    left = _excess(after) < _LEFT * _excess(before) or after.cost_per_dof <= GOOD_FIT
    return left and after.cost_per_dof <= BAD_FIT


def _excess(found: Estimate) -> float:
    """Chi-squared beyond what noise makes of it, at least a standard deviation of that."""
    dof = max(1, found.degrees_of_freedom)
    return max(float(found.chi2_by_block.sum()) - dof, float(np.sqrt(2 * dof)))


def _apart(before: Parting, slip: Slip, clock: Clock) -> Parting | None:
    """With one more SU taken apart; None where that explains nothing."""
    features = before.features
    name = before.found.tree.su_names[slip.su]
    earlier = _fresh(f"{name}_before", before.logs.su_names)
    at = Moment.between(features, slip.before, slip.after)
    for _ in range(2):
        try:
            logs, found, features = _estimated(before, name, earlier, at, clock)
        except InsufficientDataError:
            return None
        inside = _straddled(found, name, earlier, at, features)
        if inside is None:
            break
        at = inside
    if _like_an_encoder(found, name, earlier) or _small(found, name, earlier):
        return None
    part = Parted(name, earlier, at)
    return Parting(logs, found, features, (*before.parted, part))


def _small(found: Estimate, name: str, earlier: str) -> bool:
    """Whether an SU moved by less than would matter: something else is wrong."""
    distance, turn = _moved(found, name, earlier)
    moving = found.tree.su_joint[found.tree.su_names.index(name)] >= 0
    return turn < _LEAST_TURN and not (moving and distance > _LEAST_SHIFT)


def _moved(found: Estimate, name: str, earlier: str) -> tuple[float, float]:
    """How far an SU moved [m] and turned [rad] when it slipped.

    The distance is NaN where only rests tell of one of its places: they show orientations.
    """
    names = found.tree.su_names
    both = [names.index(n) for n in (earlier, name)]
    before, after = found.state.T_joint_su[both]
    variance = factor(found.cost.at(found.state).normal_equations(), found.free).su_variance()
    placed = variance[both, :3].max() < _PLACED**2
    distance = float(np.linalg.norm(after[:3, 3] - before[:3, 3]))
    turn = float(np.linalg.norm(rotation_log(before[:3, :3].T @ after[:3, :3])))
    return distance if placed else np.nan, turn


def _like_an_encoder(found: Estimate, name: str, earlier: str) -> bool:
    """Whether the slip is what a jump of the encoder of the SU's joint would look like.

    Beyond that joint there are no other SUs, and the SU moved with the joint.
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
    if np.isnan(_moved(found, name, earlier)[0]):
        shift = np.zeros(3)
    along = np.array([0.0, 0.0, 1.0])
    allowed = np.array([_TURN, _SHIFT]) + _SHARE * np.array([abs(turn[2]), abs(shift[2])])
    if tree.prismatic[joint]:
        rest = np.linalg.norm(turn), np.linalg.norm(shift - shift[2] * along)
    else:
        rest = np.linalg.norm(turn - turn[2] * along), np.linalg.norm(shift)
    return bool((np.array(rest) < allowed).all())


def _estimated(
    before: Parting, name: str, earlier: str, at: Moment, clock: Clock
) -> tuple[Logs, Estimate, Features]:
    """The logs with an SU under two names, and the estimate from them."""
    tree, features = before.found.tree, before.features
    u = before.logs.su_names.index(name)
    sampled = [_doubled(s, u, log, at) for log, s in enumerate(before.logs.sampled)]
    logs = replace(before.logs, sampled=sampled, su_names=(*before.logs.su_names, earlier))
    joint = tree.su_joint[tree.su_names.index(name)]
    new_tree = replace(
        tree, su_names=(*tree.su_names, earlier), su_joint=np.append(tree.su_joint, joint)
    )
    lag = np.append(features.latency, features.latency[features.su_names.index(name)])
    return logs, *relinearise(logs, new_tree, take_features(logs, clock, latency=lag), clock)


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


def _fresh(name: str, taken: Sequence[str]) -> str:
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
    return replace(
        sampled,
        readings=np.concatenate([sampled.readings, sampled.readings[:, u : u + 1]], axis=1),
        valid=valid,
        computed=np.concatenate([sampled.computed, sampled.computed[:, u : u + 1]], axis=1),
    )


def _fault(found: Estimate, part: Parted) -> Fault:
    """A slip with its size."""
    distance, turn = _moved(found, part.name, part.earlier)
    moving = found.tree.su_joint[found.tree.su_names.index(part.name)] >= 0
    (log, begin), (end_log, end) = part.at.until, part.at.since
    return Fault(
        "loose", part.name, log=log, begin=begin, end=end, end_log=end_log,
        size=distance if moving else np.nan, unit="m", turn=turn, sus=(part.name, part.earlier),
    )  # fmt: skip
