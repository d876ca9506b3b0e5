"""Kinematic trees from any motion: rests, slow motion, moves of several joints at once.

    found = trees_from_motion(sampled, su_names)       # best first; StructureError if there is none
    found[0].tree, found[0].axes, found[0].R_base_su   # ...
    estimation.start.from_rests.state_of(found[0])     # a State: orientations, all offsets zero

No patterns and no moves of single joints are needed. What the log can not tell apart comes out as
several structures, each with what it leaves unexplained; whoever takes the first one has to say so
if there are more.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.errors import StructureError
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.notes import Note
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.accelerations import PARALLEL, Along, ChainJoint, along
from skin2urdf.structure.anew import that_slide_elsewhere, with_joints_elsewhere
from skin2urdf.structure.draft import Draft
from skin2urdf.structure.elsewhere import with_sus_elsewhere
from skin2urdf.structure.facing import facing_one_way
from skin2urdf.structure.gravity import OFF_IN_TIME, GravityWindows, gravity_windows, moments
from skin2urdf.structure.grown import Grown
from skin2urdf.structure.growth import Known, grow
from skin2urdf.structure.hidden_joints import (
    in_best_order,
    that_may_slide,
    that_slide,
    with_unseen_joints,
)
from skin2urdf.structure.otherwise import that_move_otherwise
from skin2urdf.structure.records import KinematicTree
from skin2urdf.structure.tilted import Tilted, tilts_of_base
from skin2urdf.structure.tree_notes import doubt, left_out
from skin2urdf.structure.worth import QUIET

_EXPLAINED = 2.0
"""Chi-squared per measurement up to which gravity is explained: what windows may be off by is the
larger part of it, and sound logs leave less than 1."""


@dataclass(frozen=True, eq=False)
class MotionTree(Record):
    """A kinematic tree with the directions that gravity shows.

    All directions are given in the base frame of the first log, whose z axis points up, with the
    robot at position zero: a segment's rotation is ``Rot(k_1, q_1) .. Rot(k_n, q_n)``. What only
    turns everything about the vertical is arbitrary, and so is a branch's turn about it before the
    first joint that turns gravity.

    Attributes:
        tree: the structure, D joints and U SUs.
        axes: (D, 3) unit joint axes, or directions of sliding joints.
        R_base_su: (U, 3, 3) SU orientations.
        up: (G, 3) unit vectors opposite to gravity, per log; the first is z.
        bias: (U, 3) of the SUs [m/s^2].
        shape: (U, 6) scale errors xx, yy, zz and cross-axis yz, xz, xy of the SUs [1].
        chi2: (U,) chi-squared per measurement that gravity leaves of each SU; about 1 or less where
            it is explained, given what accelerations can make of it.
        left: (U,) rms of what a linear fit of the accelerations along the whole logs leaves of each
            SU's readings [m/s^2]: the noise where the structure is right.
    """

    tree: KinematicTree
    axes: F64
    R_base_su: F64
    up: F64
    bias: F64
    shape: F64
    chi2: F64
    left: F64

    @property
    def turns_gravity(self) -> bool:
        """Whether each joint turns gravity: none slides or is vertical."""
        return not (self.tree.prismatic | (np.abs(self.axes[:, 2]) > PARALLEL)).any()

    @property
    def misfit(self) -> float:
        """Rms of what is left of all SUs' readings [m/s^2]."""
        return float(np.sqrt(np.mean(self.left**2)))


def trees_from_motion(
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    known: KinematicTree | None = None,
    seed: int = 0,
    tell: Callable[[float], None] = lambda _: None,
) -> tuple[MotionTree, ...]:
    """Of the trees by rests and by moves those of the kind that leaves less, best first.

    See :func:`trees_of_both_kinds` for what it takes and raises.
    """
    return trees_of_both_kinds(sampled, su_names, known, seed, tell)[0]


