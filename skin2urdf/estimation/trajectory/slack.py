"""What encoders leave out of the joints' positions from place to place: slack of a learnt size.

Whatever stands between an encoder and its link (uneven teeth, play, twist under a load that changes
from pose to pose) leaves the link off by some amount that is the same whenever the robot is in the
same place. Numbers for every joint in every place where the robot stays, of a common size that is
learnt from the readings (a variance component), take that up: the estimate weighs it as it
deserves, and its stated errors know of it.

What encoders round off while joints move is felt by all SUs beyond them alike, so that weights,
which take SUs as independent, know the joints the better the more SUs there are: with 28 SUs on
every link, and encoders of 13 bits, squared pulls of noise alone are some forty times what weights
say, and look like slack. How much of it rounding makes is known from what encoders round off, drawn
anew (:mod:`rounded`), whatever the readings are: no error of a gear hides in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import null_space

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.curved import (
    Curvature,
    likeliest_curvature,
    with_curves,
    without_curves,
)
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Equations
from skin2urdf.estimation.trajectory.unseen import MOST_NUMBERS, Unseen, eased, together
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

LEVER = 0.1
"""Slack of a joint that slides, over that of one that turns [m/rad]: a spindle for a gear."""
_SAME = 0.02
"""Distance of joint positions within which two rests are at one place [rad or m]; a place comes
back to within a milliradian, patterns leave it by ten times as much."""
_REST = 0.25
"""Length of a rest at least [s], as poses have it; where a pattern turns round is none."""
_OFTEN = 1.0
"""Time between moments that stand for places at least [s]: about that of a move."""
_WIDE = 1e-2
"""Size that stands for any, where only information is wanted [rad]."""
_SIZES = np.geomspace(1e-7, 3e-2, 111)
"""Sizes that are compared [rad]: from what no encoder tells to two degrees, by 12 %."""

MOST_SLACK = float(_SIZES[-1])
"""Size of slack that is none [rad]: the likeliest one may be larger still, and no gear has so much
play."""

CERTAIN = 10.0
"""Logarithm of the likelihood that unseen motion has to gain, which chance does once in 100,000;
sound recordings gain nothing (panda and five of ur5), a strain wave of 0.1 mrad 121."""
_NOTHING = np.zeros(0, dtype=np.int64)
UNKNOWN = np.geomspace(1.0, 8.0, 7)
"""Variances of noise that SUs share over those of its draws that are compared, where draws show how
it is shared and not how much there is. A drive may give way to loads within a step of its encoder,
which is three times what is left of a step's rounding in a swing: 6 to 8 times the variance were
found with encoders of 14 bits. With 64, a base that turns by 0.6 mrad is taken for rounding."""


@dataclass(frozen=True, eq=False)
class Size:
    """How large a group of unseen motions is.

    Attributes:
        size: standard deviation of its numbers.
        gain: logarithm of the likelihood of the readings, over that without the group.
        numbers: (S,) the likeliest numbers of that size.
        gains: the same logarithms of all sizes that were compared, from the smallest on.
    """

    size: float
    gain: float
    numbers: F64
    gains: F64

    def gain_beyond(self, size: float) -> float:
        """How much likelier the readings are than with any size up to a given one (logarithm)."""
        up_to = self.gains[size >= _SIZES]
        return self.gain - max(0.0, float(up_to.max(initial=0.0)))


def slack(
    tree: KinematicTree, logs: Sequence[Trajectory], *, zeros_given: bool = False
) -> Unseen | None:
    """An offset of every joint in every place where the robot stays; None without two places.

    On its way from place to place a joint's offset changes as smoothly as the joint moves. Where a
    robot stays in no two places of a log, moments on its way are its places. What is
    the same in all places, as in play whose load never changes its side, shows nowhere, and is as
    large.

    Args:
        tree: D joints.
        logs: trajectories.
        zeros_given: whether the zeros of the joints are known, so that what is the same in all
            places shows: as another zero, which is no slack.
    """
    # The places visited longest count.
    most = max(2, MOST_NUMBERS // max(1, tree.n_joints))
    stays = [_stays(log) for log in logs]
    stays = [
        s if len(s) > 1 else _moments(log, most // len(logs))
        for s, log in zip(stays, logs, strict=True)
    ]
    everywhere = np.array(
        [
            log.q[log.kept[b:e]].mean(axis=0)
            for log, s in zip(logs, stays, strict=True)
            for b, e in s
        ]
    )
    if len(everywhere) < 2:
        return None
    length = np.array([e - b for s in stays for b, e in s])
    place = _places(everywhere, length, most)
    P = int(place.max()) + 1
    if P < 2:
        return None
    first, shares = 0, []
    for log, s in zip(logs, stays, strict=True):
        shares.append(_shares(log, s, place[first : first + len(s)], P))
        first += len(s)
    unit = np.where(tree.prismatic, LEVER, 1.0)
    joints = np.arange(tree.n_joints)
    if zeros_given:
        apart = null_space(np.ones((1, P)))
        motions, n = tuple(h @ apart for h in shares), P - 1
        return Unseen(
            np.repeat(joints, n), motions,
            column=np.tile(np.arange(n), len(joints)), unit=np.repeat(unit, n),
        )  # fmt: skip
    motions = tuple(np.concatenate([h, np.ones((len(h), 1))], axis=1) for h in shares)
    return Unseen(
        np.concatenate([np.repeat(joints, P), joints]),
        motions,
        column=np.concatenate([np.tile(np.arange(P), len(joints)), np.full(len(joints), P)]),
        unit=np.concatenate([np.repeat(unit, P), unit]),
    )


def rounded_off(tree: KinematicTree, logs: Sequence[Trajectory]) -> float:
    """Slack up to which encoders may have rounded it off: half a step of the coarsest [rad].

    Args:
        tree: D joints.
        logs: trajectories.
    """
    unit = np.where(tree.prismatic, LEVER, 1.0)
    steps = [log.resolution / unit for log in logs if len(log.resolution)]
    return 0.5 * float(np.max(steps, initial=0.0))


@dataclass(frozen=True)
class Shared:
    """Groups of unseen motion that stand for noise, which all SUs beyond a joint share.

    Attributes:
        draws: the group each of whose numbers is a draw of it.
        times: (T,) by how much more variance it may have than its draws, of which the likeliest
            counts.
        loads: another group, whose numbers are noise themselves; None for none.
        load: standard deviation of each of them.
    """

    draws: int
    times: F64 = field(default_factory=lambda: np.ones(1))
    loads: int | None = None
    load: float = 0.0

    @property
    def groups(self) -> list[int]:
        """All of them."""
        return [self.draws] if self.loads is None else [self.draws, self.loads]


@dataclass(frozen=True)
class _Noise:
    """The same, as coordinates of the joint part."""

    drawn: Int = field(default_factory=lambda: _NOTHING)
    times: F64 = field(default_factory=lambda: np.ones(1))
    loads: Int = field(default_factory=lambda: _NOTHING)
    load: float = 0.0


@dataclass(frozen=True, eq=False)
class Lacking:
    """Groups of unseen motion that a fit lacks, and what the readings say of each alone.

    Attributes:
        problem: what was fitted, with all groups.
        equations: of that, where the fit is.
        minimised: of what the fit minimised.
        groups: coordinates of the joint part that each group's numbers are.
        curvature: how much axes are curved without any of the groups; None if that was not asked.
    """

    problem: MotionProblem
    equations: Equations
    minimised: Equations
    groups: tuple[Int, ...]
    curvature: Curvature | None = None

    def size(self, group: int, shared: Shared | None = None, *, units: F64 | None = None) -> Size:
        """The size that the readings give to a group, by their likelihood.

        Args:
            group: whose size.
            shared: what SUs share beside; None where their noise is independent.
            units: (S,) units of its motions that one of each number makes; by default 1.
        """
        beside = [] if shared is None else shared.groups
        others = [at for i, at in enumerate(self.groups) if i not in (group, *beside)]
        every = np.arange(self.problem.layout.n_joint)
        kept = np.setdiff1d(every, np.concatenate(others)) if others else every
        free = self.problem.free_joint[kept], self.problem.free_su
        at = np.searchsorted(kept, self.groups[group])
        noise = _Noise()
        if shared is not None:
            drawn, *loads = (np.searchsorted(kept, self.groups[each]) for each in beside)
            noise = _Noise(drawn, shared.times, loads[0] if loads else _NOTHING, shared.load)
        wide, none = np.full(len(at), _WIDE), np.zeros(len(at))
        return _likeliest(self.minimised.of_joint(kept), free, at, wide, none, noise, units)

    def pull(self, group: int) -> tuple[F64, F64]:
        """What a group of that size does to the estimate.

        Returns:
            (J,) and (U, n) its part of the gradient in the coordinates that were fitted.
        """
        numbers = self.size(group).numbers
        joint, su = self.pulls(group)
        return numbers @ joint, np.einsum("s,sun->un", numbers, su)

    def pulls(self, group: int) -> tuple[F64, F64]:
        """(S, J) and (S, U, n) the same of a unit of each of a group's numbers."""
        at, fitted = self.groups[group], self._fitted
        to_joint = self.equations.joint[np.ix_(at, fitted)]
        return to_joint, np.moveaxis(self.equations.mixed[:, :, at], 2, 0)

    @property
    def without(self) -> Equations:
        """The equations of what was fitted, without any group."""
        return self.equations.of_joint(self._fitted)

    @property
    def _fitted(self) -> Int:
        """Coordinates of the joint part that were fitted."""
        return np.setdiff1d(np.arange(self.problem.layout.n_joint), np.concatenate(self.groups))

    def begun(self, group: int, size: float) -> tuple[MotionProblem, Equations]:
        """The problem with a single group of some size, and its equations where the fit is.

        Args:
            group: the only one.
            size: standard deviation of its numbers.
        """
        at, spread = self.groups[group], np.array(self.problem.priors.unseen)
        first = self.problem.layout.unseen.start
        joint = np.array(self.equations.joint)
        joint[at, at] += size**-2 - spread[at - first] ** -2
        spread[at - first] = size
        priors = replace(self.problem.priors, unseen=spread)
        return self.problem.again(priors=priors), replace(self.equations, joint=joint)


