"""Trees grown outwards: which joint, next to what is known, explains the gravity an SU feels.

An SU sits one joint further out than a known segment (:mod:`skin2urdf.structure.grown`) if one axis
explains what it feels besides. Of all joints, segments and SUs the one is taken next that leaves
least unexplained, as long as that is worth more than its parameters; where segments in between
carry no SU, two or three joints are put in at once. Nothing is compared with a threshold: what a
fit leaves is weighed by the logarithm of its chi-squared, and parameters by that of the
measurements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.geometry.so3 import fibonacci_sphere, spread_out
from skin2urdf.structure.chain_fit import Carried, GravityFits, axis_losses, fit_gravity
from skin2urdf.structure.gravity import GravityWindows
from skin2urdf.structure.grown import MISSING, Grown
from skin2urdf.threads import each

_GRID = 200
"""Candidate axes of a joint, some 14 deg apart: no axis is further than 8 deg from one of them, and
Gauss-Newton converges from there."""
_REFINED = 12
"""Most promising pairs of SU and joint that are fitted before one is chosen."""
_STARTS = 2
"""Axes from which each of them is fitted; where gravity hardly moves, two mirror images compete."""
_UPRIGHT = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
"""Axes of which gravity tells nothing, from which each is fitted as well."""
_SEARCHED = 60
"""Windows on which chains of several joints are searched before they are fitted to all."""
_RANDOM_STARTS = {2: 16, 3: 24}
"""Random axes from which chains of several joints are fitted. Of simulated chains of two (three)
joints with 45 rests, one start in three (one in six) leads to the optimum."""

_TRIED = 4
"""SUs for which chains of several joints are searched at a time, those that feel least first."""
_NEAR = 6
"""Segments on which an SU fits best, beyond which chains of several joints are searched."""
_LIKELY = 8
"""Joints that explain most by themselves, of which chains of two are made."""
_TRIPLES = 120
"""Chains of three that are searched for an SU beyond each of these segments, at least: as many as
there are orders of six joints. More would take longer than all else."""
_FINALISTS = 8
"""Chains of several joints, of all that are searched for an SU, that are fitted to all windows."""
_LEFT = 0.1
"""Share of an SU's log-likelihood that a chain may leave without a joint being missing: where one
is, 0.79 to 0.99 are left (29 simulated recordings of panda, ur5 and z1 with a bare segment)."""
_CHUNK = 400_000
"""Entries of Jacobians that are held at a time."""

_Chain = tuple[int, tuple[int, ...]]
"""A known segment, and the joints beyond it."""
_Promise = tuple[float, int, int, int]
"""What gravity alone leaves per measurement, of an SU beyond a known segment by one joint."""
_Problem = tuple[int, int, tuple[int, ...]]
"""An SU, the known segment, and the joints beyond it."""
_Found = tuple[float, F64]
"""Chi-squared that a chain leaves of an SU in few windows, and (m, 3) its axes."""


@dataclass(frozen=True, eq=False)
class _Extension:
    """Joints beyond a known segment that explain what an SU feels.

    Attributes:
        su: the SU.
        segment: the known segment.
        dofs: joints beyond it, outwards.
        axes: (m, 3) their axes.
        misfit: what the fit leaves.
        gain: what that is less than on the best known segment, less the price of the parameters.
        before: (k, 3) axes of the joints up to the known segment, where they were fitted again;
            None where they are as they were.
    """

    su: int
    segment: int
    dofs: tuple[int, ...]
    axes: F64
    misfit: float
    gain: float
    before: F64 | None = None


@dataclass(frozen=True, eq=False)
class Known:
    """A tree that is known already, of which axes alone are sought.

    Attributes:
        before: the joint before each one, -1 for the RS.
        joint: the joint on which each SU of the tree sits, -1 for the RS.
    """

    before: Mapping[int, int]
    joint: Mapping[int, int]


def grow(
    windows: GravityWindows,
    moved: Sequence[int],
    rng: np.random.Generator,
    known: Known | None = None,
    up: F64 | None = None,
    tell: Callable[[float], None] = lambda _: None,
) -> Grown:
    """Add joints to a tree until none is worth its parameters.

    The base frame is that of one log, whose first joints tell where gravity points in the others. A
    log of an upright base shows no upright joint, and is off by all that this turns: where SUs
    remain that no chain explains, a tree is grown from another log.

    Args:
        windows: the measurements.
        moved: the joints that moved.
        rng: draws axes from which chains of several joints are searched.
        known: the tree, where it is known already: it grows no further where nothing explains what
            an SU feels, since rotations beyond are not to be had.
        up: (G, 3) upward unit vectors of the logs in the base frame, where they are known.
        tell: told the share of the joints that are placed.
    """
    trees = []
    for begin in _beginnings(windows) if up is None else (up,):
        search = _Search(windows, moved, rng, known, begin)
        search.grow(tell)
        trees.append(search.tree)
        if search.tree.explained()[search.tree.n > 0].all():
            break
    return max(trees, key=lambda tree: int(tree.explained()[tree.n > 0].sum()))


class _Search:
    """The search for the next joints of a tree; its arguments are those of :func:`grow`."""

    def __init__(
        self,
        windows: GravityWindows,
        moved: Sequence[int],
        rng: np.random.Generator,
        known: Known | None,
        up: F64,
    ) -> None:
        self.windows = windows
        self._moved = tuple(moved)
        self._rng = rng
        self._known = known
        self._grid = fibonacci_sphere(_GRID)
        self._begin(Grown(windows, up))

    def _begin(self, tree: Grown) -> None:
        """Forget what was fitted beyond segments that have changed."""
        self.tree = tree
        self._losses: dict[tuple[int, int], F64] = {}
        self._fitted: dict[tuple[int, int, int], tuple[float, F64]] = {}
        self._searched: dict[int, dict[_Chain, _Found]] = {}

    def grow(self, tell: Callable[[float], None]) -> None:
        """Add joints, see :func:`grow`."""
        while True:
            tell(1.0 - len(self._unplaced) / max(len(self._moved), 1))
            found = self._next()
            if found is None or (self._known is not None and not self._explained(found)):
                return
            self._extend(found)
            up = self.tree.felt_elsewhere(found.su)
            if up is not None:
                known = [(s.parent, s.dof, s.axis) for s in self.tree.segments[1:]]
                self._begin(Grown(self.windows, up, known))

    def _extend(self, found: _Extension) -> None:
        """Add an extension's joints, once those before them are turned as it has them."""
        if found.before is not None:
            self._begin(self._turned(found))
        at = found.segment
        for dof, axis in zip(found.dofs, found.axes, strict=True):
            self.tree.add(at, dof, axis)
            at = len(self.tree.segments) - 1

    @property
    def _unplaced(self) -> tuple[int, ...]:
        """Joints that moved and are not in the tree."""
        placed = self.tree.placed
        return tuple(d for d in self._moved if d not in placed)

    def _next(self) -> _Extension | None:
        """The extension that leaves least, of those that are worth their parameters."""
        found = self._with_axes_before(self._single())
        for length in _RANDOM_STARTS:
            if found is not None and (
                self._is_noise(found) if length == 2 else self._explained(found, MISSING)
            ):
                break
            # What one joint leaves beyond noise may be an upright one before it: gravity alone does
            # not show it, and it would find no place once axes are bent to do without it.
            upright = found is not None and self._explained(found)
            longer = self._with_axes_before(self._longer(length, upright=upright))
            price = 0.0 if longer is None else self._price(longer.su, length, 1)
            if longer and (found is None or longer.misfit + price < found.misfit):
                found = longer
        return found

    def _with_axes_before(self, option: _Extension | None) -> _Extension | None:
        """An extension with all axes before it fitted again, where that says more than it costs.

        Along a level axis a bias is felt as a tilt is: SUs right beyond it leave it open, and those
        that other joints turn over tell.
        """
        if option is None or option.misfit <= self.tree.noise()[option.su]:
            return option
        chain = self.tree.chain(option.segment)
        if not chain:
            return option
        dofs = (*(self.tree.segments[i].dof for i in chain), *option.dofs)
        axes = np.array([*(self.tree.segments[i].axis for i in chain), *option.axes])
        chi2, found = self._fit([(option.su, 0, dofs)], axes[None])
        left = float(self.tree.misfit(chi2[0], np.array(option.su)))
        gain = option.misfit - left - self._price(option.su, len(chain), 1)
        if gain <= 0:
            return option
        before, beyond = found[0, : len(chain)], found[0, len(chain) :]
        turned = replace(option, axes=beyond, misfit=left, gain=option.gain + gain, before=before)
        return turned if self._suits_others(turned) else option

    def _suits_others(self, option: _Extension) -> bool:
        """Whether SUs that are explained still are where axes before an extension are turned."""
        at_most = np.maximum(self.tree.noise(), self.tree.best()[1])
        explained = self.tree.explained() & (self.tree.n > 0)
        return bool((self._turned(option).best()[1] <= at_most)[explained].all())

    def _turned(self, option: _Extension) -> Grown:
        """The tree with the axes that an extension has before it."""
        axes = [s.axis for s in self.tree.segments]
        if option.before is not None:
            for i, axis in zip(self.tree.chain(option.segment), option.before, strict=True):
                axes[i] = axis
        known = [
            (s.parent, s.dof, axis)
            for s, axis in zip(self.tree.segments[1:], axes[1:], strict=True)
        ]
        return Grown(self.windows, self.tree.up, known)

    def _explained(self, option: _Extension, share: float = _LEFT) -> bool:
        """Whether an extension leaves too little for more joints to be looked for at once.

        That is the noise as stated, or what a sensor that is worse than that leaves once all but a
        share of its misfit is gone.
        """
        noise = float(self.tree.noise()[option.su])
        now = float(self.tree.best()[1][option.su])
        return option.misfit <= noise + share * max(0.0, now - noise)

    def _is_noise(self, option: _Extension) -> bool:
        """Whether an extension leaves no more than noise as stated."""
        return option.misfit <= float(self.tree.noise()[option.su])

    def _price(self, su: int, joints: int, candidates: int) -> float:
        """Half the logarithm of the measurements for each parameter, and that of the candidates."""
        return joints * float(np.log(max(self.tree.n[su], 2.0))) + float(np.log(max(candidates, 1)))

    def _single(self) -> _Extension | None:
        """The best extension by one joint."""
        free = self._unplaced
        _, now = self.tree.best()
        open_ = np.flatnonzero((now > self.tree.noise()) & (self.tree.n > 0))
        for s, segment in enumerate(self.tree.segments):
            gravity = self.tree.gravity(segment.R)
            for d in free:
                if (s, d) not in self._losses and self._may_follow(segment.dof, d):
                    losses = np.full((len(now), len(self._grid)), np.inf)
                    there = [u for u in open_ if self._may_carry(d, int(u))]
                    losses[there] = axis_losses(
                        self.windows.q[:, d], gravity, self.windows.reading[:, there],
                        self.tree.rough[:, there], self._grid,
                    )  # fmt: skip
                    self._losses[s, d] = losses
        self._fit_most_promising(free)
        candidates = len(free) * len(self.tree.segments) * len(now)
        options = [
            _Extension(u, s, (d,), axis[None], left, now[u] - left - self._price(u, 1, candidates))
            for (u, s, d), (left, axis) in self._fitted.items()
            if d in free
        ]
        noise, explained = self.tree.noise(), self.tree.explained()
        # Of an SU that lacks no joint, one more has to explain most of what is left: the rest of it
        # is what accelerations make, of which any joint explains something.
        at_most = np.where(explained, noise + MISSING * np.maximum(now - noise, 0), np.inf)
        worth = [o for o in options if o.gain > 0 and o.misfit <= at_most[o.su]]
        return min(worth, key=self._left, default=None)

    def _left(self, option: _Extension) -> tuple[float, float]:
        """What to compare extensions by: misfit per measurement, then gain."""
        return option.misfit / max(float(self.tree.n[option.su]), 1.0), -option.gain

    def _may_follow(self, dof: int, other: int) -> bool:
        """Whether a joint (-1: the RS) may carry the segment that another one moves."""
        return self._known is None or self._known.before.get(other) == dof

    def _may_carry(self, dof: int, su: int) -> bool:
        """Whether an SU may sit on the segment that a joint moves."""
        return self._known is None or self._known.joint.get(su) == dof

    def _fit_most_promising(self, free: Sequence[int]) -> None:
        """Fit the extensions of one joint that promise most, until the best are fitted."""
        rows = [
            (float(left), u, s, d)
            for (s, d), losses in self._losses.items()
            if d in free
            for u, left in enumerate(losses.min(axis=1) / np.maximum(self.tree.n, 1.0))
            if (u, s, d) not in self._fitted and np.isfinite(left)
        ]
        rows = self._most_promising(sorted(rows))
        keys, starts = [], []
        for _, u, s, d in rows:
            order = np.argsort(self._losses[s, d][u], kind="stable")
            # To gravity alone others pass for what upright ones accelerate.
            for axis in (*spread_out(self._grid[order], _STARTS), *_UPRIGHT):
                keys.append((u, s, d))
                starts.append(axis)
        if not keys:
            return
        chi2, axes = self._fit([(u, s, (d,)) for u, s, d in keys], np.array(starts)[:, None])
        for key, c, k in zip(keys, chi2, axes, strict=True):
            left = float(self.tree.misfit(c, np.array(key[0])))
            if key not in self._fitted or left < self._fitted[key][0]:
                self._fitted[key] = left, k[0]

    def _most_promising(self, rows: list[_Promise]) -> list[_Promise]:
        """The first of all, and where joints accelerate SUs, the first of each beyond each segment.

        To gravity alone an upright joint promises nothing, and explains nearly all that SUs right
        beyond it feel once accelerations are modelled.
        """
        chosen = rows[:_REFINED]
        if self.windows.moving is not None:
            looked_at = {(s, d) for _, s, d in self._fitted} | {(s, d) for *_, s, d in chosen}
            for row in rows:
                if row[2:] not in looked_at:
                    looked_at.add(row[2:])
                    chosen.append(row)
        return chosen

    def _fit(
        self,
        problems: Sequence[_Problem],
        axes: F64,
        *,
        windows: Int | None = None,
        iterations: int = 12,
        roughly: bool = False,
    ) -> tuple[F64, F64]:
        """Chi-squared and axes of extensions from given axes (K, m, 3).

        ``roughly`` takes accelerations for noise, as the first of many starts may.
        """
        at = np.arange(len(self.windows.q)) if windows is None else windows
        known = {s for _, s, _ in problems}
        gravity = {s: self.tree.gravity(self.tree.segments[s].R)[at].T for s in known}
        length = axes.shape[1]
        modelled = self.windows.moving is not None and not roughly
        weight = self.tree.weight if modelled else self.tree.rough
        width = 12 + 2 * length
        if modelled:
            width += 3 * length + 1 + max(len(self.tree.segments[s].columns) for s in gravity)
        chunk = max(1, _CHUNK // (3 * len(at) * width))

        def fitted(first: int) -> GravityFits:
            some = problems[first : first + chunk]
            sus = np.array([u for u, _, _ in some])
            return fit_gravity(
                np.array([self.windows.q[np.ix_(at, np.array(dofs))].T for _, _, dofs in some]),
                np.array([gravity[s] for _, s, _ in some]),
                np.ascontiguousarray(self.windows.reading[np.ix_(at, sus)].transpose(1, 2, 0)),
                np.ascontiguousarray(weight[np.ix_(at, sus)].T),
                axes[first : first + chunk],
                iterations,
                self._carried(some, at) if modelled else None,
                np.ascontiguousarray(self.tree.rough[np.ix_(at, sus)].T),
            )

        fits = list(each(fitted, range(0, len(problems), chunk), len(problems)))
        return np.concatenate([f.chi2 for f in fits]), np.concatenate([f.axes for f in fits])

    def _carried(self, problems: Sequence[_Problem], at: Int) -> Carried | None:
        """How the known segments of some problems move in some of the windows."""
        moving = self.windows.moving
        if moving is None:
            return None
        segments = [self.tree.segments[s] for _, s, _ in problems]
        columns = np.zeros((len(problems), max(len(s.columns) for s in segments), 3, len(at)))
        for k, segment in enumerate(segments):
            columns[k, : len(segment.columns)] = segment.columns[..., at]
        return Carried(
            np.array([s.omega[:, at] for s in segments]),
            np.array([s.alpha[:, at] for s in segments]),
            columns,
            np.array([moving.qd[np.ix_(at, np.array(dofs))].T for _, _, dofs in problems]),
            np.array([moving.qdd[np.ix_(at, np.array(dofs))].T for _, _, dofs in problems]),
            np.array([moving.change[at, u].T for u, _, _ in problems]),
        )

    def _longer(self, length: int, *, upright: bool) -> _Extension | None:
        """The best extension by several joints, of SUs that are not explained yet.

        Args:
            length: how many.
            upright: whether only those are looked for of which the first may be upright.
        """
        free = self._unplaced
        if len(free) < length:
            return None
        _, now = self.tree.best()
        unexplained = np.flatnonzero(~self.tree.explained() & (self.tree.n > 0))
        best: _Extension | None = None
        for u in sorted(unexplained, key=lambda u: now[u] / self.tree.n[u])[:_TRIED]:
            option = self._longer_chain(int(u), length, free, now[u], upright=upright)
            if option and (best is None or self._left(option) < self._left(best)):
                best = option
            if best is not None and self._explained(best):
                break
        return best

    def _longer_chain(
        self, su: int, length: int, free: Sequence[int], now: float, *, upright: bool
    ) -> _Extension | None:
        """The best extension by several joints of one SU, of those that few windows rank first."""
        steady = [not upright or self.tree.is_steady(s) for s in self.tree.segments]
        chains = [
            (s, dofs)
            for s, dofs in (self._pairs(su, free) if length == 2 else self._triples(su, free))
            if steady[s]
            and self._may_carry(dofs[-1], su)
            and all(self._may_follow(a, b) for a, b in pairwise((self.tree.segments[s].dof, *dofs)))
        ]
        if not chains:
            return None
        self._search(su, length, chains)
        found = self._searched[su]
        best = sorted(chains, key=lambda chain: found[chain][0])[:_FINALISTS]
        some: list[_Problem] = [(su, *chain) for chain in best]
        chi2, axes = self._fit(some, np.array([found[chain][1] for chain in best]))
        i = int(np.argmin(chi2))
        left = float(self.tree.misfit(chi2[i], np.array(su)))
        gain = now - left - self._price(su, length, len(chains))
        return _Extension(su, *best[i], axes[i], left, gain) if gain > 0 else None

    def _search(self, su: int, length: int, chains: Sequence[_Chain]) -> None:
        """Fit chains of as many joints to an SU in few windows, from random axes, in two rounds.

        What was searched before stays so, as long as no segment that is known changes: chains
        beyond those that have been added since are new.
        """
        searched = self._searched.setdefault(su, {})
        new = [chain for chain in chains if chain not in searched]
        if not new:
            return
        starts = _RANDOM_STARTS[length]
        axes = self._rng.standard_normal((len(new) * starts, length, 3))
        axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
        heaviest = np.argsort(-self.tree.rough[:, su], kind="stable")[: 2 * _SEARCHED]
        few = heaviest[:: max(1, len(heaviest) // _SEARCHED)]
        problems: list[_Problem] = [(su, *chain) for chain in new for _ in range(starts)]
        chi2, axes = self._fit(problems, axes, windows=few, iterations=4, roughly=True)
        first = np.arange(len(new)) * starts + chi2.reshape(-1, starts).argmin(axis=1)
        chi2, axes = self._fit([problems[i] for i in first], axes[first], windows=few)
        searched |= {chain: (float(c), k) for chain, c, k in zip(new, chi2, axes, strict=True)}

    def _pairs(self, su: int, free: Sequence[int]) -> list[_Chain]:
        """Two joints in a row beyond the segments on which an SU fits best."""
        likely = list(free)
        if self._known is None:
            # Each of two joints explains something by itself, wherever it is put.
            near = self._near(su)
            alone = [min(float(self._losses[s, d][su].min()) for s in near) for d in free]
            likely = [free[i] for i in np.argsort(alone, kind="stable")[:_LIKELY]]
        return [(s, dofs) for s in self._near(su) for dofs in permutations(likely, 2)]

    def _triples(self, su: int, free: Sequence[int]) -> list[_Chain]:
        """The pairs that leave least, with any other joint before, between or behind them.

        A joint that says little by itself is found by what it adds to the other two.
        """
        if self._known is not None:
            return [(s, dofs) for s in self._near(su) for dofs in permutations(free, 3)]
        found: dict[_Chain, None] = {}
        near, searched = self._near(su), self._searched.get(su, {})
        most = _TRIPLES * len(near)
        pairs = [(s, dofs) for s, dofs in searched if len(dofs) == 2 and s in near]
        for s, (a, b) in sorted(pairs, key=lambda pair: searched[pair][0]):
            if a in free and b in free:
                for c in set(free) - {a, b}:
                    found |= dict.fromkeys(((s, (c, a, b)), (s, (a, c, b)), (s, (a, b, c))))
            if len(found) >= most:
                break
        return list(found)

    def _near(self, su: int) -> list[int]:
        """Segments on which an SU fits best."""
        misfit = [s.misfit[su] for s in self.tree.segments]
        return [int(s) for s in np.argsort(misfit, kind="stable")[:_NEAR]]


def _beginnings(windows: GravityWindows) -> Iterator[F64]:
    """(G, 3) upward unit vectors of which that of one log is known: it makes the base frame.

    The log that holds most of the motion shows the first joints best, and comes first.
    """
    logs = int(windows.log.max(initial=0)) + 1
    spread = [
        float(np.ptp(windows.q[windows.log == g], axis=0).sum()) if g in windows.log else 0.0
        for g in range(logs)
    ]
    for g in np.argsort(-np.array(spread), kind="stable"):
        up = np.full((logs, 3), np.nan)
        up[g] = (0.0, 0.0, 1.0)
        yield up
