"""A tree in the making, and what accelerations add to what gravity shows of it.

Gravity never shows joints whose axis is vertical, nor sliding ones. It does not show in which order
joints follow each other where no SU sits in between either, if their axes are parallel, or if each
moved at one position of the other only. Where a joint is put in, the accelerations of the moves fit
or do not: every place is tried, and what is beyond it is decided for every branch and SU by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.structure.accelerations import Along, ChainJoint, Judged
from skin2urdf.structure.joint_types import HALF_A_PUSH
from skin2urdf.structure.ordering import bare_neighbours
from skin2urdf.structure.records import JointType

CERTAIN = 10.0
"""Difference of log-likelihoods beyond which one of two structures is certain: 20,000 to 1."""
CONSISTENT = 4.0
"""Standard deviations by which the gain of a joint stands out from what chance gains and loses from
one stretch of time to the next, and the push of a sliding one from none: errors that are alike for
a while count once."""
QUIET = 1e-3
"""Noise [m/s^2] of low-passed samples below which no error matters: a tenth of a mg."""
_QUIET_RATE = 1e-3
"""The same of rates [rad/s]: what an encoder's steps make of a velocity."""
_PUSH = 0.1
"""Deviation of a sliding joint's push from unit length that scale and errors of fit may cause."""
_NEAREST = 0.005
"""Lever arm [m] of an SU below which it is shaken rather than turned by a vertical axis: half of
the width of a sensor's case."""


