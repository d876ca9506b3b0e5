"""Which link each SU sits on, where, and how the robot is mounted: no start, no patterns needed.

A known model leaves each SU one unknown segment and placement, and all of them the direction of
gravity in the base frame. Each is tried: what a segment leaves of an SU's readings follows from
their moments. The segment that leaves least is taken; those that a log does not tell from it,
since no joint between them moved, are told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.blueprint import turn_axes
from skin2urdf.geometry.se3 import placement
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree
from skin2urdf.vendor.matching import Chassis
from skin2urdf.vendor.moments import Moments, all_moments, rough_moments
from skin2urdf.vendor.rigid import (
    NOISE,
    Fit,
    Sums,
    again,
    fitted,
    freely_linear,
    gravity_known,
    linear,
    linear_ridge,
    place_deviations,
    sensor_chi2,
    sums_of,
    up_equations,
)

_DIRECTIONS = 400
"""Directions of gravity that are tried: 10 degrees apart, from where turns are found."""
_FOLLOWED = 3
"""Directions that are followed beside the upright one."""
_CLEAR = 4.0
"""Difference of what two explanations leave, summed over spans of time, over its own scatter, from
which the lesser is the right one: chance exceeds it once in 30,000 (Vuong 1989)."""
_NO_SENSOR = float(chdtri(9, 3e-5))
"""By how much more squared errors of a sensor, over what is known of them, make it one that can
not be: chance exceeds it as seldom. A sensor that reads nothing would explain any rest."""
_TIMES = 4.0
"""Sum of squares over another from which the lesser is the right one whatever spans scatter: few
moves may make most of the difference."""
_SAME = 1e-6
"""Relative difference of sums of squares that is rounding."""
_NEAR_AXIS = 5e-3
"""Deviation of an SU's place, square to an axis, from which it is known to sit right on it [m]: of
places within a decimetre of an axis one in 400 lies so near to it."""
_DAMPING, _DAMPED = 1e-6, 1e-3
"""Damping of the turns of gravity to begin with, and after a step that led nowhere."""
_ROUNDS = 6
_TURNS = 30


@dataclass(frozen=True, eq=False)
class Placed(Record):
    """U SUs on a model.

    Attributes:
        su_joint: (U,) the joint before each SU; -1 for the base.
        fits: their placements.
        up: (G, 3) direction opposite to gravity in the base frame, by log.
        instead: per SU the joints that do as well: no motion in the logs tells.
        by_chance: per SU the joints that a rough look allows as well, were it right on the axis of
            one.
        left: (U,) rms of what is left of each SU's readings [m/s^2].
    """

    su_joint: Int
    fits: tuple[Fit, ...]
    up: F64
    instead: tuple[tuple[int, ...], ...]
    left: F64
    by_chance: tuple[tuple[int, ...], ...]

    @property
    def rss(self) -> F64:
        """(S,) sums of squares of all SUs, by span of time."""
        return np.asarray(np.sum([fit.rss for fit in self.fits], axis=0))

    def others(self, u: int) -> tuple[int, ...]:
        """All joints behind which a rough look allows an SU beside the one it was placed on."""
        return (*self.instead[u], *self.by_chance[u])

    @property
    def lags(self) -> F64:
        """(U,) by how much each SU's stamps are late [s]."""
        return np.array([fit.lag for fit in self.fits])

    def state(self, T_parent_joint: F64) -> State:
        """The state to begin a fit of all samples with."""
        return State(
            T_parent_joint=T_parent_joint,
            T_joint_su=np.stack([placement(fit.R, fit.r) for fit in self.fits]),
            up=self.up,
            bias=np.stack([fit.bias for fit in self.fits]),
            shape=np.stack([fit.shape for fit in self.fits]),
        )


