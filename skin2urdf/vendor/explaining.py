"""What of a given model the readings contradict, and what explains them then.

A model that fits is taken as it is. Where it does not, what is common is tried before what is not:
a specimen that differs by what makers state; gears that yield and biases that drift; encoders with
another zero, or that count the other way; single SUs that fit nowhere. What is left is another
robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.errors import ModelMismatchError
from skin2urdf.estimation.trajectory.blueprint import Blueprint
from skin2urdf.estimation.trajectory.estimate import MotionEstimate
from skin2urdf.geometry.se3 import screw
from skin2urdf.signals.trajectory import in_order
from skin2urdf.vendor.fitting import Bench
from skin2urdf.vendor.leftover import Leftover, leftover
from skin2urdf.vendor.placing import Placed, placed_from, roughly_left
from skin2urdf.vendor.records import Correction

GROSS = 0.1
"""Rms of an SU's slow residuals that no robot with this model leaves [m/s^2]: ten times that of
gears that yield by a milliradian; real arms leave 0.02 to 0.03 with their maker's kinematics, and
a joint that counts the other way 0.1 to 2."""
_YIELDING = 0.5
"""The same with gears that yield, under loads that are known [m/s^2]: those of 5 mrad per hundred
newton metres leave 0.08 on an arm of 18 kg, and no gear yields by more than a few times that."""
_ANY_ZERO = 1.0
"""Standard deviation of a zero that may be anywhere [rad or m]."""
_USUAL = 4.0
"""Deviation of a zero, in standard deviations of what is common, from which it is another zero."""
_MOST_OF_IT = 0.2
"""Part of what is left, above the 1 of noise, that may stay where its cause was found: others, such
as gears that yield, stay beside it."""
_FAR = 8.0
"""What an SU leaves over what the median SU does, from which it is the SU that does not fit."""
_FEW = 3
"""Joints with another zero or sense that are looked for at most."""
_ZEROS = np.deg2rad([-150, -120, -90, -60, -30, 30, 60, 90, 120, 150, 180])
"""Zeros that are tried [rad]; from a sixth of a turn away the fit finds the right one."""
_FLOOR = 0.005**2
"""Mean square below which it does not matter how little a rough fit leaves [m^2/s^4]."""
_TIMES = 3
"""Fits, one from the other, by which a placement is followed that is far off."""
_LOOKED_AT = 3
"""Changes that are followed by a whole fit: rough fits may leave less on a wrong one."""
_GAIN = 0.3
"""Drop of the mean logarithm of what rough fits leave that is worth a closer look."""


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
    def fits(self) -> bool:
        """Whether the model explains the readings of all SUs."""
        return self.left.mean <= GOOD_FIT and self.left.largest <= 2 * GOOD_FIT

    def settles(self, other: Explained) -> bool:
        """Whether this is the cause of what another explanation leaves."""
        if self.fits or not np.nanmax(self.left.rms) <= GROSS:
            return self.fits
        pairs = ((self.left.mean, other.left.mean), (self.left.largest, other.left.largest))
        return all(here - 1 < _MOST_OF_IT * (there - 1) for here, there in pairs)


class _Change(NamedTuple):
    """Another zero of a joint, or (None) its other sense."""

    joint: int
    zero: float | None


def explain(
    bench: Bench,
    placed: Placed,
    correction: Correction,
    tell: Callable[[float], None] = lambda _: None,
) -> Explained:
    """Fit all samples on a model, and find what is wrong with it where it does not explain them.

    Args:
        bench: the model and the logs.
        placed: where the SUs sit.
        correction: what may be corrected.
        tell: told the share of the work that is done.

    Raises:
        ModelMismatchError: the model is not the robot in the logs, or differs by what was not to
            be corrected.
    """
    sensors = bench.settings.estimation.priors
    asked = bench.blueprint(correction, placed.up[0])
    found = Explained(bench, placed, asked, bench.fit(placed, asked, sensors, tell=tell), {}, {})
    if not found.fits and correction.what != "none":
        found = _placed_again(found)
    if not found.fits or (correction.what != "none" and _strange(found)):
        found = _cause(found, correction)
    found = _with_doubts(found)
    learnt = found.bench.learnt(found.along, sensors)
    if learnt == sensors:
        return found
    again = found.bench.fit(
        found.placed, found.blueprint, learnt, found.along.state, look_further=_looked(found.along)
    )
    return replace(found, along=again)


def _looked(along: MotionEstimate) -> bool:
    """Whether a fit has elastic joints or drifting biases."""
    return along.problem.unseen is not None or any(along.problem.layout.n_knots)


def _cause(kept: Explained, correction: Correction) -> Explained:
    """What explains readings that the model as it is does not.

    Raises:
        ModelMismatchError: nothing does, or what was not to be corrected.
    """
    bench, placed, sensors = kept.bench, kept.placed, kept.bench.settings.estimation.priors
    common = bench.blueprint(replace(correction, what="all"), placed.up[0])
    # What is grossly wrong is no specimen, and would lead astray all that begins from one.
    gross = bool(np.nanmax(kept.left.rms) > GROSS)
    if gross and (found := _another_count(kept, common, kept, correction)) is not None:
        return found
    specimen = replace(
        kept, blueprint=common, along=bench.fit(placed, common, sensors, kept.along.state)
    )
    if not specimen.fits:
        specimen = _placed_again(specimen)
    if specimen.fits and not _strange(specimen):
        return specimen
    tried = [kept]
    if not _strange(specimen):
        tried.append(specimen)
    for attempt in _yielding(tried):
        tried.append(attempt)
        if attempt.fits:
            return attempt
    least = min(tried, key=lambda each: each.left.mean)
    zeros = _other_zeros(specimen)
    if zeros.offsets and zeros.settles(least):
        return _allowed(zeros, kept, correction)
    if specimen.fits and (elsewhere := _placed_otherwise(specimen)) is not None:
        return _allowed_elsewhere(*elsewhere, kept, correction)
    if not gross and (found := _another_count(kept, common, least, correction)) is not None:
        return found
    if not specimen.fits and (elsewhere := _placed_otherwise(specimen)) is not None:
        return _allowed_elsewhere(*elsewhere, kept, correction)
    if specimen.fits:
        return specimen  # many joints are off by more than is common
    tried += [found for found in map(_without_odd_sus, tried) if found is not None]
    best = min(tried, key=lambda each: each.left.mean)
    if np.nanmax(best.left.rms) > GROSS:
        raise another_robot(best)
    return best


def _another_count(
    kept: Explained, common: Blueprint, least: Explained, correction: Correction
) -> Explained | None:
    """Encoders that count the other way or from far off, where that settles what is left.

    Raises:
        ModelMismatchError: it does, and may not be corrected.
    """
    changed = _changed(kept, common)
    if changed is None or not changed[1].settles(least):
        return None
    senses, there = changed
    if senses:
        raise _another_sense(senses, there, kept)
    return _allowed(there, kept, correction)


def _yielding(tried: Sequence[Explained]) -> Iterator[Explained]:
    """The same models with what real robots have and ideal ones have not.

    Joints that yield under loads that the model knows are few numbers, and are tried where nothing
    else of this kind would leave as much.
    """
    for i, each in enumerate(list(tried)):
        most = float(np.nanmax(each.left.rms))
        any_cause = i == 0 and most <= GROSS
        if not any_cause and (each.bench.inertials is None or not most <= _YIELDING):
            continue
        sensors = each.bench.settings.estimation.priors
        along = each.bench.fit(
            each.placed, each.blueprint, sensors, each.along.state,
            look_further=True, only_known=not any_cause,
        )  # fmt: skip
        yield replace(each, along=along)


def _placed_again(found: Explained) -> Explained:
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


def _with_doubts(found: Explained) -> Explained:
    """The same with the segments that SUs may sit on as well, given the model as it was found."""
    if not any(found.placed.instead):
        return found
    state = found.along.state
    shifted = replace(found.bench.chassis, T_parent_joint=state.T_parent_joint)
    sensors = found.bench.settings.estimation.priors
    again = placed_from(shifted, found.bench.logs, state.up, sensors)
    same = again.su_joint == found.placed.su_joint
    instead = tuple(
        new if alike else old
        for new, old, alike in zip(again.instead, found.placed.instead, same, strict=True)
    )
    return replace(found, placed=replace(found.placed, instead=instead))


def _allowed_elsewhere(
    joint: int, there: Explained, kept: Explained, correction: Correction
) -> Explained:
    """A joint that sits elsewhere, where placements may be corrected.

    Raises:
        ModelMismatchError: they may not.
    """
    if correction.what != "all":
        raise _another_placement(joint, there, kept)
    return there


def _allowed(zeros: Explained, kept: Explained, correction: Correction) -> Explained:
    """Other zeros, where zeros may be corrected.

    Raises:
        ModelMismatchError: they may not.
    """
    if correction.what == "none":
        raise _another_zero(zeros, kept)
    return zeros


def _at(found: Explained) -> tuple[Int, Int]:
    """(D,) rows and coordinates of the joints' zeros."""
    at = np.where(found.along.problem.tree.prismatic, 2, 5)
    return np.arange(len(at)), at