@dataclass(frozen=True, eq=False)
class Draft(Record):
    """Joints, and SUs on them.

    Attributes:
        joints: what each joint is; parents come before their children.
        parent: index of the joint before each; -1 for the RS.
        su_joint: (U,) joint that each SU sits on; -1 for the RS, -2 for SUs without readings.
        R: (U, 3, 3) orientation of each SU at position zero, in the base frame.
        sensor: (U, 9) bias and shape.
        up: (G, 3) unit vectors opposite to gravity, per log.
    """

    joints: tuple[ChainJoint, ...]
    parent: tuple[int, ...]
    su_joint: Int
    R: F64
    sensor: F64
    up: F64

    def path(self, joint: int) -> tuple[int, ...]:
        """Indices of the joints from the RS to the given one."""
        out: list[int] = []
        while joint >= 0:
            out.append(joint)
            joint = self.parent[joint]
        return tuple(reversed(out))

    def judged(self, samples: Along, su: int) -> Judged:
        """How well the chain of an SU predicts what it feels."""
        chain = tuple(self.joints[j] for j in self.path(int(self.su_joint[su])))
        return samples.judge(su, chain, self.R[su], self.sensor[su], self.up)

    def all_judged(self, samples: Along) -> list[Judged | None]:
        """The same of all SUs; None of those without readings."""
        return [self.judged(samples, u) if j >= -1 else None for u, j in enumerate(self.su_joint)]

    def beyond(self, joint: int) -> list[int]:
        """SUs that a joint moves."""
        return [u for u, j in enumerate(self.su_joint) if joint in self.path(int(j))]

    def faces_one_way(self, joint: int) -> bool:
        """Whether gravity tells how all that a joint (-1: the RS) carries is turned to each other.

        What only upright joints and slides carry may be turned about the vertical, each by itself.
        """
        return not all(self.joints[j].is_upright for j in self.path(joint))

    def with_joint(
        self, new: ChainJoint, at: int, children: Sequence[int], sus: Sequence[int]
    ) -> Draft:
        """With a joint put in behind another one, before some of its children and SUs.

        Args:
            new: the joint.
            at: the joint that it follows; -1 for the RS.
            children: joints that follow it.
            sus: SUs that sit on it.
        """
        place = at + 1
        moved = [j if j < place else j + 1 for j in range(len(self.joints))]

        def renamed(j: int) -> int:
            return moved[j] if j >= 0 else j

        parent = [renamed(p) for p in self.parent]
        for c in children:
            parent[c] = place
        parent.insert(place, at)
        joints = list(self.joints)
        joints.insert(place, new)
        su_joint = np.array([renamed(int(j)) for j in self.su_joint])
        su_joint[list(sus)] = place
        return replace(self, joints=tuple(joints), parent=tuple(parent), su_joint=su_joint)

    def pushed(
        self, dofs: Sequence[int], at: int, children: Sequence[int], sus: Sequence[int]
    ) -> Draft:
        """With sliding joints of any direction put in behind a joint, before some of what follows.

        Args:
            dofs: the joints that slide.
            at: the joint that they follow, as ``at + 1`` and those after it; -1 for the RS.
            children: joints that follow them.
            sus: SUs that sit on the last of them.
        """
        out, own = self, (list(children), list(sus))
        for dof in dofs:
            out = out.with_joint(ChainJoint(dof, "prismatic", (0.0, 0.0, 1.0)), at, *own)
            own = [at + 1], []
        return out

    def gathered(self, joint: int, children: Sequence[int], sus: Sequence[int]) -> Draft:
        """With branches and SUs that sat beside a joint beyond it.

        Args:
            joint: the joint.
            children: joints that follow it from here on, and
            sus: SUs that sit on it.
        """
        parent = list(self.parent)
        for c in children:
            parent[c] = joint
        su_joint = np.array(self.su_joint)
        su_joint[list(sus)] = joint
        shuffled = replace(self, parent=tuple(parent), su_joint=su_joint)
        order = sorted(range(len(parent)), key=lambda j: len(shuffled.path(j)))
        place = {j: i for i, j in enumerate(order)} | {-1: -1, -2: -2}
        return replace(
            self,
            joints=tuple(self.joints[j] for j in order),
            parent=tuple(place[parent[j]] for j in order),
            su_joint=np.array([place[int(j)] for j in su_joint]),
        )

    def brought(self, at: int, children: Sequence[int]) -> tuple[Draft, int, list[int]]:
        """With branches on a segment, wherever they began before.

        Args:
            at: the joint that moves the segment; -1 for the RS.
            children: the branches' first joints.

        Returns:
            The draft, and what the segment and the branches' first joints are in it.
        """
        if all(self.parent[c] == at for c in children):
            return self, at, list(children)
        out = self.gathered(at, children, [])
        place = {joint.dof: j for j, joint in enumerate(out.joints)}
        return out, place[self.joints[at].dof], [place[self.joints[c].dof] for c in children]

    def without_joint(self, joint: int) -> Draft:
        """Without a joint: what it carries is carried by the one before it."""
        before = self.parent[joint]

        def renamed(j: int) -> int:
            j = before if j == joint else j
            return j - 1 if j > joint else j

        return replace(
            self,
            joints=self.joints[:joint] + self.joints[joint + 1 :],
            parent=tuple(renamed(p) for j, p in enumerate(self.parent) if j != joint),
            su_joint=np.array([renamed(int(j)) for j in self.su_joint]),
        )

    def sliding(self, joint: int) -> Draft:
        """With a joint that slides, in any direction, instead of turning."""
        joints = list(self.joints)
        joints[joint] = replace(joints[joint], kind="prismatic")
        return replace(self, joints=tuple(joints))

    def turned(self, children: Sequence[int], sus: Sequence[int], R: F64) -> Draft:
        """With branches and SUs turned in the base frame.

        Args:
            children: the branches' first joints.
            sus: SUs of these branches, and others.
            R: (3, 3) the turn.
        """
        joints = list(self.joints)
        for j, joint in enumerate(joints):
            if not set(children).isdisjoint(self.path(j)):
                joints[j] = joint.turned_to(R @ joint.axis)
        turned = self.R.copy()
        turned[list(sus)] = R @ turned[list(sus)]
        return replace(self, joints=tuple(joints), R=turned)

    def swapped(self, joint: int, samples: Along) -> Draft:
        """With a joint and the one before it in the other order.

        Where each of the two moved while the other stayed in one place only, both orders move all
        that lies beyond alike, about axes that are turned by where the other one stayed.
        """
        before = self.parent[joint]
        outer, inner = self.joints[joint], self.joints[before]
        # With a before b, a at c while b turns, and b at d while a does: Rot(a, x) Rot(b, y) is
        # Rot(b', y) Rot(a', x) R0 along both ways.
        c, d = samples.stays(inner.dof, outer.dof), samples.stays(outer.dof, inner.dof)
        first = rotation_exp(c * np.array(inner.axis)) @ outer.axis
        back = rotation_exp(-d * first)
        children = [k for k, p in enumerate(self.parent) if p == joint]
        R0 = back @ rotation_exp(d * np.array(outer.axis))
        beyond = self.turned(children, self.beyond(joint), R0)
        joints = list(beyond.joints)
        joints[before], joints[joint] = outer.turned_to(first), inner.turned_to(back @ inner.axis)
        return replace(beyond, joints=tuple(joints))


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


