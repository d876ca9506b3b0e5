"""Joints of a specimen that are off by more than is common: their zeros, or where they sit.

As few of them as explain the readings; what is common stays allowed for in all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.state import JOINT_COORDINATES
from skin2urdf.estimation.trajectory.arrow import eliminated, joint_inverse
from skin2urdf.estimation.trajectory.blueprint import ALONG_AXIS, N_MOUNT
from skin2urdf.vendor.explained import Explained, placed_again

_ANY_ZERO = 1.0
"""Standard deviation of a zero that may be anywhere [rad or m]."""
_USUAL = 4.0
"""Deviation of a zero, in standard deviations of what is common, from which it is another zero."""
FEW = 3
"""Joints with another zero or sense that are looked for at most."""
_ENDED = 0.1
"""Length of a fit's last step in standard deviations: so far from its optimum it may end."""
_TIMES = 3
"""Fits, one from the other, by which a placement is followed that is far off."""
_ARRIVED = 0.9
"""Part of what was left before, from which a fit that does not explain the readings has arrived."""
LOOKED_AT = 3
"""Changes that are followed by a whole fit: rough fits may leave less on a wrong one."""


class Off(NamedTuple):
    """Joints that are off by more than is common.

    Attributes:
        found: the readings explained with that.
        joint: the one that sits elsewhere; None where it is zeros that are off.
    """

    found: Explained
    joint: int | None = None


def strange(specimen: Explained) -> bool:
    """Whether a zero or a placement is off by more than is common."""
    return bool(_all_pulls(specimen).max(initial=0.0) > _USUAL)


def other_zeros(specimen: Explained) -> Explained:
    """The zeros that are off by more than is common, as few of them as explain the readings.

    The joint whose zero is pulled farthest from what is common comes first; the next one follows
    where that alone does not do.
    """
    found, wide = specimen, list[int]()
    while len(wide) < FEW:
        pulls = _pulls(found)
        pulls[wide] = 0.0
        if not pulls.max(initial=0.0) > _USUAL:
            break
        wide.append(int(pulls.argmax()))
        found = with_zeros(specimen, wide, found)
        if found.fits and not strange(found):
            break
    return found


def placed_otherwise(specimen: Explained) -> Off | None:
    """The joint whose placement explains the readings where it may be any; None where none does.

    Joints whose placements are pulled farthest from what is common are tried.
    """
    pulls = _all_pulls(specimen).max(axis=1)
    sensors = specimen.bench.settings.estimation.priors
    for j in np.argsort(-pulls)[:LOOKED_AT]:
        if not pulls[j] > _USUAL:
            break
        deviations = np.array(specimen.blueprint.deviations)
        deviations[j] = _ANY_ZERO
        blueprint = replace(specimen.blueprint, deviations=deviations)
        found = replace(specimen, blueprint=blueprint)
        for _ in range(_TIMES):
            # Sensors take up what placements have to on the way, and hold them back.
            begin = found.along.state
            fresh = np.zeros_like(begin.bias), np.zeros_like(begin.shape)
            begin = replace(begin, bias=fresh[0], shape=fresh[1])
            along = found.bench.fit(found.placed, blueprint, sensors, begin)
            before, found = found, placed_again(replace(found, along=along))
            if not found.fits and found.left.mean > _ARRIVED * before.left.mean:
                break
            others = np.delete(_all_pulls(found), j, axis=0)
            # What others had taken up they give back last, by what is common alone.
            if found.fits and not others.max(initial=0.0) > _USUAL:
                return Off(found, int(j))
    return None


def with_zeros(specimen: Explained, joints: Sequence[int], start: Explained) -> Explained:
    """The fit with the zeros of some joints anywhere."""
    deviations = np.array(specimen.blueprint.deviations)
    rows, at = _at(specimen)
    chosen = list(joints)
    deviations[chosen, at[chosen]] = _ANY_ZERO
    blueprint = replace(specimen.blueprint, deviations=deviations)
    sensors = specimen.bench.settings.estimation.priors
    along = start.bench.fit(start.placed, blueprint, sensors, start.along.state)
    xi = blueprint.corrections(along.state)[rows, at]
    names = [joint.name for joint in specimen.bench.chassis.joints]
    offsets = {names[j]: float(xi[j]) for j in chosen}
    return replace(specimen, placed=start.placed, blueprint=blueprint, along=along, offsets=offsets)


def _all_pulls(found: Explained) -> F64:
    """(D, 6) deviations of the joints' placements, over what specimens would show of them.

    Of a deviation with variance s^2 that readings tell to a variance C, an estimate that knows s
    keeps s^2 - C: what the zeros of parallel axes share shows in neither, and half of it in each is
    more than chance. Where readings say nothing, that a fit ends near its optimum counts.
    """
    along, sd = found.along, found.blueprint.deviations
    problem, layout = along.problem, along.problem.layout
    system = eliminated(along.fitted.equations, problem.free_joint, problem.free_su)
    left = np.diag(joint_inverse(system.schur, problem.free_joint))
    C = np.zeros_like(sd)
    C[:, JOINT_COORDINATES] = left[layout.joints].reshape(-1, len(JOINT_COORDINATES))
    C[:, ALONG_AXIS] = left[layout.further][N_MOUNT:].reshape(-1, len(ALONG_AXIS))
    variance = np.maximum(sd**2 - C, 0.0) + _ENDED**2 * C
    xi = found.blueprint.corrections(along.state)
    out = np.zeros_like(xi)
    np.divide(np.abs(xi), np.sqrt(variance), out=out, where=sd > 0)
    return out


def _pulls(found: Explained) -> F64:
    """(D,) deviations of the joints' zeros in standard deviations of what is common."""
    return np.asarray(_all_pulls(found)[_at(found)])


def _at(found: Explained) -> tuple[Int, Int]:
    """(D,) rows and coordinates of the joints' zeros."""
    at = np.where(found.along.problem.tree.prismatic, 2, 5)
    return np.arange(len(at)), at