def _pulls(found: Explained) -> F64:
    """(D,) deviations of the joints' zeros in standard deviations of what is common."""
    return np.asarray(_all_pulls(found)[_at(found)])


def _all_pulls(found: Explained) -> F64:
    """(D, 6) deviations of the joints' placements in standard deviations of what is common."""
    xi, sd = found.blueprint.corrections(found.along.state), found.blueprint.deviations
    return np.divide(np.abs(xi), sd, out=np.zeros_like(xi), where=sd > 0)


def _strange(specimen: Explained) -> bool:
    """Whether a zero or a placement is off by more than is common."""
    return bool(_all_pulls(specimen).max(initial=0.0) > _USUAL)


def _other_zeros(specimen: Explained) -> Explained:
    """The zeros that are off by more than is common, as few of them as explain the readings.

    The joint whose zero is pulled farthest from what is common comes first; the next one follows
    where that alone does not do.
    """
    found, wide = specimen, list[int]()
    while len(wide) < _FEW:
        pulls = _pulls(found)
        pulls[wide] = 0.0
        if not pulls.max(initial=0.0) > _USUAL:
            break
        wide.append(int(pulls.argmax()))
        found = _with_zeros(specimen, wide, found)
        if found.fits:
            break
    return found


def _placed_otherwise(specimen: Explained) -> tuple[int, Explained] | None:
    """The joint whose placement explains the readings where it may be any; None where none does.

    Joints whose placements are pulled farthest from what is common are tried.
    """
    pulls = _all_pulls(specimen).max(axis=1)
    sensors = specimen.bench.settings.estimation.priors
    for j in np.argsort(-pulls)[:_LOOKED_AT]:
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
            found = _placed_again(replace(found, along=along))
            if found.fits:
                break
        others = np.delete(_all_pulls(found), j, axis=0)
        if found.fits and not others.max(initial=0.0) > _USUAL:
            return int(j), found
    return None