def place_sus(
    chassis: Chassis,
    logs: Sequence[Trajectory],
    priors: Priors,
    tell: Callable[[float], None] = lambda _: None,
) -> Placed:
    """Place SUs on a model.

    Args:
        chassis: the model, D joints.
        logs: trajectories in its order, with U SUs that have valid samples.
        priors: of the sensors.
        tell: told the share of the work that is done.
    """
    U = logs[0].readings.shape[1]
    tree = chassis.tree((), ())
    moments = _of_segments(tree, chassis.T_parent_joint, logs)
    tell(0.5)
    upright = np.tile([0.0, 0.0, 1.0], (len(logs), 1))
    best = _settled(moments, upright, U, priors)
    if best.left.max() > NOISE:
        others = [_best_directions([m[g] for m in moments], U, priors) for g in range(len(logs))]
        for i, start in enumerate(zip(*others, strict=True)):
            other = _settled(moments, np.stack(start), U, priors)
            if clearly_less(other.rss, best.rss):
                best = other
            tell(0.5 + 0.5 * (i + 1) / _FOLLOWED)
    return _with_alternatives(best, moments, priors)


def placed_from(chassis: Chassis, logs: Sequence[Trajectory], up: F64, priors: Priors) -> Placed:
    """Place SUs on a model whose mount is roughly known.

    Args:
        chassis: the model.
        logs: trajectories in its order.
        up: (G, 3) directions of gravity to begin with.
        priors: of the sensors.
    """
    moments = _of_segments(chassis.tree((), ()), chassis.T_parent_joint, logs)
    return _with_alternatives(
        _settled(moments, up, logs[0].readings.shape[1], priors), moments, priors
    )


def placed_elsewhere(
    chassis: Chassis, logs: Sequence[Trajectory], placed: Placed, sus: Sequence[int], priors: Priors
) -> Placed:
    """The same with some SUs on the best of the segments that no rough fit told from their own.

    Args:
        chassis: the model.
        logs: trajectories in its order.
        placed: where the SUs sit.
        sus: which of them; each has such segments.
        priors: of the sensors.
    """
    moments = _of_segments(chassis.tree((), ()), chassis.T_parent_joint, logs)
    su_joint, fits, instead = np.array(placed.su_joint), list(placed.fits), list(placed.instead)
    for u in sus:
        there = {
            j: fitted(sums_of(moments[j], u, placed.up), moments[j], u, priors)
            for j in placed.others(u)
        }
        best = min(there, key=lambda j: there[j].cost)
        instead[u] = tuple(j for j in instead[u] if j != best)
        su_joint[u], fits[u] = best, there[best]
    return replace(placed, su_joint=su_joint, fits=tuple(fits), instead=tuple(instead))


def turned_up(chassis: Chassis, logs: Sequence[Trajectory], placed: Placed, priors: Priors) -> F64:
    """(G, 3) directions of gravity that explain SUs best that sit on segments they are known on.

    Args:
        chassis: the model.
        logs: trajectories in its order.
        placed: where the SUs sit, and directions to begin with.
        priors: of the sensors.
    """
    moments = _of_segments(chassis.tree((), ()), chassis.T_parent_joint, logs)
    own = [moments[k] for k in placed.su_joint]
    sums = [sums_of(each, u, placed.up) for u, each in enumerate(own)]
    fits = again(placed.fits, sums, own, priors)
    return _turned(moments, placed.su_joint, fits, placed.up, priors)[1]


def roughly_left(chassis: Chassis, T_parent_joint: F64, logs: Sequence[Trajectory]) -> F64:
    """(U,) mean squares that linear fits on the best segments leave of each SU [m^2/s^4].

    Args:
        chassis: the model.
        T_parent_joint: (D, 4, 4) a version of its placements.
        logs: trajectories in its order.
    """
    tree = chassis.tree((), ())
    by_log = [rough_moments(tree, T_parent_joint, log) for log in logs]
    moments = [list(segment) for segment in zip(*by_log, strict=True)]
    nowhere = np.tile([0.0, 0.0, 1.0], (len(logs), 1))
    rss = [
        min(freely_linear(sums_of(segment, u, nowhere)) for segment in moments)
        for u in range(logs[0].readings.shape[1])
    ]
    count = np.sum([m.count.sum(axis=1) for m in moments[0]], axis=0)
    return np.asarray(np.maximum(np.array(rss), 0.0) / (3.0 * np.maximum(count, 1)))


def clearly_less(a: F64, b: F64) -> bool:
    """Whether sums of squares by span (S,) are less than others beyond the chance of spans."""
    total = float(b.sum())
    if not a.sum() < total * (1 - _SAME):
        return False
    if a.sum() < total / _TIMES:
        return True
    difference = b - a
    return bool(difference.sum() > _CLEAR * np.sqrt((difference**2).sum()) * _few(len(a)))


