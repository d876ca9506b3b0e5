"""Positions without glitches: an encoder that was read wrongly once, a zero that was filled in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from skin2urdf.arrays import F64, Bool
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.credibility import spikes
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.records import JointStream, Recording

TURN = 2 * np.pi
"""A turn [rad]."""


def without_glitches(recording: Recording) -> Recording:
    """A recording without single positions that are far from all around them.

    Joints that came in one message go on sharing their times: what those around it say stands in
    place of a glitch.

    Args:
        recording: streams at the times that were decided for them.

    Returns:
        The recording, with a note on joints that had any.
    """
    found = {joint.name: glitches(joint.position) for joint in recording.joints}
    wrong = {name: int(np.count_nonzero(alone)) for name, alone in found.items() if alone.any()}
    if not wrong:
        return recording
    n, names = sum(wrong.values()), shortened(list(wrong))
    what = f"1 position of {names} departs" if n == 1 else f"{n} single positions of {names} depart"
    words = (
        f"{what} far from all around {'it' if n == 1 else 'them'}, which count instead; check "
        "encoders, their cables and what drivers fill in"
    )
    return replace(
        recording,
        joints=tuple(
            replace(joint, position=_bridged(joint, found[joint.name]))
            if joint.name in wrong
            else joint
            for joint in recording.joints
        ),
        notes=(*recording.notes, ReadingNote("spikes", words, tuple(wrong), n)),
    )


def _bridged(joint: JointStream, wrong: Bool) -> F64:
    """Positions (N,) with a smooth line through the others where some (N,) are wrong."""
    time, sound = joint.time[~wrong], joint.position[~wrong]
    between = CubicSpline(time, np.unwrap(sound))(joint.time[wrong])
    before = sound[np.searchsorted(time, joint.time[wrong]) - 1]
    position = np.array(joint.position)
    position[wrong] = between - TURN * np.rint((between - before) / TURN)
    return position


def glitches(position: F64) -> Bool:
    """(N,) True for single positions (N,) far from those around them, turns of a joint aside.

    Args:
        position: of one joint, in the order of the times [rad or m].
    """
    alone = spikes(position[:, None])
    if not alone.any():
        return alone
    # At the seam of a turn noise leads from one end to the other and back.
    nearest = np.array(position)
    at = np.flatnonzero(alone)
    nearest[at] += TURN * np.rint((position[at - 1] - position[at]) / TURN)
    return alone & spikes(nearest[:, None])