def _with_zeros(specimen: Explained, joints: Sequence[int], start: Explained) -> Explained:
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


def _changed(kept: Explained, common: Blueprint) -> tuple[list[str], Explained] | None:
    """The model with other senses and zeros of few joints, found by what rough fits leave.

    Returns:
        Joints that count the other way, and the fit with them turned and zeros anywhere that were
        changed; None where no change is worth a look.
    """
    bench = kept.bench
    changes: list[_Change] = []
    found: Explained | None = None
    least = _rough(bench, changes)
    for _ in range(_FEW):
        known = {change.joint for change in changes}
        some = [
            _Change(j, zero)
            for j in _moved(bench)
            if j not in known
            for zero in (None, *([] if bench.chassis.joint_types[j] == "prismatic" else _ZEROS))
        ]
        if not some:
            break
        scores = [_rough(bench, [*changes, change]) for change in some]
        best = [int(i) for i in np.argsort(scores)[:_LOOKED_AT] if scores[i] < least - _GAIN]
        if not best:
            break
        tried = {i: _followed(kept, common, [*changes, some[i]]) for i in best}
        i = min(tried, key=lambda k: tried[k].left.mean)
        found, least = tried[i], scores[i]
        changes.append(some[i])
        if found.fits:
            break
    if found is None:
        return None
    names = [joint.name for joint in bench.chassis.joints]
    return [names[change.joint] for change in changes if change.zero is None], found


