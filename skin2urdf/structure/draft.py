"""A tree in the making: joints, SUs on them, and how both are changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.geometry.so3 import rotation_exp
from skin2urdf.structure.accelerations import Along, ChainJoint, Judged


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


def groups(draft: Draft, at: int) -> Iterator[tuple[list[int], list[int]]]:
    """What sits on a segment (-1: the RS): branches, as first joint and SUs, and single SUs."""
    for c, p in enumerate(draft.parent):
        if p == at:
            yield [c], draft.beyond(c)
    for u, j in enumerate(draft.su_joint):
        if j == at:
            yield [], [u]
