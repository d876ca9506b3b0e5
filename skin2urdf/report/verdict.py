"""The first line: how good the result is, how exact, and what speaks against it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skin2urdf.calibration.result import GOOD_FIT, Calibration
from skin2urdf.estimation.uncertainty.narrow import narrow_priors
from skin2urdf.estimation.uncertainty.observability import Verdict
from skin2urdf.estimation.uncertainty.physics import (
    IMPOSSIBLE_SLACK,
    STAND_STILL,
    base_moves,
)
from skin2urdf.notes import Note
from skin2urdf.recording.naming import shortened
from skin2urdf.report.carried import carried_without_turning, recoils
from skin2urdf.report.limbs import OpenLimb
from skin2urdf.report.tables import count, number

_MM, _DEG = 1e3, float(np.rad2deg(1.0))
_NAMED = 3


DoubtKind = Literal[
    "faults", "SUs unplaced", "SUs moved otherwise", "SUs carried along", "base recoils",
    "SUs unexplained",
    "impossible slack", "smoothed away", "SUs of two places", "orders open", "joints alike",
    "wrong ratios", "soft base", "moving base", "SUs misfit", "poses misfit", "prediction",
    "errors come back", "not arrived", "sensors", "no such sensors", "weak joints", "open limbs",
    "joints open", "SUs open",
]  # fmt: skip
"""What speaks against a result: things found wrong, SUs whose readings fit no place, that a joint
moves otherwise than it goes, or carries along without turning them, a base that recoils from what
joints do by more than can be followed, SUs whose readings do not fit the place that they have,
joints further off their encoders than any gear allows, fast motion that a driver smooths away, SUs
that fit another place as well, joints that may follow each other in another order, that moved alike
all along, or by another share than they say, a base that gives way, or moves by itself, SUs and
poses that fit worse than the rest, poses that are predicted worse than stated, what is left of the
readings and comes back with the motion, a fit that ended before it arrived, sensors that are worse
than the options say, or than any, axes that are known weakly, limbs whose places are open, and what
of the joints and SUs the log does not determine."""


@dataclass(frozen=True)
class Doubt:
    """What keeps a result from being good, or is missing of it.

    Attributes:
        kind: what sort of doubt.
        words: the same for the user.
        names: the joints, SUs, or subjects of faults that it is about.
        number: of poses; or how many times worse than stated; or an angle [rad]; or by how much SUs
            are elsewhere [m]; NaN where names say all.
    """

    kind: DoubtKind
    words: str
    names: tuple[str, ...] = ()
    number: float = float("nan")


def doubts(calibration: Calibration, limbs: Sequence[OpenLimb] = ()) -> tuple[Doubt, ...]:
    """What speaks against a result, and what is missing of it.

    Args:
        calibration: a finished calibration.
        limbs: those that nothing connects with the largest one.
    """
    return (*_doubts(calibration), *_apart(limbs), *_missing(calibration))


def verdict(
    calibration: Calibration,
    worst_position: float,
    worst_orientation: float,
    against: Sequence[Doubt] = (),
) -> str:
    """The outcome in one line that says how far it can be believed.

    Args:
        calibration: a finished calibration.
        worst_position: largest error to expect of an SU that is determined [m]; NaN without any.
        worst_orientation: the same of orientations [rad].
        against: what speaks against it.

    Returns:
        ``good``, ``fair`` or ``bad``, the size of the robot, how well the model explains the
        readings, what accuracy to expect, and what is wrong or missing.
    """
    tree = calibration.model.tree
    parts = [
        f"{calibration.quality}: {count(tree.n_joints, 'joint')}, {count(tree.n_sus, 'SU')}",
        _fit(calibration),
    ]
    if calibration.quality != "bad" and np.isfinite(worst_position):
        parts.append(
            f"errors to expect up to {number(worst_position * _MM)} mm, "
            f"{number(worst_orientation * _DEG, 3)} deg"
        )
    if against:
        parts.append(f"but {'; '.join(doubt.words for doubt in against)}")
    return "; ".join(parts)


def _fit(calibration: Calibration) -> str:
    """How well the model explains the readings."""
    per_dof = calibration.misfit
    cost = f"what is left of them is {per_dof:.2g} times noise"
    if calibration.along is None:
        cost = f"cost per degree of freedom {per_dof:.2f}"
    limit = calibration.largest_misfit
    if not per_dof <= limit:
        return f"the model does not explain the readings ({cost}; {limit:g} is the limit)"
    if calibration.unexplained:
        return f"the model explains the readings in the mean of seconds alone ({cost})"
    if per_dof > GOOD_FIT:
        return f"the model explains the readings in part ({cost}; up to {GOOD_FIT:g} is good)"
    return f"the model explains the readings ({cost})"


def _doubts(calibration: Calibration) -> list[Doubt]:
    """What keeps a result from being good, beside the cost."""
    tree, seen = calibration.model.tree, calibration.observability
    found: list[Doubt] = []
    if calibration.faults:
        kinds = dict.fromkeys(f"{fault.subject} {fault.kind}" for fault in calibration.faults)
        words = f"{count(len(kinds), 'fault')}: {shortened(list(kinds), _NAMED)}"
        found.append(Doubt("faults", words, tuple(f.subject for f in calibration.faults)))
    lost = calibration.without_a_place
    if lost:
        words = (
            f"the readings of {shortened(list(lost), _NAMED)} fit no place in the tree: something "
            "may be wrong with them, or with names or joints (see the notes)"
        )
        found.append(Doubt("SUs unplaced", words, lost))
    if otherwise := calibration.moved_otherwise:
        move = "moves" if len(otherwise) == 1 else "move"
        words = (
            f"{shortened(list(otherwise), _NAMED)} {move} with a joint that neither turns nor "
            "slides them (see the notes): lengths there are means"
        )
        found.append(Doubt("SUs moved otherwise", words, otherwise))
    carried = dict(calibration.carried_along)
    if (why := carried_without_turning(calibration)) is not None:
        names = (*carried, *dict.fromkeys(carried.values()))
        found.append(Doubt("SUs carried along", "{} ({})".format(*why), names))
    recoiling = dict(calibration.recoiling)
    if (why := recoils(calibration)) is not None:
        names = (*recoiling, *dict.fromkeys(recoiling.values()))
        found.append(Doubt("base recoils", "{} ({})".format(*why), names))
    unexplained = [su for su in calibration.unexplained if su not in {*carried, *recoiling}]
    if unexplained:
        feel = "feels" if len(unexplained) == 1 else "feel"
        words = (
            f"{shortened(list(unexplained), _NAMED)} {feel} motion that the tree does not explain: "
            "an SU hangs on a wrong joint, or its clock, its axes or its name are wrong"
        )
        found.append(Doubt("SUs unexplained", words, tuple(unexplained)))
    if calibration.needs_impossible_slack:
        found.append(Doubt("impossible slack", "{} ({})".format(*IMPOSSIBLE_SLACK)))
    if calibration.is_smoothed_away:
        words = (
            "positions are smoothed before they are logged, by so much that fast motion can not be "
            "told from them any more (log them as encoders have them, or move more slowly)"
        )
        found.append(Doubt("smoothed away", words))
    two = calibration.of_two_places
    if two:
        sus, joints = (list(dict.fromkeys(names)) for names in zip(*two, strict=True))
        words = (
            f"the log does not tell whether {shortened(sus, _NAMED)} sit{'s' * (len(sus) == 1)} on "
            f"the base or on {' and '.join(joints)}, which is vertical"
        )
        found.append(Doubt("SUs of two places", words, tuple(sus)))
    if orders := calibration.open_orders:
        pairs = {name: None for note in orders for name in _exchanged(note)}
        sizes = [note.size for note in orders if np.isfinite(note.size)]
        # Any of them may be wrong, and all at a time.
        size = float(np.linalg.norm(sizes)) if sizes else np.nan
        there = f" by {number(size * _MM)} mm (rms)" if sizes else ""
        open_ = f"in which order {shortened(list(pairs), _NAMED)} follow each other"
        if len(pairs) == 1:
            open_ = f"which joints {next(iter(pairs))} follows"
        words = (
            f"the log does not tell {open_}: where several of them have moved, SUs may be "
            f"elsewhere{there} (move each of them at several positions of the others, or put an SU "
            "on every segment)"
        )
        found.append(Doubt("orders open", words, tuple(pairs), number=size))
    if alike := calibration.moved_alike:
        joints = list(dict.fromkeys(name for group in alike for name in group))
        words = (
            f"the log does not tell {shortened(joints, _NAMED)} from each other, which moved alike "
            "all along: the model holds as long as they do (move each of them by itself)"
        )
        found.append(Doubt("joints alike", words, tuple(joints)))
    if ratios := calibration.wrong_ratios:
        shares = ", ".join(f"{name} by {number(100 * x)} %" for name, x in ratios.items())
        words = (
            f"joints move by more or less than their positions say, {shares} (see that each driver "
            "has the right gear ratio and encoder scale; the URDF holds for positions of the links)"
        )
        found.append(Doubt("wrong ratios", words, tuple(ratios)))
    if calibration.base_gives_way:
        words = (
            "the base gives way: lengths along the first axis may be off by more than is stated "
            "(fix it stiffly and record again, or give the robot's own URDF by --model)"
        )
        found.append(Doubt("soft base", words))
    if turn := calibration.turn_of_base:
        found.append(Doubt("moving base", f"{base_moves(turn)} ({STAND_STILL})", number=turn))
    elif tilt := calibration.tilt_of_base:
        words = f"the base tilts by itself, by {number(tilt * _DEG)} deg (rms) ({STAND_STILL})"
        found.append(Doubt("moving base", words, number=tilt))
    known = {fault.subject for fault in calibration.faults}
    odd = [tree.su_names[u] for u in np.flatnonzero(calibration.unlike_sus.odd)]
    odd = [name for name in dict.fromkeys((*odd, *calibration.feel_more)) if name not in known]
    if odd:
        fit = "fits" if len(odd) == 1 else "fit"
        words = (
            f"{shortened(odd, _NAMED)} {fit} far worse than the other SUs (see how firmly "
            "sensors and base are fixed)"
        )
        found.append(Doubt("SUs misfit", words, tuple(odd)))
    poses = calibration.unlike_poses.odd
    if poses.any():
        words = f"{poses.sum()} of {count(len(poses), 'pose')} do not fit the others"
        found.append(Doubt("poses misfit", words, number=int(poses.sum())))
    if calibration.goodness.prediction > GOOD_FIT:
        times = float(np.sqrt(calibration.goodness.prediction))
        words = f"poses that are left out are predicted {times:.1f} times worse than stated"
        found.append(Doubt("prediction", words, number=times))
    if calibration.along is not None and seen.widening > GOOD_FIT:
        times = float(np.sqrt(seen.widening))
        words = (
            "what is left of the readings comes back wherever the robot does the same: stated "
            f"errors are {times:.1f} times those of noise"
        )
        found.append(Doubt("errors come back", words, number=times))
    if calibration.along is not None and calibration.not_arrived:
        times = calibration.along.ahead.share
        words = (
            "the fit of all samples ended before it arrived: a further step would change the "
            f"result by {times:.1f} times its noise, which stated errors count (record more "
            "motion, or give the robot's own URDF by --model)"
        )
        found.append(Doubt("not arrived", words, number=times))
    by_the_paper = calibration.settings.method == "paper"
    narrow = not by_the_paper and narrow_priors(calibration.estimate)
    if narrow and calibration.misfit > GOOD_FIT:
        words = "the sensors are worse than the options say of them (see the notes)"
        found.append(Doubt("sensors", words))
    unlikely = [name for name in calibration.implausible if name not in known]
    if calibration.mostly_implausible:
        words = (
            "most SUs would need errors that no sensor has (see the notes): record more, on a base "
            "that stands still, or give the robot's own URDF by --model"
        )
        found.append(Doubt("no such sensors", words, tuple(unlikely)))
    elif unlikely:
        words = (
            f"{shortened(unlikely, _NAMED)} would need errors that no sensor has (see the notes): "
            "broken, or on another joint than the tree has it (check the sensor, and record the "
            "joints next to it one at a time)"
        )
        found.append(Doubt("no such sensors", words, tuple(unlikely)))
    weak = _with_verdict(tree.joint_names, seen.joint_verdict, ("weak",))
    if weak:
        words = f"the axis of {shortened(weak, _NAMED)} is known weakly"
        found.append(Doubt("weak joints", words, tuple(weak)))
    return found


def _exchanged(note: Note) -> list[str]:
    """Joints that are at another place in the other order."""
    if len(note.joints) != len(note.instead):
        return sorted(set(note.joints) ^ set(note.instead))
    return [a for a, b in zip(note.joints, note.instead, strict=True) if a != b]


def _apart(limbs: Sequence[OpenLimb]) -> list[Doubt]:
    """That limbs are not where the URDF has them."""
    if not limbs:
        return []
    one = len(limbs) == 1
    joints = [limb.joint for limb in limbs]
    words = (
        f"where the limb{'s' * (not one)} beyond {shortened(joints, _NAMED)} "
        f"{'is' if one else 'are'} relative to that beyond {limbs[0].reference} is open (in the "
        "URDF all begin at the base's origin)"
    )
    return [Doubt("open limbs", words, tuple(joints))]


def _missing(calibration: Calibration) -> list[Doubt]:
    """The joints and SUs that the log does not determine."""
    tree, seen = calibration.model.tree, calibration.observability
    joints = _with_verdict(tree.joint_names, seen.joint_verdict, ("not observable",))
    sus = _with_verdict(tree.su_names, seen.su_verdict, ("not observable", "weak"))
    missing = []
    parts: tuple[tuple[DoubtKind, list[str], str], ...] = (
        ("joints open", joints, count(tree.n_joints, "joint")),
        ("SUs open", sus, count(tree.n_sus, "SU")),
    )
    for kind, names, all_ in parts:
        if names:
            are = "is" if len(names) == 1 else "are"
            words = f"{len(names)} of {all_} {are} not determined ({shortened(names, _NAMED)})"
            missing.append(Doubt(kind, words, tuple(names)))
    return missing


def _with_verdict(
    names: Sequence[str], verdicts: Sequence[Verdict], wanted: Sequence[Verdict]
) -> list[str]:
    return [name for name, found in zip(names, verdicts, strict=True) if found in wanted]
