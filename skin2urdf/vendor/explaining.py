"""What of a given model the readings contradict, and what explains them then.

A model that fits is taken as it is. Where it does not, what is common is tried before what is not,
and few numbers before many: a specimen that differs by what makers state; few joints with another
zero, or one that sits elsewhere; gears that yield and biases that drift; encoders that are far off,
or count the other way; single SUs that fit nowhere. What is left is another robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import Bool
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.blueprint import Blueprint
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.signals.trajectory import in_order
from skin2urdf.vendor.counting import count_otherwise
from skin2urdf.vendor.deviating import Off, other_zeros, placed_otherwise, strange
from skin2urdf.vendor.explained import GROSS, Explained, placed_again
from skin2urdf.vendor.fitting import Bench
from skin2urdf.vendor.placing import Placed, placed_elsewhere, placed_from
from skin2urdf.vendor.records import Correction
from skin2urdf.vendor.refusing import another_placement, another_robot, another_sense, another_zero

_NOISE = 1.0
"""What noise leaves, at most, over what it makes of means over spans of time."""
_YIELDING = 0.5
"""The same as GROSS with gears that yield, under loads that are known [m/s^2]: those of 5 mrad per
hundred newton metres leave 0.08 on an arm of 18 kg, and no gear yields by more than a few times
that."""
_FAR = 8.0
"""What an SU leaves over what the median SU does, from which it is the SU that does not fit."""


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
    found = _decided(found)
    if not found.fits and correction.what != "none":
        found = placed_again(found)
    if not found.fits or (correction.what != "none" and strange(found)):
        found = _cause(found, correction)
    found = _looked_further(_with_doubts(found), found.along.state)
    allowed = found.blueprint.deviations.any() and not asked.deviations.any()
    if allowed and found.along.causes and not found.offsets:
        # What real robots have beside may be all there is: then nothing of the model deviates.
        as_given = replace(found.along.state, T_parent_joint=asked.T_parent_joint)
        kept = _looked_further(replace(found, blueprint=asked), as_given)
        return kept if kept.fits else found
    return found


def _looked_further(found: Explained, start: State) -> Explained:
    """The same with what all sensors are like, and with what real robots have and ideal ones not.

    Where little is left, it may still be other from place to place, and outlast spans of time.
    """
    bench = found.bench
    learnt = bench.learnt(found.along, bench.settings.estimation.priors)
    along = bench.fit(
        found.placed, found.blueprint, learnt, start,
        look_further=found.fits or _looked(found.along), last=True,
    )  # fmt: skip
    return replace(found, along=along)


def _decided(found: Explained) -> Explained:
    """The same with SUs on other segments where all samples contradict the ones that they are on.

    A joint that is vertical, or moves little, makes a difference that rough fits do not see.
    """
    odd = [
        u
        for u in range(len(found.placed.fits))
        if found.placed.others(u) and not found.left.ratio[u] <= GOOD_FIT
    ]
    if not odd:
        return found
    bench, sensors = found.bench, found.bench.settings.estimation.priors
    placed = placed_elsewhere(bench.chassis, bench.logs, found.placed, odd, sensors)
    along = bench.fit(placed, found.blueprint, sensors)
    again = replace(found, placed=placed, along=along)
    return again if again.left.mean < found.left.mean else found


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
        specimen = placed_again(specimen)
    if specimen.fits and not strange(specimen):
        return specimen
    zeros = other_zeros(specimen)
    few = _few_joints(specimen, zeros)
    # What few numbers explain down to noise needs nothing that has many.
    if few is not None and few.found.left.mean <= _NOISE:
        return _allowed(few, kept, correction)
    tried = [kept]
    if not strange(specimen):
        tried.append(specimen)
    for attempt in _yielding(tried):
        tried.append(attempt)
        if attempt.fits and not (few and few.found.left.mean <= attempt.left.mean):
            return attempt
    if few is not None:
        return _allowed(few, kept, correction)
    least = min(tried, key=lambda each: each.left.mean)
    looked = specimen.fits or zeros.fits
    if zeros.offsets and zeros.settles(least):
        # Zeros that leave what is no noise may hide a joint that sits elsewhere.
        elsewhere = None if looked else placed_otherwise(specimen)
        return _allowed(elsewhere or Off(zeros), kept, correction)
    if not gross and (found := _another_count(kept, common, least, correction)) is not None:
        return found
    if not looked and (elsewhere := placed_otherwise(specimen)) is not None:
        return _allowed(elsewhere, kept, correction)
    if specimen.fits:
        return specimen  # many joints are off by more than is common
    for attempt in tried:
        if (left := _without_odd_sus(attempt)) is not None:
            return left
    best = min(tried, key=lambda each: each.left.mean)
    if np.nanmax(best.left.rms) > GROSS or not best.possible.all():
        raise another_robot(best)
    return best


def _another_count(
    kept: Explained, common: Blueprint, least: Explained, correction: Correction
) -> Explained | None:
    """Encoders that count the other way or from far off, where that settles what is left.

    Raises:
        ModelMismatchError: it does, and may not be corrected.
    """
    changed = count_otherwise(kept, common)
    if changed is None or not changed.found.settles(least):
        return None
    if changed.senses:
        raise another_sense(changed.senses, changed.found, kept, changed.alike)
    return _allowed(Off(changed.found), kept, correction)


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


def _few_joints(specimen: Explained, zeros: Explained) -> Off | None:
    """Few joints off by more than is common that explain the readings; None where none do.

    Zeros beside which placements are off by more than is common, or which leave what is no noise,
    may hide a joint that sits elsewhere.
    """
    few = [Off(zeros)] if zeros.offsets and zeros.fits and not strange(zeros) else []
    if not (few and zeros.left.mean <= _NOISE) and (specimen.fits or zeros.fits):
        few += [off for off in [placed_otherwise(specimen)] if off is not None]
    return min(few, key=lambda off: off.found.left.mean, default=None)


def _allowed(off: Off, kept: Explained, correction: Correction) -> Explained:
    """Joints off by more than is common, where that may be corrected.

    Raises:
        ModelMismatchError: it may not.
    """
    if off.joint is not None and correction.what != "all":
        raise another_placement(off.joint, off.found, kept)
    if off.joint is None and correction.what == "none":
        raise another_zero(off.found, kept)
    return off.found


def _without_odd_sus(first: Explained) -> Explained | None:
    """The same without SUs that fit far worse than the rest, or only with sensors that can not be.

    None where there are none, and where the others do not fit either.
    """
    each = first.left.ratio
    odd = (each > _FAR * max(float(np.nanmedian(each)), GOOD_FIT)) | ~first.possible
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
        by_chance=tuple(placed.by_chance[u] for u in stay),
        left=placed.left[stay],
    )