def _rough(bench: Bench, changes: Sequence[_Change]) -> float:
    """Mean logarithm of what rough fits leave of the SUs."""
    there = _with_senses(bench, changes)
    T = _with_given_zeros(bench.chassis.T_parent_joint, changes)
    return float(np.log(roughly_left(bench.chassis, T, there.logs) + _FLOOR).mean())


def _followed(kept: Explained, common: Blueprint, changes: Sequence[_Change]) -> Explained:
    """The fit that changes lead to."""
    bench = _with_senses(kept.bench, changes)
    T = _with_given_zeros(bench.chassis.T_parent_joint, changes)
    sensors = bench.settings.estimation.priors
    shifted = replace(bench, chassis=replace(bench.chassis, T_parent_joint=T))
    placed = placed_from(shifted.chassis, bench.logs, kept.placed.up, sensors)
    begin = replace(common, T_parent_joint=T)
    first = replace(
        kept, bench=bench, placed=placed, blueprint=begin,
        along=shifted.fit(placed, begin, sensors),
    )  # fmt: skip
    wide = [change.joint for change in changes if change.zero is not None]
    if not wide:
        return first
    return _with_zeros(replace(kept, bench=bench, blueprint=common), wide, first)


def _with_senses(bench: Bench, changes: Sequence[_Change]) -> Bench:
    """The same with joints counted the other way."""
    sign = np.ones(bench.chassis.n_joints)
    sign[[change.joint for change in changes if change.zero is None]] = -1.0
    if (sign > 0).all():
        return bench
    logs = [replace(x, q=x.q * sign, qd=x.qd * sign, qdd=x.qdd * sign) for x in bench.logs]
    return replace(bench, logs=logs)


def _with_given_zeros(T_parent_joint: F64, changes: Sequence[_Change]) -> F64:
    """(D, 4, 4) placements with other zeros."""
    T = np.array(T_parent_joint)
    for joint, zero in changes:
        if zero is not None:
            T[joint] = T[joint] @ screw("z", zero, 0.0)
    return T


def _moved(bench: Bench) -> list[int]:
    """Joints that move in some log."""
    moves = np.any([log.moving.any(axis=0) for log in bench.logs], axis=0)
    return [int(j) for j in np.flatnonzero(moves)]


def _without_odd_sus(first: Explained) -> Explained | None:
    """The same without SUs that fit far worse than the rest; None where there are none."""
    each = first.left.ratio
    odd = each > _FAR * max(float(np.nanmedian(each)), GOOD_FIT)
    if not odd.any() or 2 * odd.sum() >= len(odd):
        return None
    bench, placed = without(first.bench, first.placed, odd)
    along = bench.fit(placed, first.blueprint, bench.settings.estimation.priors)
    names = first.bench.su_names
    wrong = {names[int(u)]: float(each[u]) for u in np.flatnonzero(odd)}
    found = Explained(bench, placed, first.blueprint, along, {}, wrong)
    return found if found.fits else None


def without(bench: Bench, placed: Placed, odd: Bool) -> tuple[Bench, Placed]:
    """The same without some of the SUs (U,)."""
    stay = np.flatnonzero(~odd)
    logs = [in_order(log, np.arange(bench.chassis.n_joints), stay) for log in bench.logs]
    kept = replace(bench, logs=logs, su_names=tuple(bench.su_names[u] for u in stay))
    return kept, replace(
        placed,
        su_joint=placed.su_joint[stay],
        fits=tuple(placed.fits[u] for u in stay),
        instead=tuple(placed.instead[u] for u in stay),
        left=placed.left[stay],
    )