def trees_of_both_kinds(
    sampled: Sequence[Sampled],
    su_names: Sequence[str],
    known: KinematicTree | None = None,
    seed: int = 0,
    tell: Callable[[float], None] = lambda _: None,
) -> list[tuple[MotionTree, ...]]:
    """Trees by rests and trees by moves, those first whose best one leaves less.

    Rests show gravity alone; where there are few, moves show it beside accelerations. Directions by
    either kind may be too rough to tell whose tree is right, where these are not the same. Where a
    base that stands still leaves more than gravity may be off by, the SU in which gravity turns
    least is taken to be on one that tilts, if that leaves less of all others.

    Args:
        sampled: the logs on their grids, with the same joints and SUs.
        su_names: U SU names.
        known: a tree that is right, where there is one: none other is then tried.
        seed: of the random axes from which chains are searched where segments carry no SU.
        tell: told the share of the work that is done.

    Returns:
        Of one kind or of both: the best tree, and those not told from it for certain.

    Raises:
        StructureError: no SU feels any joint move, or no chain of joints explains what any feels.
    """
    search = _Search(sampled, su_names, known, seed, tell)
    try:
        trees = search.on_still_base()
    except StructureError:
        if search.on_tilted_base is None:
            raise
        return search.on_tilted_base
    if _is_explained(trees[0][0], su_names) or search.on_tilted_base is None:
        return trees
    return search.on_tilted_base if search.tilts_leave_less(trees[0]) else trees


@dataclass(frozen=True, eq=False)
class _Search:
    """Trees of both kinds, on a base that stands still and on one that tilts.

    Attributes are the arguments of :func:`trees_of_both_kinds`.
    """

    sampled: Sequence[Sampled]
    su_names: Sequence[str]
    known: KinematicTree | None
    seed: int
    tell: Callable[[float], None]

    def on_still_base(self) -> list[tuple[MotionTree, ...]]:
        """Trees on a base that stands; not by moves where rests show that it tilts.

        What shakes a base is no gravity along moves: chains of any joints are then tried in vain.

        Raises:
            StructureError: no SU feels any joint move, or no chain explains what any feels.
        """
        return self._of_both_kinds(None, self._is_seen_to_tilt)

    @cached_property
    def on_tilted_base(self) -> list[tuple[MotionTree, ...]] | None:
        """Trees on a base that tilts as an SU on it feels; None where none does, or shows."""
        if self._base is None:
            return None
        try:
            return self._of_both_kinds(self._base, self._explains_all)
        except StructureError:
            return None

    def tilts_leave_less(self, trees: tuple[MotionTree, ...]) -> bool:
        """Whether a base that tilts leaves less of all SUs that are not on it than some trees."""
        tilted, base = self.on_tilted_base, self._base
        if tilted is None or base is None:
            return False
        # What the SU on the base feels is explained by itself, whatever carries it.
        heard = [name for u, name in enumerate(self.su_names) if u != base.su]
        left, there = (
            _unexplained(each[0], self._samples, self.su_names, heard)
            for each in (trees, tilted[0])
        )
        return there < left

    @cached_property
    def _base(self) -> Tilted | None:
        return tilts_of_base(self.sampled)

    @cached_property
    def _samples(self) -> Along:
        return along(self.sampled)

    def _explains_all(self, trees: tuple[MotionTree, ...]) -> bool:
        return _is_explained(trees[0], self.su_names)

    def _is_seen_to_tilt(self, trees: tuple[MotionTree, ...]) -> bool:
        """Whether all that rests leave on a base that stands is explained on one that tilts."""
        if self._explains_all(trees) or self.on_tilted_base is None:
            return False
        return self._explains_all(self.on_tilted_base[0]) and self.tilts_leave_less(trees)

    def _of_both_kinds(
        self, base: Tilted | None, are_enough: Callable[[tuple[MotionTree, ...]], bool]
    ) -> list[tuple[MotionTree, ...]]:
        """Trees by rests and by moves on a base that stands still, or that tilts as an SU feels.

        Args:
            base: how it tilts; None where it stands.
            are_enough: whether trees by rests make those by moves needless.
        """
        sampled, su_names = self.sampled, self.su_names
        spans = () if base is None else base.span
        samples = self._samples if base is None else along(sampled, spans)
        grown: list[tuple[MotionTree, ...]] = []
        missing: list[StructureError] = []

        def add(i: int, windows: GravityWindows, *, bare: bool = True) -> None:
            def part(share: float) -> None:
                self.tell(min(1.0, (i + share) / 2))

            try:
                trees = _grown_from(
                    windows, samples, sampled, base, self.known, self.seed, part, bare=bare
                )
            except StructureError as lack:
                missing.append(lack)
                return
            if trees:
                grown.append(trees)
            grown.sort(key=lambda trees: _unexplained(trees[0], samples, su_names, su_names))

        # Where few poses are at rest, all joints may be ones that gravity does not show there. That
        # is looked into, among all there are, only where it does not show all of them in moves.
        of_rests = gravity_windows(sampled, su_names, spans)
        add(0, of_rests, bare=False)
        if grown and are_enough(grown[0]):
            return grown
        turned = bool(grown)
        of_moves = moments(sampled, su_names, spans)
        add(1, of_moves, bare=turned)
        shown = bool(grown)
        all_shown = shown and self._explains_all(grown[0]) and grown[0][0].turns_gravity
        if not (turned or all_shown):
            add(0, of_rests)
            if grown and are_enough(grown[0]):
                return grown
            if not shown:
                add(1, of_moves)
        heard = {name for u, name in enumerate(su_names) if np.isfinite(of_moves.sd[:, u]).any()}
        if not (grown and heard <= set(grown[0][0].tree.su_names)):
            # An SU without a place may be off in time, or its axes be bent.
            add(2, moments(sampled, su_names, spans, off=OFF_IN_TIME))
        if not grown:
            raise missing[0]
        return grown