def lacking(
    problem: MotionProblem, fitted: Fitted, groups: Sequence[Unseen], *, curves: bool = False
) -> Lacking:
    """What the readings say of motions that a fit lacks, of which the fit's own equations are part.

    Args:
        problem: what was fitted.
        fitted: the fit; it keeps its normal equations, which are found on the way.
        groups: motions, one group or more.
        curves: whether axes may be curved besides.
    """
    wider, state = problem, fitted.state
    places = []
    for more in groups:
        wider = with_unseen(wider, more, _WIDE)
        state = replace(state, unseen=np.concatenate([state.unseen, np.zeros(more.n_numbers)]))
        end = wider.layout.unseen.stop
        places.append(np.arange(end - more.n_numbers, end))
    shaken = fitted.shaken_with(wider, state)
    if not curves:
        equations = wider.equations(state, fitted.predicted, fitted.weights)
        minimised = shaken.taken_off(equations, wider, state)
        found = Lacking(wider, equations, minimised, tuple(places))
        fitted.keep(found.without)
        return found
    curved, begin = with_curves(wider, replace(fitted, state=state))
    equations = curved.equations(begin.state, fitted.predicted, fitted.weights)
    minimised = shaken.taken_off(equations, curved, begin.state)
    among = np.isin(np.arange(curved.layout.n_joint), np.concatenate(places))
    curvature = likeliest_curvature(curved, minimised, among)
    straight, least = (without_curves(curved, each) for each in (equations, minimised))
    found = Lacking(wider, straight, least, tuple(places), curvature)
    fitted.keep(found.without)
    return found


