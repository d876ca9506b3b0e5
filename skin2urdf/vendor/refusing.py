"""Why a model is not the robot in the logs, in words: what it has otherwise, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.errors import ModelMismatchError
from skin2urdf.vendor.explained import GROSS, Explained


def another_zero(zeros: Explained, kept: Explained) -> ModelMismatchError:
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


def another_placement(joint: int, there: Explained, kept: Explained) -> ModelMismatchError:
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


def another_sense(
    joints: Sequence[str], there: Explained, kept: Explained, alike: Sequence[str]
) -> ModelMismatchError:
    """Why the model does not fit: encoders that count the other way.

    Args:
        joints: they.
        there: the fit with them turned.
        kept: the fit of the model as it is.
        alike: joints of which another zero or sense would explain as much.
    """
    plural = len(joints) > 1
    or_else = f" (another zero or sense of {', '.join(alike)} would explain as much)"
    return ModelMismatchError(
        f"{_source(kept)}: {', '.join(joints)} count{'' if plural else 's'} the other way than in "
        f"the model; turned, what is left of the readings falls from {kept.left.mean:.3g} to "
        f"{there.left.mean:.2g} times noise{or_else * bool(alike)}",
        f"turn the axis of {'these joints' if plural else 'that joint'} in the model, or the sign "
        "in the driver",
        joints=tuple(joints),
        cost_per_dof=kept.left.mean,
    )


def another_robot(found: Explained) -> ModelMismatchError:
    """Why no model of this kind fits."""
    each, names = found.left, found.bench.su_names
    odd = (each.rms > GROSS) | ~found.possible
    good = int((~odd).sum())
    chassis = found.bench.chassis
    remedy = (
        "give the model of this very robot, as it was mounted and with the tool it had; "
        "`skin2urdf calibrate` without --model needs none"
    )
    lacking = ""
    if chassis.extra:
        extra, absent = ", ".join(chassis.extra), ", ".join(chassis.absent)
        lacking = f"; the model lacks {extra} of the log" + f", which lacks {absent}" * bool(absent)
        if absent:
            same = f"where {extra} of the log is one of the model's ({absent}), let both have one"
            remedy = f"{same} name; else {remedy}"
    if not found.possible.all():
        count = int((~found.possible).sum())
        lacking += f"; {count} of its SUs would need errors that no working sensor has"
    worst = [names[int(u)] for u in np.argsort(-np.nan_to_num(each.rms))[:3]]
    return ModelMismatchError(
        f"{_source(found)}: the model is not the robot in the log: {good} of {len(names)} SUs fit "
        f"on any of its links, and up to {np.nanmax(each.rms):.2g} m/s^2 rms is left of the "
        f"readings ({GROSS:g} is the limit), {each.mean:.3g} times noise; other zeros or senses of "
        f"few joints do not explain them; worst are {', '.join(worst)}{lacking}",
        remedy,
        joints=tuple(joint.name for joint in chassis.joints),
        sus=tuple(names[int(u)] for u in np.flatnonzero(odd)),
        cost_per_dof=each.mean,
    )


def _amount(found: Explained, joint: str, offset: float) -> str:
    names = [j.name for j in found.bench.chassis.joints]
    slides = bool(found.along.problem.tree.prismatic[names.index(joint)])
    return f"{1e3 * offset:+.1f} mm" if slides else f"{np.rad2deg(offset):+.2f} deg"


def _source(found: Explained) -> str:
    return found.bench.chassis.description.text.source