def _grown_from(
    windows: GravityWindows,
    samples: Along,
    sampled: Sequence[Sampled],
    base: Tilted | None,
    known: KinematicTree | None,
    seed: int,
    tell: Callable[[float], None],
    sliding: tuple[int, ...] = (),
    hidden: tuple[int, ...] = (),
    *,
    bare: bool = True,
) -> tuple[MotionTree, ...]:
    """Trees that some windows show, best first.

    Args:
        windows: of gravity.
        samples: low-passed samples.
        sampled: the logs.
        base: how the base tilts; None where it stands still.
        known: a tree that is right, where there is one.
        seed: of random axes.
        tell: told the share of the work that is done.
        sliding: what joints are, among those of the logs, that are taken to slide, and
        hidden: those that are taken to turn no gravity, as sliding and upright ones.
        bare: whether to go on where gravity shows no joint at all; () is returned else.

    Raises:
        StructureError: they show none.
    """
    moved = moved_joints(sampled)
    tree = None if known is None else _known(known, windows)
    sought = moved if known else moved & windows.may_show
    while True:
        unfelt = (*sliding, *hidden)
        turning = tuple(int(d) for d in np.flatnonzero(sought) if d not in unfelt)
        up = None if base is None else base.up
        pushed = windows.pushed_by(unfelt)
        grown = grow(pushed, turning, np.random.default_rng(seed), tree, up, tell)
        if not bare and len(grown.segments) == 1:
            return ()
        drafts = _drafted(grown, samples, moved, sliding)
        more = () if known else _that_slide(drafts[0], samples)
        if not more:
            break
        # What was taken to turn has bent all directions beyond it.
        sliding += more
    of_span = np.arange(len(sampled)) if base is None else base.log
    best, *others = (_motion_tree(d, grown, samples, sampled, moved, of_span) for d in drafts)
    notes = (*best.tree.notes, *(doubt(best.tree, other.tree) for other in others))
    trees = replace(best, tree=replace(best.tree, notes=notes)), *others
    doubtful = tuple(d for d in that_may_slide(drafts[0], samples) if d not in hidden)
    if known or not doubtful:
        return trees
    try:
        likelier = _grown_from(
            windows, samples, sampled, base, known, seed, tell, sliding, (*hidden, *doubtful)
        )
    except StructureError:
        return trees
    names = windows.su_names
    return min(trees, likelier, key=lambda each: _unexplained(each[0], samples, names, names))


