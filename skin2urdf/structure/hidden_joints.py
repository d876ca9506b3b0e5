"""Joints that gravity does not show, where accelerations do.

Gravity never shows joints whose axis is vertical, nor sliding ones. It does not show in which order
joints follow each other where no SU sits in between either, if their axes are parallel, or if each
moved at one position of the other only. Where a joint is put in, the accelerations of the moves fit
or do not: every place is tried, and what is beyond it is decided for every branch and SU by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.structure.accelerations import Along, ChainJoint, Judged
from skin2urdf.structure.draft import Draft, groups
from skin2urdf.structure.joint_types import HALF_A_PUSH
from skin2urdf.structure.ordering import bare_neighbours
from skin2urdf.structure.records import JointType
from skin2urdf.structure.worth import (
    CERTAIN,
    gained,
    is_gained_throughout,
    is_push,
    is_shaken,
    price_of,
    unfelt_pushes,
)


@dataclass(frozen=True, eq=False)
class Place:
    """A joint put in somewhere, and the log-likelihood that it gains beyond its price."""

    draft: Draft
    gain: float


def with_unseen_joints(
    draft: Draft, samples: Along, unplaced: Sequence[int], sliding: Sequence[int] = ()
) -> tuple[Draft, tuple[Draft, ...]]:
    """The draft with joints that gravity does not show, where accelerations do.

    Args:
        draft: what gravity shows.
        samples: the logs.
        unplaced: joints that moved and are not in it.
        sliding: those of them that are known to slide; the others may turn about the vertical.

    Returns:
        The draft, and others that the log does not tell from it.
    """
    left = list(unplaced)
    others: list[Draft] = []
    while left:
        now = draft.all_judged(samples)
        # Any push suits an SU before a slide, none at all as well.
        found = [
            Place(p.draft, p.gain - unfelt_pushes(p.draft, samples))
            for d in left
            for p in places(draft, samples, d, now, left, sliding)
        ]
        if not found:
            break
        found.sort(key=lambda p: -p.gain)
        best = found[0]
        added = {j.dof for j in best.draft.joints}
        others = [
            p.draft
            for p in found[1:]
            if p.gain > best.gain - CERTAIN and {j.dof for j in p.draft.joints} == added
        ]
        draft = best.draft
        left = [d for d in left if d not in added]
    return _with_all_that_they_move(draft, samples, unplaced), tuple(others)


def in_best_order(draft: Draft, samples: Along) -> tuple[Draft, tuple[Draft, ...]]:
    """The draft with neighbours without an SU in between in the order that moves show.

    Gravity orders no joints with parallel axes, nor two of which each moved while the other stayed
    in one place only.

    Returns:
        The draft, and others that the log does not tell from it.
    """
    for _ in range(len(draft.joints)):
        others: list[Draft] = []
        better: Draft | None = None
        for joint in _bare(draft):
            swapped = draft.swapped(joint, samples)
            sus = draft.beyond(joint)
            gain = sum(
                gained(draft.judged(samples, u), swapped.judged(samples, u)).sum() for u in sus
            )
            if gain > CERTAIN:
                better = swapped
                break
            if gain > -CERTAIN:
                others.append(swapped)
        if better is None:
            return draft, tuple(others)
        draft = better
    return draft, ()


def that_slide(draft: Draft, samples: Along) -> tuple[int, ...]:
    """Joints that a draft has as turning, although moves show that they slide.

    Gravity tells of no sliding joint, and the push of one may pass for the swing about an axis far
    away: a push by one vector of length 1, which predicts more in every SU beyond, is none.

    Args:
        draft: a tree.
        samples: the logs.

    Returns:
        What each of them is among the joints of the logs.
    """
    return tuple(dof for dof, moved in _likelier_as_slides(draft, samples) if moved.holds)


def that_may_slide(draft: Draft, samples: Along) -> tuple[int, ...]:
    """Joints of a draft whose readings a push predicts for certain, if not one of length 1.

    Where directions have been bent so that a joint might turn what it pushes, no push is right.

    Args:
        draft: a tree.
        samples: the logs.

    Returns:
        What each of them is among the joints of the logs.
    """
    return tuple(dof for dof, moved in _likelier_as_slides(draft, samples) if not moved.holds)


def _likelier_as_slides(draft: Draft, samples: Along) -> Iterator[tuple[int, _Moved]]:
    """Joints that a draft has as turning and that explain more as sliding ones, and how much."""
    now = [draft.judged(samples, u) if j >= 0 else None for u, j in enumerate(draft.su_joint)]
    for j, joint in enumerate(draft.joints):
        if joint.kind == "prismatic":
            continue
        moved = _moved(
            draft, draft.sliding(j), samples, draft.beyond(j), "prismatic", draft.parent[j], now,
            CERTAIN,
        )  # fmt: skip
        if moved is not None and moved.gain > CERTAIN:
            yield joint.dof, moved


def _bare(draft: Draft) -> Iterator[int]:
    """Joints that turn behind one that turns, with nothing else in between."""
    for j in bare_neighbours(draft.parent, draft.su_joint):
        if "prismatic" not in (draft.joints[draft.parent[j]].kind, draft.joints[j].kind):
            yield j


def places(
    draft: Draft, samples: Along, dof: int, now: Sequence[Judged | None], left: Sequence[int],
    sliding: Sequence[int],
) -> Iterator[Place]:  # fmt: skip
    """Everywhere that a joint may be, if that is worth its parameters.

    Args:
        draft: a tree without it.
        samples: the logs.
        dof: the joint.
        now: what the tree is worth to each SU.
        left: all joints that have no place yet, this one among them.
        sliding: those of them that are known to slide.
    """
    price = price_of(samples, len(left), len(draft.joints) + 1)
    others = [d for d in left if d != dof]
    for at in range(-1, len(draft.joints)):
        kinds = [ChainJoint(dof, "prismatic", (0.0, 0.0, 1.0))]
        if not draft.faces_one_way(at) and dof not in sliding:
            kinds += [ChainJoint(dof, "revolute", (0.0, 0.0, s)) for s in (1.0, -1.0)]
        for joint in kinds:
            place = _placed(draft, samples, joint, at, now, others, price)
            if place is not None:
                yield place


def _placed(
    draft: Draft, samples: Along, joint: ChainJoint, at: int, now: Sequence[Judged | None],
    others: Sequence[int], price: float,
) -> Place | None:  # fmt: skip
    """A joint at one place, before those branches and SUs that gain by it.

    What an SU gains by one of two joints that it lacks is spoilt by the other. So where the gain is
    not the same in all stretches, the others that have no place yet may push it as well.
    """
    carried: list[tuple[list[int], list[int], _Moved]] = []
    for own, members in _on_the_way(draft, at):
        single = [] if own else members
        there, place, behind = draft.brought(at, own)
        trial = there.with_joint(joint, place, behind, single)
        moved = _moved(there, trial, samples, members, joint.kind, place, now, price)
        if moved is None:
            continue
        if moved.gain > price and not moved.holds and others and joint.kind == "prismatic":
            beside = there.pushed(others, place, behind, single)
            trial = beside.with_joint(joint, place, [place + 1], [])
            pushed = [beside.judged(samples, u) if u in members else None for u in range(len(now))]
            moved = _moved(beside, trial, samples, members, joint.kind, place, pushed, price)
        if moved is None or not moved.holds:
            continue
        carried.append((own, single, moved))
    if not carried:
        return None
    if joint.kind == "prismatic":
        push = min((moved for *_, moved in carried), key=lambda moved: moved.push_sd).push
        joint = joint.turned_to(push / np.linalg.norm(push))
        if draft.faces_one_way(at):
            carried = [each for each in carried if each[-1].is_pushed_by(joint)]
    children = [child for own, _, _ in carried for child in own]
    sus = [su for _, single, _ in carried for su in single]
    there, place, behind = draft.brought(at, children)
    gain = sum(moved.gain for *_, moved in carried)
    return Place(there.with_joint(joint, place, behind, sus), gain - price)


def _on_the_way(draft: Draft, at: int) -> Iterator[tuple[list[int], list[int]]]:
    """What a joint behind a segment may move: what sits there, or before hidden joints up to it.

    What sits beyond two joints that gravity does not show may be explained by neither alone, and
    is then left before the one that is found first.
    """
    before, path = at, set(draft.path(at))
    while True:
        yield from (each for each in groups(draft, before) if path.isdisjoint(each[0]))
        if before < 0 or not draft.joints[before].is_hidden:
            return
        before = draft.parent[before]


@dataclass(frozen=True, eq=False)
class _Moved:
    """What it is worth that a joint moves a branch or an SU, and how a sliding one pushes it.

    Attributes:
        holds: whether all that is known of them agrees that it does.
        gain: log-likelihood.
        push: (3,) of a sliding joint.
        push_sd: its standard deviation.
    """

    holds: bool
    gain: float
    push: F64
    push_sd: float

    def is_pushed_by(self, joint: ChainJoint) -> bool:
        """Whether a joint of known axis may be what moves it.

        Fingers that close on each other slide alike, each its own way.
        """
        return joint.kind != "prismatic" or bool(self.push @ np.array(joint.axis) > HALF_A_PUSH)


def _moved(
    draft: Draft,
    trial: Draft,
    samples: Along,
    members: Sequence[int],
    kind: JointType,
    at: int,
    now: Sequence[Judged | None],
    price: float,
) -> _Moved | None:
    """What it is worth that a trial puts a joint before SUs, behind segment ``at``.

    None where these have no readings.
    """
    pairs = [(a, trial.judged(samples, u)) for u in members if (a := now[u]) is not None]
    if not pairs:
        return None
    each = np.array([gained(a, b) for a, b in pairs])
    gains = each.sum(axis=0)
    gain = float(gains.sum())
    # What moves a branch moves every SU on it.
    holds = is_gained_throughout(gains, price) and bool(each.sum(axis=1).min() >= -CERTAIN)
    if kind == "revolute":
        own = trial.path(int(trial.su_joint[members[0]]))
        shaken = len(pairs) == 1 and is_shaken(*pairs[0]) and len(own) == len(draft.path(at)) + 1
        return _Moved(holds and not shaken, gain, np.zeros(3), 0.0)
    # It comes after the sliding joints on the way to it.
    index = sum(draft.joints[j].kind == "prismatic" for j in draft.path(at))
    push = np.array([b.slide[index] for _, b in pairs])
    sd = np.array([b.slide_sd[index] for _, b in pairs])
    holds &= is_push(push, sd)
    best = int(np.argmin(sd))
    return _Moved(holds, gain, push[best], float(sd[best]))


def _with_all_that_they_move(draft: Draft, samples: Along, dofs: Sequence[int]) -> Draft:
    """The draft with branches and SUs beyond joints put in, where all joints known show it."""
    price = price_of(samples, 1, 1)
    while True:
        for j, joint in enumerate(draft.joints):
            if joint.dof not in dofs:
                continue
            for own, members in groups(draft, draft.parent[j]):
                if own == [j]:
                    continue
                trial = draft.gathered(j, own, [] if own else members)
                now = [
                    draft.judged(samples, u) if u in members else None
                    for u in range(len(draft.su_joint))
                ]
                at = draft.parent[j]
                moved = _moved(draft, trial, samples, members, joint.kind, at, now, price)
                if moved is None or not moved.holds:
                    continue
                if not draft.faces_one_way(at) or moved.is_pushed_by(joint):
                    draft = trial
                    break
            else:
                continue
            break
        else:
            return draft