def size_of(problem: MotionProblem, fitted: Fitted, more: Unseen) -> Size:
    """The size that the readings give to more unseen motion, by their likelihood.

    Args:
        problem: what was fitted.
        fitted: the fit.
        more: motions that it lacks.
    """
    return lacking(problem, fitted, [more]).size(0)


def learnt_size(problem: MotionProblem, fitted: Fitted, numbers: slice) -> Size:
    """The common size that the readings give to some of the numbers that were fitted.

    Args:
        problem: what was fitted.
        fitted: the fit.
        numbers: which of the numbers that make unseen motion.
    """
    at = problem.layout.unseen.start + np.arange(problem.layout.n_unseen)[numbers]
    spread, x = problem.priors.unseen[numbers], fitted.state.unseen[numbers]
    equations = fitted.minimised(fitted.equations)
    return _likeliest(equations, (problem.free_joint, problem.free_su), at, spread, x)


def _likeliest(
    equations: Equations,
    free: tuple[Bool, Bool],
    at: Int,
    spread: F64,
    x: F64,
    noise: _Noise | None = None,
    units: F64 | None = None,
) -> Size:
    """The size of some coordinates of the joint part that makes the readings most likely.

    All else follows them to first order, as the normal equations say (restricted maximum
    likelihood: Patterson and Thompson 1971).

    Args:
        equations: at some state.
        free: (J,) and (U, n) coordinates that are estimated.
        at: (S,) which coordinates.
        spread: (S,) standard deviations that the equations have of them.
        x: (S,) where they are.
        noise: what SUs share, which makes pulls beside the independent noise of each; the likeliest
            of its variances counts, with and without the coordinates.
        units: (S,) units of each coordinate that one of its number makes; by default 1.
    """
    noise, units = noise or _Noise(), np.ones(len(at)) if units is None else units
    free_joint, free_su = free
    system = eliminated(equations, free_joint, free_su)
    H, g = np.array(system.schur), np.array(system.gradient)
    # Without what was said of them before, and seen from zero, as all others are where they are.
    H[at, at] -= spread**-2
    g[at] += spread**-2 * x
    g += H[:, at] @ x
    others = free_joint.copy()
    beside = np.concatenate([noise.drawn, noise.loads])
    others[np.concatenate([at, beside])] = False
    S = len(at)
    follow = joint_inverse(H, others) @ np.column_stack([H[:, at], g, H[:, beside]])
    left = (H[np.ix_(at, at)] - H[at] @ follow[:, :S]) * units[:, None] * units
    pull = (g[at] - H[at] @ follow[:, S]) * units
    lam, V = np.linalg.eigh(0.5 * (left + left.T))
    lam, pull = np.maximum(lam, 0.0), V.T @ pull
    known = lam > 1e-9 * max(float(lam[-1]), 1e-300)
    v = _SIZES[:, None] ** 2
    lam, pull, V = lam[known], pull[known], V[:, known]
    # Pulls have variances c + v lam^2, where those of independent noise are c = lam.
    n = len(noise.drawn)
    drawn = (H[np.ix_(at, beside)] - H[at] @ follow[:, S + 1 :]) * units[:, None]
    by_noise = (V.T @ drawn) ** 2
    shared = by_noise[:, :n].sum(axis=1) / max(1, n)
    c = lam + by_noise[:, n:].sum(axis=1) * noise.load**2 + noise.times[:, None] * shared
    without = -0.5 * (pull**2 / c + np.log(c)).sum(axis=1)
    ratio = v * (lam**2 / c)[:, None]
    more = 0.5 * ((pull**2 / c)[:, None] * ratio / (1 + ratio) - np.log1p(ratio)).sum(axis=2)
    each = without[:, None] + more
    gain = each.max(axis=0) - without.max()
    best = int(np.argmax(gain))
    less = lam / c[int(np.argmax(each[:, best]))]
    numbers = V @ (less * pull / (less * lam + 1 / v[best]))
    return Size(float(_SIZES[best]), float(gain[best]), numbers, gain)


