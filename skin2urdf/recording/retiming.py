"""Times of a recording made in memory, decided as the reader decides them for a file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.recording.copies import without_copies
from skin2urdf.recording.holding import joints_as_measured
from skin2urdf.recording.positions import without_glitches
from skin2urdf.recording.records import Recording
from skin2urdf.recording.silence import joints_through_silence
from skin2urdf.recording.timing import NS_PER_S, sample_times


def retimed(recording: Recording) -> Recording:
    """A recording whose times are taken as stamps, and made regular where the signal says so.

    Positions that were sent several times count once, those that are sent on change go on where
    nothing is sent; glitches are bridged, and copies of SUs left out.

    Args:
        recording: streams whose times are stamps, noisy as a driver's.

    Returns:
        The recording as it would be read back from a file.
    """
    recording = joints_through_silence(joints_as_measured(recording))
    sus = []
    for su in recording.sus:
        if not len(su.time):
            sus.append(su)
            continue
        time, kept, _ = _times(su.time, su.specific_force)
        whole = su if len(kept) == len(su.time) else su.at(kept)
        sus.append(replace(whole, time=time))
    joints = {}
    for members in recording.joints_together:
        signal = np.stack([j.position for j in members], axis=1)
        time, kept, noise = _times(members[0].time, signal)
        for j in members:
            regular = j if len(kept) == len(j.time) else j.at(kept)
            # Of times that were made from stamps before, the stamps' noise is known from then.
            joints[j.name] = replace(regular, time=time, stamp_noise=max(noise, j.stamp_noise))
    timed = replace(
        recording, joints=tuple(joints[j.name] for j in recording.joints), sus=tuple(sus)
    )
    return without_copies(without_glitches(timed))


def _times(stamps: F64, signal: F64) -> tuple[F64, Int, float]:
    """Times (M,) [s], the numbers (M,) of the samples they belong to, and the stamps' noise [s]."""
    ns = np.rint((stamps + 1.0) * NS_PER_S).astype(np.int64)
    found = sample_times(ns, ns, signal)
    return found.time / NS_PER_S - 1.0, found.kept, found.noise
