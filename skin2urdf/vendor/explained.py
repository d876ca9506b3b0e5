"""Readings explained on a model: what was found, and how well it explains them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.estimation.trajectory.blueprint import Blueprint
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.uncertainty.plausible import are_plausible
from skin2urdf.vendor.fitting import Bench
from skin2urdf.vendor.leftover import Leftover, leftover
from skin2urdf.vendor.placing import Placed, placed_from

GROSS = 0.1
"""Rms of an SU's slow residuals that no robot with this model leaves [m/s^2]: ten times that of
gears that yield by a milliradian; real arms leave 0.02 to 0.03 with their maker's kinematics, and
a joint that counts the other way 0.1 to 2."""
_MOST_OF_IT = 0.2
"""Part of what is left, above the 1 of noise, that may stay where its cause was found: others, such
as gears that yield, stay beside it."""


@dataclass(frozen=True, eq=False)
class Explained:
    """Readings explained on a model.

    Attributes:
        bench: the logs, without SUs that do not fit.
        placed: where the SUs sit.
        blueprint: what was known of the model.
        along: the fit.
        offsets: joints with another zero, and by how much [rad or m].
        odd: SUs that fit nowhere, with what they leave.
    """

    bench: Bench
    placed: Placed
    blueprint: Blueprint
    along: MotionEstimate
    offsets: dict[str, float]
    odd: dict[str, float]

    @cached_property
    def left(self) -> Leftover:
        """What is left of the readings."""
        return leftover(self.along)

    @property
    def possible(self) -> Bool:
        """(U,) whether each sensor would have errors as working ones have.

        One with an axis the other way round lets a mirrored robot explain readings.
        """
        return are_plausible(self.along.state)

    @property
    def fits(self) -> bool:
        """Whether the model explains the readings of all SUs, with sensors that can be."""
        small = self.left.mean <= GOOD_FIT and self.left.largest <= 2 * GOOD_FIT
        return bool(small and self.possible.all())

    def settles(self, other: Explained) -> bool:
        """Whether this is the cause of what another explanation leaves."""
        if self.fits or not self.possible.all() or not np.nanmax(self.left.rms) <= GROSS:
            return self.fits
        pairs = ((self.left.mean, other.left.mean), (self.left.largest, other.left.largest))
        return all(here - 1 < _MOST_OF_IT * (there - 1) for here, there in pairs)


def placed_again(found: Explained) -> Explained:
    """The same with SUs on the segments on which they fit best with the model as it was found.

    What a specimen deviates by may hide a joint that turns an SU about the vertical.
    """
    bench, state = found.bench, found.along.state
    shifted = replace(bench.chassis, T_parent_joint=state.T_parent_joint)
    placed = placed_from(shifted, bench.logs, state.up, bench.settings.estimation.priors)
    if (placed.su_joint == found.placed.su_joint).all():
        return found
    start = replace(placed.state(state.T_parent_joint), up=state.up)
    along = bench.fit(placed, found.blueprint, bench.settings.estimation.priors, start)
    again = replace(found, placed=placed, along=along)
    return again if again.left.mean < found.left.mean else found
