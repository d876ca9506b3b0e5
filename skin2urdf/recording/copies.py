"""Readings that are copies of others: a topic that is relayed, a sensor under two names.

Two sensors never read the same for long, as each has noise of its own. One that counted twice would
count too much, and as two SUs of a robot they sit in one place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.records import Recording, SuStream

# Places along a log that are looked at, and readings at each: a relay may lose some elsewhere, and
# may stamp them some messages later.
_PLACES, _WITHIN = 5, 128
# Readings in a row that have to be the same, and changes among them: by chance sensors of two
# values an axis agree that long once in 10^9 times.
_ALIKE, _CHANGES = 32, 10


def without_copies(recording: Recording) -> Recording:
    """A recording with each stream of readings once.

    Args:
        recording: streams.

    Returns:
        The recording, of copies the one with most readings, with a note on each that is left out.
    """
    most_first = sorted(recording.sus, key=lambda su: (-len(su.time), su.name))
    owner: dict[bytes, str] = {}
    copies: dict[str, list[str]] = {}
    for su in most_first:
        keys = _keys(su)
        of = next((owner[key] for key in keys if key in owner), None)
        if of is not None:
            copies.setdefault(of, []).append(su.name)
        for key in keys:
            owner.setdefault(key, of or su.name)
    if not copies:
        return recording
    left_out = {name for names in copies.values() for name in names}
    notes = [
        ReadingNote(
            "copied readings",
            f"{shortened(names)} {'sends' if len(names) == 1 else 'send'} the same readings as "
            f"{of} and {'is' if len(names) == 1 else 'are'} left out: a topic that is relayed, or "
            "a sensor under two names; record only one of them",
            (of, *names),
        )
        for of, names in copies.items()
    ]
    return replace(
        recording,
        sus=tuple(su for su in recording.sus if su.name not in left_out),
        notes=(*recording.notes, *notes),
    )


def _keys(su: SuStream) -> list[bytes]:
    """What some stretches of readings hold, the same for a copy whatever its stamps.

    Each begins where its own readings say, so that copies that are some messages apart agree.
    """
    count, found = len(su.time), []
    if count < _WITHIN + _ALIKE:
        return []
    span = float(su.time[-1] - su.time[0])
    for share in np.linspace(0.1, 0.9, _PLACES):
        first = int(np.searchsorted(su.time, su.time[0] + share * span))
        first = min(first, count - _WITHIN - _ALIKE)
        marks = _marks(su.specific_force[first : first + _WITHIN + _ALIKE])
        begin = int(np.argmin(marks[:_WITHIN]))
        alike = marks[begin : begin + _ALIKE]
        if np.count_nonzero(np.diff(alike)) >= _CHANGES:
            found.append(alike.tobytes())
    su.put_away()
    return found


def _marks(readings: F64) -> Int:
    """(N,) numbers that tell readings (N, 3) apart."""
    bits = np.ascontiguousarray(readings).view(np.uint64)
    odd = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
    mixed = bits * odd
    mixed ^= mixed >> np.uint64(29)
    return np.asarray((mixed * odd[::-1]).sum(axis=1) >> np.uint64(1)).astype(np.int64)
