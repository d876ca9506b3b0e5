"""Between encoder and link: gears that are elastic, uneven or have play, couplings that slip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.recording.records import JointStream
from skin2urdf.simulation.defects.records import Defect, Flexibility, Ripple
from skin2urdf.simulation.mechanism import Mechanism

LEVER = 0.1
"""Lever at which a spindle is as stiff as a gear [m]."""


@dataclass(frozen=True)
class ElasticGears(Defect):
    """Encoders on the motors, and gears that twist under the load.

    Attributes:
        near: stiffness of the gears in the first half of every chain [N m/rad].
        far: the same in the second half [N m/rad].
        damping: damping ratio, with the inertia that a gear carries.
    """

    near: float = 14_000.0
    far: float = 7_000.0
    damping: float = 0.05

    def stiffness(self, mechanism: Mechanism) -> F64:
        """(D,) of every gear [N m/rad or N/m]."""
        k = np.where(_in_far_half(mechanism), self.far, self.near)
        return np.where(mechanism.prismatic, k / LEVER**2, k)

    def loosen(
        self, flexibility: Flexibility, mechanism: Mechanism, rng: np.random.Generator
    ) -> Flexibility:
        """Gears as springs."""
        damping = np.maximum(flexibility.damping, self.damping)
        return replace(flexibility, stiffness=self.stiffness(mechanism), damping=damping)


@dataclass(frozen=True)
class Backlash(Defect):
    """Gears with play: the link lies on one side of the gap, and falls to the other by its load.

    Attributes:
        width: of the gap [rad].
        stiffness: of the teeth where the gear is not elastic by itself [N m/rad].
        damping: damping ratio of the teeth and of the grease in the gap.
    """

    width: float = 1e-3
    stiffness: float = 1e6
    damping: float = 0.1

    def loosen(
        self, flexibility: Flexibility, mechanism: Mechanism, rng: np.random.Generator
    ) -> Flexibility:
        """A gap in every gear."""
        teeth = np.where(mechanism.prismatic, self.stiffness / LEVER**2, self.stiffness)
        gap = np.where(mechanism.prismatic, self.width * LEVER, self.width)
        return replace(
            flexibility,
            stiffness=np.minimum(flexibility.stiffness, teeth),
            damping=np.maximum(flexibility.damping, self.damping),
            play=flexibility.play + gap,
        )


@dataclass(frozen=True)
class GearHarmonics(Defect):
    """Gears whose output is ahead and behind by turns.

    Attributes:
        once: amplitude once per turn of the joint (a wheel out of centre) [rad].
        twice: amplitude twice per turn of the joint (a wheel out of round) [rad].
        motor: amplitude twice per turn of the motor (the wave of a strain wave gear) [rad].
        reduction: turns of the motor in one of the joint.
        between: amplitude once per turn of a wheel between these, as planets and the cranks of
            cycloids are [rad].
        stage: turns of that wheel in one of the joint, which need not be a whole number.
    """

    once: float = 1.5 / 60 * pi / 180
    twice: float = 0.75 / 60 * pi / 180
    motor: float = 0.0
    reduction: float = 100.0
    between: float = 0.0
    stage: float = 5.3

    def loosen(
        self, flexibility: Flexibility, mechanism: Mechanism, rng: np.random.Generator
    ) -> Flexibility:
        """Ripples of random phase in the gears of all joints that turn."""
        sizes = (
            (1.0, self.once),
            (2.0, self.twice),
            (2.0 * self.reduction, self.motor),
            (self.stage, self.between),
        )
        phases = rng.uniform(0.0, 2 * pi, (mechanism.n_joints, len(sizes)))
        ripples = tuple(
            Ripple(d, per_turn, size, float(phases[d, i]))
            for d in range(mechanism.n_joints)
            if not mechanism.prismatic[d]
            for i, (per_turn, size) in enumerate(sizes)
            if size
        )
        return replace(flexibility, ripples=(*flexibility.ripples, *ripples))


@dataclass(frozen=True)
class SlippingCoupling(Defect):
    """A coupling or belt of one joint that slips a little with every move, always the same way.

    Attributes:
        part: by how much farther off the joint's encoder is, per way that it has gone.
    """

    part: float = 2e-4

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """One joint's positions, off in proportion to how far it has moved until then."""
        which, sign = int(rng.integers(len(joints))), rng.choice([-1.0, 1.0])
        slips = joints[which]
        moved = np.cumsum(np.abs(np.diff(slips.position, prepend=slips.position[0])))
        position = slips.position + sign * self.part * moved
        return (*joints[:which], replace(slips, position=position), *joints[which + 1 :])


def _in_far_half(mechanism: Mechanism) -> F64:
    """(D,) whether a joint lies in the second half of the longest chain through it."""
    above = np.zeros(mechanism.n_joints, dtype=np.int64)
    for d, parent in enumerate(mechanism.parent):
        above[d] = above[parent] + 1 if parent >= 0 else 0
    below = np.zeros_like(above)
    for d in reversed(range(mechanism.n_joints)):
        if (parent := mechanism.parent[d]) >= 0:
            below[parent] = max(below[parent], below[d] + 1)
    return np.asarray(above > below)