def with_unseen(
    problem: MotionProblem, more: Unseen, size: float, behind: int = 0
) -> MotionProblem:
    """A problem with more unseen motion, of a common size.

    Args:
        problem: what was fitted.
        more: motions, which become the last but for those that stay behind them.
        size: standard deviation of their numbers.
        behind: how many of the groups that were added before stay behind them.
    """
    old = () if problem.unseen is None else problem.unseen.several or (problem.unseen,)
    before, after = old[: len(old) - behind], old[len(old) - behind :]
    first = sum(each.n_numbers for each in before)
    spread = np.insert(problem.priors.unseen, first, np.full(more.n_numbers, size))
    priors = replace(problem.priors, unseen=spread)
    motion = together([*before, more, *after]) if old else more
    return MotionProblem(problem.tree, problem.logs, priors, problem.layout.n_knots, motion)


def resting(log: Trajectory) -> list[tuple[int, int]]:
    """First and end of the kept samples of each time in which no joint moves.

    Args:
        log: a trajectory.
    """
    rest = ~log.moving.any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rest, [False]]).astype(int)))
    return [
        (int(b), int(e))
        for b, e in edges.reshape(-1, 2)
        if not log.time[e - 1] - log.time[b] < _REST
    ]


def _stays(log: Trajectory) -> list[tuple[int, int]]:
    """First and end of the kept samples of each stay: rests at one place, one after the other."""
    out: list[tuple[int, int]] = []
    q = log.q[log.kept]
    for begin, end in resting(log):
        here = q[begin:end].mean(axis=0)
        if out and np.abs(here - q[out[-1][0] : out[-1][1]][-1]).max() < _SAME:
            out[-1] = (out[-1][0], end)
        else:
            out.append((begin, end))
    return out