def _drafted(grown: Grown, samples: Along, moved: Bool, sliding: Sequence[int]) -> list[Draft]:
    """What has grown with joints that gravity does not show, best first.

    Raises:
        StructureError: no SU feels any joint move, or no chain of joints explains what any feels.
    """
    if (grown.n > 0).any() and not (grown.explained() & (grown.n > 0)).any():
        left = float(np.nanmin(grown.left()))
        raise StructureError(
            "no order of the joints explains the gravity that the SUs feel: at best "
            f"{left:.2g} m/s^2 of it is left ({np.rad2deg(left / GRAVITY):.2g} deg of its "
            "direction), which is more than noise; either too many joints move between one SU and "
            "the next, or joints are not where their positions say (play, servos that miss)",
            "put an SU on every segment, or move one joint at a time, or give the robot's own "
            "URDF (--model); positions have to be measured ones, not commands",
        )
    draft, otherwise = _with_all_joints(_as_grown(grown), samples, moved, sliding)
    if not draft.joints:
        raise StructureError(
            "no SU feels any joint move",
            "check that the joints moved during the log, and that the SUs sit on moving segments",
        )
    draft, reordered = in_best_order(draft, samples)
    return [facing_one_way(each, samples) for each in (draft, *reordered, *otherwise)]


def _with_all_joints(
    draft: Draft, samples: Along, moved: Bool, sliding: Sequence[int]
) -> tuple[Draft, tuple[Draft, ...]]:
    """What has grown with joints that gravity does not show, and others not told from it.

    SUs that come to sit elsewhere may show joints that had no place before.
    """
    others: tuple[Draft, ...] = ()
    for _ in range(len(moved)):
        placed = {joint.dof for joint in draft.joints}
        unplaced = [int(d) for d in np.flatnonzero(moved) if d not in placed]
        draft, alike = with_unseen_joints(draft, samples, unplaced, sliding)
        others = alike or others
        likelier = with_joints_elsewhere(draft, samples, unplaced, sliding)
        if likelier is not draft:
            # For certain, and so than what was as likely as that draft.
            others = ()
        settled = with_sus_elsewhere(likelier, samples)
        if settled is draft:
            break
        draft = settled
    return draft, tuple(with_sus_elsewhere(other, samples) for other in others)


def _that_slide(draft: Draft, samples: Along) -> tuple[int, ...]:
    """Joints that a draft has as turning and that slide, there or elsewhere."""
    return that_slide(draft, samples) or that_slide_elsewhere(draft, samples)


def _known(tree: KinematicTree, windows: GravityWindows) -> Known:
    """A tree by the places of its joints and SUs among those of some windows."""
    place = [windows.dof_names.index(name) for name in tree.joint_names] + [-1]
    return Known(
        {place[j]: place[before] for j, before in enumerate(tree.parent)},
        {
            windows.su_names.index(n): place[j]
            for n, j in zip(tree.su_names, tree.su_joint, strict=True)
        },
    )


def _is_explained(tree: MotionTree, su_names: Sequence[str]) -> bool:
    """Whether a tree has all SUs, and gravity leaves of none more than what windows may be off."""
    return len(tree.tree.su_names) == len(su_names) and bool((tree.chi2 <= _EXPLAINED).all())


def _unexplained(
    tree: MotionTree, samples: Along, su_names: Sequence[str], counted: Collection[str]
) -> float:
    """Negative log-likelihood of what a tree leaves of readings, whatever their noise is.

    Of an SU that it leaves out, all that changes is left.
    """
    left = dict(zip(tree.tree.su_names, tree.left, strict=True))
    total = 0.0
    for u, name in enumerate(su_names):
        if name not in counted:
            continue
        use = samples.valid[:, u]
        count = 3.0 * use.sum()
        if count and name not in left:
            left[name] = float(np.std(samples.readings[use, u], axis=0).mean())
        if count:
            total += count * float(np.log(np.hypot(left[name], QUIET)))
    return total


