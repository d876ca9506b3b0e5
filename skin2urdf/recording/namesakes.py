"""Joints of one name on several topics: one joint that is sent several times, or several joints.

Commands, filtered positions and what a driver relays go with what is measured. Robots of one kind
beside each other have joints of the same names, which go their own ways.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.credibility import POSITIONS_APART
from skin2urdf.recording.naming import told_by_topic
from skin2urdf.recording.timing import TimedStream

_MOMENTS = 2048
# Share of a joint's variance that one of the same name has in common where both are one: of a
# command and what follows it 0.9 and more, of two joints that make M moves of their own 1 / M.
_IN_COMMON = 0.5


def told_apart(
    found: Mapping[str, Sequence[TimedStream]],
) -> tuple[dict[str, TimedStream], list[ReadingNote]]:
    """One stream for each joint, those of one name told apart where they go their own ways.

    Args:
        found: streams by name, one per topic that has it.

    Returns:
        The streams by a name that no two have: those with most samples, those of joints of one
        name called by their topics as well; and notes for the user.
    """
    apart = _going_apart(found)
    chosen: dict[str, TimedStream] = {}
    notes: list[ReadingNote] = []
    for name, streams in found.items():
        kept: dict[str, list[TimedStream]] = {}
        for stream in sorted(streams, key=lambda each: -each.time.size):
            like = (t for t in kept if frozenset((t, stream.topic)) not in apart)
            kept.setdefault(next(like, stream.topic), []).append(stream)
        called = told_by_topic(name, list(kept), {*found, *chosen} - {name})
        if len(kept) > 1:
            words = (
                f"the positions of {name} on {', '.join(kept)} go their own ways: they were taken "
                f"for different joints, and are called {', '.join(called)} (where they are one, "
                "record one of the topics alone)"
            )
            notes.append(ReadingNote("joints of one name", words, (name, *kept)))
        for new, (best, *others) in zip(called, kept.values(), strict=True):
            chosen[new] = best._replace(name=new)
            if others:
                topics = sorted(each.topic for each in others)
                words = (
                    f"joint {new} is on several topics; {best.topic} has most samples and was "
                    f"used, {', '.join(topics)} passed over"
                )
                notes.append(ReadingNote("several topics", words, (new, *topics)))
    return chosen, notes


def _going_apart(found: Mapping[str, Sequence[TimedStream]]) -> set[frozenset[str]]:
    """Pairs of topics whose joints of the same names go their own ways."""
    shares: dict[frozenset[str], list[float]] = {}
    for streams in found.values():
        for one, other in combinations(streams, 2):
            share = _in_common(one, other)
            if np.isfinite(share):
                shares.setdefault(frozenset((one.topic, other.topic)), []).append(share)
    return {pair for pair, of_joints in shares.items() if np.mean(of_joints) < _IN_COMMON}


def _in_common(one: TimedStream, other: TimedStream) -> float:
    """Share of their variance that two streams have in common; NaN where one of them rests."""
    begin = max(one.time[0], other.time[0])
    end = min(one.time[-1], other.time[-1])
    if not begin < end:
        return float("nan")
    moments = np.linspace(begin, end, _MOMENTS)
    a, b = (_about_its_mean(each, moments) for each in (one, other))
    square = np.array([np.mean(a * a), np.mean(b * b)])
    if not (square > POSITIONS_APART**2).all():
        return float("nan")
    return float(np.mean(a * b) ** 2 / square.prod())


def _about_its_mean(stream: TimedStream, moments: F64) -> F64:
    """Positions at some moments, without their mean."""
    values = np.interp(moments, stream.time, stream.values)
    return np.asarray(values - values.mean())