def _moments(log: Trajectory, most: int) -> list[tuple[int, int]]:
    """Kept samples at even distances in time, as stays of one sample each."""
    begin, end = log.time[[0, -1]]
    n = max(min(most, int((end - begin) / _OFTEN)), 1)
    at = np.searchsorted(log.time, np.linspace(begin, end, n, endpoint=False))
    return [(int(k), int(k) + 1) for k in at]


def _places(q: F64, length: Int, most: int) -> Int:
    """(S,) number of the place of each stay.

    Args:
        q: (S, D) where each stay is.
        length: (S,) how long.
        most: number of places; stays elsewhere count to the place that is nearest.
    """
    place = np.full(len(q), -1)
    heads: list[int] = []
    for s in np.argsort(-length, kind="stable"):
        if place[s] >= 0:
            continue
        if len(heads) == most:
            place[s] = int(np.abs(q[heads] - q[s]).max(axis=1).argmin())
            continue
        near = np.abs(q - q[s]).max(axis=1) < _SAME
        place[near & (place < 0)] = len(heads)
        heads.append(int(s))
    return place


def _shares(log: Trajectory, stays: Sequence[tuple[int, int]], place: Int, n: int) -> F64:
    """(N, P) how much each place's offset counts along a log; all shares add up to 1."""
    grid = np.arange(len(log.q))
    out = np.zeros((len(grid), n))
    if not stays:
        return out
    ends = np.array([(log.kept[b], log.kept[e - 1]) for b, e in stays]).ravel()
    at = np.interp(grid, ends, np.repeat(np.arange(len(stays)), 2))
    low = np.floor(at).astype(int)
    high = np.minimum(low + 1, len(stays) - 1)
    s = at - low
    s = eased(s)
    np.add.at(out, (grid, place[low]), 1 - s)
    np.add.at(out, (grid, place[high]), s)
    return out
