"""The first line: how good the result is, how exact, and what speaks against it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.calibration.result import GOOD_FIT, Calibration
from skin2urdf.estimation.uncertainty.narrow import narrow_priors
from skin2urdf.estimation.uncertainty.observability import Verdict
from skin2urdf.recording.naming import shortened
from skin2urdf.report.limbs import OpenLimb
from skin2urdf.report.tables import count, number

_MM, _DEG = 1e3, float(np.rad2deg(1.0))
_NAMED = 3


def verdict(
    calibration: Calibration,
    worst_position: float,
    worst_orientation: float,
    limbs: Sequence[OpenLimb] = (),
) -> str:
    """The outcome in one line that says how far it can be believed.

    Args:
        calibration: a finished calibration.
        worst_position: largest error to expect of an SU that is determined [m]; NaN without any.
        worst_orientation: the same of orientations [rad].
        limbs: those that nothing connects with the largest one.

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
    but = [*_doubts(calibration), *_apart(limbs), *_missing(calibration)]
    if but:
        parts.append(f"but {'; '.join(but)}")
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
    if per_dof > GOOD_FIT:
        return f"the model explains the readings in part ({cost}; up to {GOOD_FIT:g} is good)"
    return f"the model explains the readings ({cost})"


def _doubts(calibration: Calibration) -> list[str]:
    """What keeps a result from being good, beside the cost."""
    tree, seen = calibration.model.tree, calibration.observability
    doubts = []
    if calibration.faults:
        kinds = dict.fromkeys(f"{fault.subject} {fault.kind}" for fault in calibration.faults)
        doubts.append(f"{count(len(kinds), 'fault')}: {shortened(list(kinds), _NAMED)}")
    if calibration.base_gives_way:
        doubts.append(
            "the base gives way: lengths along the first axis may be off by more than is stated "
            "(fix it stiffly and record again, or give the robot's own URDF by --model)"
        )
    known = {fault.subject for fault in calibration.faults}
    odd = [tree.su_names[u] for u in np.flatnonzero(calibration.unlike_sus.odd)]
    odd = [name for name in odd if name not in known]
    if odd:
        fit = "fits" if len(odd) == 1 else "fit"
        doubts.append(f"{shortened(odd, _NAMED)} {fit} far worse than the other SUs")
    poses = calibration.unlike_poses.odd
    if poses.any():
        doubts.append(f"{poses.sum()} of {count(len(poses), 'pose')} do not fit the others")
    if calibration.goodness.prediction > GOOD_FIT:
        times = float(np.sqrt(calibration.goodness.prediction))
        doubts.append(f"poses that are left out are predicted {times:.1f} times worse than stated")
    if calibration.along is not None and seen.widening > GOOD_FIT:
        times = float(np.sqrt(seen.widening))
        doubts.append(
            "what is left of the readings comes back wherever the robot does the same: stated "
            f"errors are {times:.1f} times those of noise"
        )
    by_the_paper = calibration.settings.method == "paper"
    narrow = not by_the_paper and narrow_priors(calibration.estimate)
    if narrow and calibration.misfit > GOOD_FIT:
        doubts.append("the sensors are worse than the options say of them (see the notes)")
    weak = _with_verdict(tree.joint_names, seen.joint_verdict, ("weak",))
    if weak:
        doubts.append(f"the axis of {shortened(weak, _NAMED)} is known weakly")
    return doubts


def _apart(limbs: Sequence[OpenLimb]) -> list[str]:
    """That limbs are not where the URDF has them."""
    if not limbs:
        return []
    one = len(limbs) == 1
    beyond = shortened([limb.joint for limb in limbs], _NAMED)
    return [
        f"where the limb{'s' * (not one)} beyond {beyond} "
        f"{'is' if one else 'are'} relative to that beyond {limbs[0].reference} is open (in the "
        "URDF all begin at the base's origin)"
    ]


def _missing(calibration: Calibration) -> list[str]:
    """The joints and SUs that the log does not determine."""
    tree, seen = calibration.model.tree, calibration.observability
    joints = _with_verdict(tree.joint_names, seen.joint_verdict, ("not observable",))
    sus = _with_verdict(tree.su_names, seen.su_verdict, ("not observable", "weak"))
    missing = []
    for names, all_ in ((joints, count(tree.n_joints, "joint")), (sus, count(tree.n_sus, "SU"))):
        if names:
            are = "is" if len(names) == 1 else "are"
            which = shortened(names, _NAMED)
            missing.append(f"{len(names)} of {all_} {are} not determined ({which})")
    return missing


def _with_verdict(
    names: Sequence[str], verdicts: Sequence[Verdict], wanted: Sequence[Verdict]
) -> list[str]:
    return [name for name, found in zip(names, verdicts, strict=True) if found in wanted]