def _few(n: int) -> float:
    """Part of the bound that few spans can reach at all: n equal differences have a sum of n."""
    return float(min(1.0, 0.8 * np.sqrt(n) / _CLEAR))


def _of_segments(
    tree: KinematicTree, T_parent_joint: F64, logs: Sequence[Trajectory]
) -> list[list[Moments]]:
    """Moments by segment (the base last) and log."""
    by_log = [all_moments(tree, T_parent_joint, log) for log in logs]
    return [list(segment) for segment in zip(*by_log, strict=True)]


def _best_directions(segments: Sequence[Moments], U: int, priors: Priors) -> list[F64]:
    """Directions of gravity (3,) in one log that leave least, far from each other."""
    ups = _sphere(_DIRECTIONS)
    B = np.stack([gravity_known(up) for up in ups])
    least = np.full((U, len(ups)), np.inf)
    for m in segments:
        N, c = m.N.sum(axis=1), m.c.sum(axis=1)
        yy = m.yy.sum(axis=1)
        for u in range(U):
            small = np.swapaxes(B, 1, 2) @ N[u] @ B + np.diag(linear_ridge(priors.bias))
            target = np.swapaxes(B, 1, 2) @ c[u]
            x = np.linalg.solve(small, target)
            least[u] = np.minimum(least[u], yy[u] - (x * target).sum(axis=(1, 2)))
    count = segments[0].count.sum(axis=1)
    size = np.maximum(least, 0.0) / np.maximum(count, 1)[:, None] + NOISE**2
    score = (count[:, None] * np.log(size)).sum(axis=0)
    out: list[F64] = []
    for i in np.argsort(score):
        if all(ups[i] @ other < np.cos(np.deg2rad(30.0)) for other in out):
            out.append(ups[i])
        if len(out) == _FOLLOWED:
            break
    return out


def _sphere(n: int) -> F64:
    """(n, 3) directions, evenly spread (Fibonacci's spiral)."""
    k = np.arange(n) + 0.5
    z, turn = 1 - 2 * k / n, np.pi * (1 + np.sqrt(5)) * k
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _settled(moments: list[list[Moments]], up: F64, U: int, priors: Priors) -> Placed:
    """Segments, placements and gravity's directions in turns, from directions to begin with."""
    su_joint = np.full(U, -2)
    fits: list[Fit] = []
    for _ in range(_ROUNDS):
        found = [_on_best(moments, u, up, priors) for u in range(U)]
        segments = np.array([k for k, _ in found])
        fits, up = _turned(moments, segments, [fit for _, fit in found], up, priors)
        if (segments == su_joint).all():
            break
        su_joint = segments
    return _placed(moments, su_joint, fits, up)


def _on_best(moments: list[list[Moments]], u: int, up: F64, priors: Priors) -> tuple[int, Fit]:
    """The segment (-1 for the base) on which an SU leaves least, and its placement there.

    What a linear fit leaves is a lower bound: it knows nothing of rotations.
    """
    sums = [sums_of(logs, u, up) for logs in moments]
    bounds = np.array([linear(each, priors.bias)[1] for each in sums])
    first, *others = (int(k) for k in np.argsort(bounds))
    best, least = first, fitted(sums[first], moments[first], u, priors)
    for k in others:
        if bounds[k] > least.cost:
            break
        fit = fitted(sums[k], moments[k], u, priors)
        if fit.cost < least.cost * (1 - _SAME):
            best, least = k, fit
    return (best if best < len(moments) - 1 else -1), least