def moved_joints(sampled: Sequence[Sampled]) -> Bool:
    """(D,) True for joints that did not keep still in all logs."""
    return np.asarray(np.any([s.motion.named & s.motion.moved for s in sampled], axis=0))


def _as_grown(grown: Grown) -> Draft:
    """The tree that gravity shows, without joints that no SU sits beyond."""
    at, _ = grown.best()
    heard = (grown.n > 0) & grown.explained()
    carrying = sorted({s for u in np.flatnonzero(heard) for s in grown.chain(int(at[u]))})
    index = {s: j for j, s in enumerate(carrying)} | {0: -1, -1: -1}
    segments = [grown.segments[s] for s in carrying]
    fits = [grown.segments[int(s)].fits.one(u) for u, s in enumerate(at)]
    return Draft(
        joints=tuple(ChainJoint(s.dof, "revolute", _triple(s.axis)) for s in segments),
        parent=tuple(index[s.parent] for s in segments),
        su_joint=np.array(
            [index[int(s)] if ok else -2 for s, ok in zip(at, heard, strict=True)], dtype=np.int64
        ),
        R=np.array([f.R[0] for f in fits]),
        sensor=np.array([f.sensor[0] for f in fits]),
        up=np.where(np.isnan(grown.up), (0.0, 0.0, 1.0), grown.up),
    )


def _triple(axis: F64) -> tuple[float, float, float]:
    """A vector as what a frozen record may hold."""
    return float(axis[0]), float(axis[1]), float(axis[2])


def _motion_tree(
    draft: Draft,
    grown: Grown,
    samples: Along,
    sampled: Sequence[Sampled],
    moved: Bool,
    of_span: Int,
) -> MotionTree:
    """A draft in the frame of the first log, with notes on what is left out.

    Args:
        draft: the tree.
        grown: what it has grown from.
        samples: low-passed samples.
        sampled: the logs.
        moved: (D,) joints that moved.
        of_span: (P,) log of each of the draft's directions of gravity.
    """
    windows = grown.windows
    names = windows.dof_names
    heard = np.flatnonzero(draft.su_joint >= -1)
    notes = [
        Note(
            "su left out",
            (windows.su_names[u],),
            detail="no chain" if grown.n[u] > 0 else "no readings",
        )
        for u in np.flatnonzero(draft.su_joint < -1)
    ]
    felt = {joint.dof for joint in draft.joints}
    for d, name in enumerate(names):
        if d in felt:
            continue
        pushed = that_move_otherwise(draft, samples, d) if moved[d] else []
        sus = tuple(windows.su_names[u] for u in pushed)
        notes.append(left_out(sampled, d, name, sus, moved=bool(moved[d])))
    tree = KinematicTree(
        tuple(names[j.dof] for j in draft.joints),
        np.array(draft.parent, dtype=np.int64),
        tuple(j.kind for j in draft.joints),
        tuple(windows.su_names[u] for u in heard),
        draft.su_joint[heard],
        tuple(notes),
    )
    at, _ = grown.best()
    chi2 = [grown.segments[int(at[u])].fits.chi2[u] / grown.n[u] for u in heard]
    judged = [draft.judged(samples, int(u)) for u in heard]
    up = np.array([draft.up[of_span == g].mean(axis=0) for g in range(len(sampled))])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    R = frame_with_z(up[0]).T
    return MotionTree(
        tree,
        np.array([j.axis for j in draft.joints]).reshape(-1, 3) @ R.T,
        R @ draft.R[heard],
        up @ R.T,
        draft.sensor[heard, :3],
        draft.sensor[heard, 3:],
        np.array(chi2),
        np.array([np.sqrt(j.loss.sum() / max(j.count.sum(), 1.0)) for j in judged]),
    )
