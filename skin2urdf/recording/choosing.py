"""SUs that a user leaves out of logs: those of other things, or known to be broken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

from skin2urdf.errors import UsageError
from skin2urdf.recording.naming import shortened
from skin2urdf.recording.records import Recording, SuStream


def without_sus(recordings: Sequence[Recording], patterns: Sequence[str]) -> list[Recording]:
    """Logs without some SUs.

    Args:
        recordings: the logs.
        patterns: names or topics of SUs, or patterns of these with ``*`` and ``?``.

    Returns:
        The logs, without those SUs that any pattern fits.

    Raises:
        UsageError: a pattern fits no SU of any log, or none is left.
    """
    found = [su for recording in recordings for su in recording.sus]
    for pattern in patterns:
        if not any(_fits(su, pattern) for su in found):
            raise UsageError(
                f"no SU of the logs fits {pattern!r}",
                f"they are {shortened(sorted({su.name for su in found}))}",
            )

    def is_kept(su: SuStream) -> bool:
        return not any(_fits(su, pattern) for pattern in patterns)

    if patterns and not any(map(is_kept, found)):
        raise UsageError("no SU is left of those in the logs", "leave out fewer of them")
    return [replace(each, sus=tuple(filter(is_kept, each.sus))) for each in recordings]


def _fits(su: SuStream, pattern: str) -> bool:
    return fnmatchcase(su.name, pattern) or fnmatchcase(su.topic, pattern)