def _turned(
    moments: list[list[Moments]], su_joint: Int, fits: list[Fit], up: F64, priors: Priors
) -> tuple[list[Fit], F64]:
    """Levenberg-Marquardt on gravity's directions, placements following.

    Each SU counts by what it leaves, so that one that fits nowhere turns gravity for no other. How
    an SU is turned about gravity that stands still in it is any to begin with, and may lead the
    first step away from where it leads the next.
    """
    own = [moments[k] for k in su_joint]
    sums = [sums_of(each, u, up) for u, each in enumerate(own)]
    count = np.array([sum(m.count[u].sum() for m in each) for u, each in enumerate(own)])
    size, damping, moved = _sizes(fits, count), _DAMPING, True
    for _ in range(_TURNS):
        if moved:
            axes = np.stack([turn_axes(each) for each in up])
            H, g = np.zeros((2 * len(up), 2 * len(up))), np.zeros(2 * len(up))
            for fit, each, weight in zip(fits, sums, 1 / size, strict=True):
                own_H, own_g = up_equations(fit, replace(each, up=up), axes, priors)
                H += weight * own_H
                g += weight * own_g
        largest = float(np.diag(H).max(initial=0.0))
        step = np.linalg.solve(H + (damping * largest + 1e-9) * np.eye(len(H)), g)
        if not g @ step > _SAME * count.sum():
            break
        step = step.reshape(-1, 2) * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
        turn = np.einsum("gij,gj->gi", axes, step)
        there = np.einsum("gij,gj->gi", rotation_exp(turn), up)
        trial = again(fits, [replace(each, up=there) for each in sums], own, priors)
        smaller = _sizes(trial, count)
        moved = bool(count @ np.log(smaller) < count @ np.log(size))
        damping = max(damping / 10, _DAMPING) if moved else max(damping * 10, _DAMPED)
        if moved:
            fits, up, size = trial, there, smaller
    return fits, up


def _sizes(fits: Sequence[Fit], count: Int) -> F64:
    """(U,) mean squares that fits leave of samples (U,), and noise [m^2/s^4]."""
    return np.asarray(np.array([fit.cost for fit in fits]) / (3 * np.maximum(count, 1)) + NOISE**2)


def _well_placed(fit: Fit, sums: Sums, priors: Priors, noise: float) -> bool:
    """Whether the motion of a segment shows in two directions at least where an SU sits on it."""
    return bool(place_deviations(fit, sums, priors, noise)[1] < _NEAR_AXIS)


def _placed(moments: list[list[Moments]], su_joint: Int, fits: list[Fit], up: F64) -> Placed:
    count = sum(m.count.sum(axis=1) for m in moments[0])
    left = [np.sqrt(fit.rss.sum() / (3 * max(n, 1))) for fit, n in zip(fits, count, strict=True)]
    nothing = ((),) * len(fits)
    return Placed(su_joint, tuple(fits), up, nothing, np.array(left), nothing)


def _with_alternatives(found: Placed, moments: list[list[Moments]], priors: Priors) -> Placed:
    """The same, with the segments that no motion tells from those that were taken.

    The one that leaves least is taken.
    """
    su_joint, fits, instead, by_chance = np.array(found.su_joint), list(found.fits), [], []
    order = [-1, *range(len(moments) - 1)]
    for u, (k, fit) in enumerate(zip(found.su_joint, found.fits, strict=True)):
        alike = {int(k): fit}
        for other in order:
            if other == k:
                continue
            sums = sums_of(moments[other], u, found.up)
            if linear(sums, priors.bias)[1] > 4 * fit.cost:
                continue
            there = fitted(sums, moments[other], u, priors)
            strange = sensor_chi2(there, priors) - sensor_chi2(fit, priors) > _NO_SENSOR
            if not (strange or clearly_less(fit.rss, there.rss)):
                alike[other] = there
        # Where no joint between moved at all, the one nearest to the base.
        least = min(each.cost for each in alike.values())
        first = next(j for j in order if j in alike and alike[j].cost <= least * (1 + _SAME))
        rare = set[int]()
        if -1 in alike:
            # What keeps still sits on the base, and on a joint's very axis by rare chance alone.
            first = -1
            rare = {
                j
                for j, there in alike.items()
                if j != -1
                and _well_placed(there, sums_of(moments[j], u, found.up), priors, found.left[u])
            }
        su_joint[u], fits[u] = first, alike[first]
        others = [j for j in order if j in alike and j != first]
        instead.append(tuple(j for j in others if j not in rare))
        by_chance.append(tuple(j for j in others if j in rare))
    count = sum(m.count.sum(axis=1) for m in moments[0])
    left = [np.sqrt(fit.rss.sum() / (3 * max(n, 1))) for fit, n in zip(fits, count, strict=True)]
    both = tuple(instead), np.array(left), tuple(by_chance)
    return Placed(su_joint, tuple(fits), found.up, *both)