def gained(now: Judged, then: Judged) -> F64:
    """(B,) log-likelihood that another chain gains in each stretch, whatever its noise is."""
    return _log_ratio(now.loss, then.loss, now.count, QUIET) + _gain_in_turning(now, then)


def _gain_in_turning(now: Judged, then: Judged) -> F64:
    """(B,) the part of it that a gyroscope tells; 0 where there is none."""
    return _log_ratio(now.turn_loss, then.turn_loss, now.turn_count, _QUIET_RATE)


def is_shaken(now: Judged, then: Judged) -> bool:
    """Whether a vertical axis before an SU shakes it rather than that it turns it.

    A gyroscope tells: one that reads no turning has no such error of its axes as would hide it.
    """
    if then.turn_count.any():
        return then.turn_left > now.turn_left
    return then.lever < _NEAREST


def is_push(push: F64, sd: F64) -> bool:
    """Whether most SUs feel a sliding joint as one that carries them, by (n, 3) and (n,)."""
    size = np.linalg.norm(push, axis=1)
    # SUs beyond a joint that is not known yet say something else; and a push has to be seen.
    as_one = bool(np.median(np.abs(size - 1) - 4 * sd) <= _PUSH)
    return as_one and bool(np.median(size - CONSISTENT * sd) > 0)


def _log_ratio(now: F64, then: F64, count: F64, quiet: float) -> F64:
    """Log-likelihood gained by a smaller sum of squares over so many measurements."""
    floor = quiet**2 * count + 1e-12
    return np.asarray(count / 2 * np.log((now + floor) / (then + floor)))


def unfelt_pushes(draft: Draft, samples: Along) -> float:
    """Negative log-likelihood of pushes of half a slide's length where SUs feel less.

    Each SU finds a push of its own, of length 1 where a slide carries it. One that sits before the
    slide finds next to none, and is predicted the better for it: what the slide's weight does to
    elastic gears before them both goes with its acceleration as well.
    """
    total = 0.0
    for judged in draft.all_judged(samples):
        if judged is not None:
            lacking = np.maximum(HALF_A_PUSH - np.linalg.norm(judged.slide, axis=1), 0.0)
            total += 0.5 * float((lacking**2 / judged.slide_sd**2).sum())
    return total


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


def groups(draft: Draft, at: int) -> Iterator[tuple[list[int], list[int]]]:
    """What sits on a segment (-1: the RS): branches, as first joint and SUs, and single SUs."""
    for c, p in enumerate(draft.parent):
        if p == at:
            yield [c], draft.beyond(c)
    for u, j in enumerate(draft.su_joint):
        if j == at:
            yield [], [u]


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


def is_gained_throughout(gains: F64, price: float) -> bool:
    """Whether log-likelihoods (B,) that stretches gain are more than chance, and one odd moment.

    Of what is explained by chance as much is lost elsewhere.

    Args:
        gains: (B,) of each stretch.
        price: what has to be gained beside the one that gains most.
    """
    gain = float(gains.sum())
    chance = float(np.sqrt(2 * (np.minimum(gains, 0.0) ** 2).sum()))
    elsewhere = gain - float(gains.max(initial=0.0))
    return gain >= CONSISTENT * chance and elsewhere >= price


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


def price_of(samples: Along, joints: int, segments: int) -> float:
    """What a joint has to gain to be put in.

    Half the logarithm of the samples for each parameter, and that of the places tried.
    """
    return 3 * float(np.log(max(len(samples.q), 2))) + float(np.log(3 * joints * segments))