def _another_zero(zeros: Explained, kept: Explained) -> ModelMismatchError:
    """Why the model does not fit: the zeros of some joints."""
    parts = [f"{name} by {_amount(zeros, name, offset)}" for name, offset in zeros.offsets.items()]
    return ModelMismatchError(
        f"{_source(kept)}: the model has other zeros than the robot's encoders: "
        f"{', '.join(parts)}; with these, what is left of the readings falls from "
        f"{kept.left.mean:.3g} to {zeros.left.mean:.2g} times noise",
        "let them be corrected with --correct zeros, or set them in the driver",
        joints=tuple(zeros.offsets),
        cost_per_dof=kept.left.mean,
    )


def _another_placement(joint: int, there: Explained, kept: Explained) -> ModelMismatchError:
    """Why the model does not fit: one joint sits elsewhere."""
    name = kept.bench.chassis.joints[joint].name
    xi = there.blueprint.corrections(there.along.state)[joint]
    shift, tilt = 1e3 * np.hypot(xi[0], xi[1]), np.rad2deg(np.hypot(xi[3], xi[4]))
    return ModelMismatchError(
        f"{_source(kept)}: the axis of {name} is not where the model has it: it is {shift:.1f} mm "
        f"and {tilt:.2f} deg off; with that, what is left of the readings falls from "
        f"{kept.left.mean:.3g} to {there.left.mean:.2g} times noise",
        "give the model of this very robot, or let placements be corrected with --correct all:"
        f"{max(1.0, np.ceil(shift)):.0f},{max(0.1, np.ceil(tilt)):.1f}",
        joints=(name,),
        cost_per_dof=kept.left.mean,
    )


def _amount(found: Explained, joint: str, offset: float) -> str:
    names = [j.name for j in found.bench.chassis.joints]
    slides = bool(found.along.problem.tree.prismatic[names.index(joint)])
    return f"{1e3 * offset:+.1f} mm" if slides else f"{np.rad2deg(offset):+.2f} deg"


def _another_sense(joints: Sequence[str], there: Explained, kept: Explained) -> ModelMismatchError:
    """Why the model does not fit: encoders that count the other way."""
    plural = len(joints) > 1
    return ModelMismatchError(
        f"{_source(kept)}: {', '.join(joints)} count{'' if plural else 's'} the other way than in "
        f"the model; turned, what is left of the readings falls from {kept.left.mean:.3g} to "
        f"{there.left.mean:.2g} times noise",
        f"turn the axis of {'these joints' if plural else 'that joint'} in the model, or the sign "
        "in the driver",
        joints=tuple(joints),
        cost_per_dof=kept.left.mean,
    )


def another_robot(found: Explained) -> ModelMismatchError:
    """Why no model of this kind fits."""
    each, names = found.left, found.bench.su_names
    good = int((each.rms <= GROSS).sum())
    worst = [names[int(u)] for u in np.argsort(-np.nan_to_num(each.rms))[:3]]
    return ModelMismatchError(
        f"{_source(found)}: the model is not the robot in the log: {good} of {len(names)} SUs fit "
        f"on any of its links, and up to {np.nanmax(each.rms):.2g} m/s^2 rms is left of the "
        f"readings ({GROSS:g} is the limit), {each.mean:.3g} times noise; other zeros or senses of "
        f"few joints do not explain them; worst are {', '.join(worst)}",
        "give the model of this very robot, as it was mounted and with the tool it had; "
        "`skin2urdf calibrate` without --model needs none",
        joints=tuple(joint.name for joint in found.bench.chassis.joints),
        sus=tuple(names[int(u)] for u in np.flatnonzero(each.rms > GROSS)),
        cost_per_dof=each.mean,
    )


def _source(found: Explained) -> str:
    return found.bench.chassis.description.text.source
