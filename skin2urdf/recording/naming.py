"""Names: of SUs from frame_ids or topics, and what a terminal and a URDF can hold of any name."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Sequence

from skin2urdf.notes import ReadingNote

# Names that Pinocchio gives in every model.
RESERVED = ("universe",)
# Control characters, line ends, what changes the direction of writing, and what XML can not hold.
_ACTING = re.compile(
    "[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)


def su_names(sources: Sequence[tuple[str, str]]) -> list[str]:
    """Name the SUs of a log.

    Args:
        sources: U pairs of topic and frame_id, one per SU, no two alike.

    Returns:
        U names, no two alike.
    """
    frames = [frame.strip().lstrip("/") for _, frame in sources]
    frame_count = Counter(frames)
    topic_count = Counter(topic for topic, _ in sources)
    names: list[str] = []
    for (topic, _), frame in zip(sources, frames, strict=True):
        if frame and frame_count[frame] == 1:
            names.append(frame)
            continue
        from_topic = topic.strip("/").replace("/", "_") or "su"
        several = topic_count[topic] > 1 and frame
        names.append(f"{from_topic}_{frame}" if several else from_topic)
    return _unique(names)


def told_by_topic(name: str, topics: Sequence[str], taken: Collection[str]) -> list[str]:
    """Names for joints of one name on several topics; the name itself for that of a single one.

    Args:
        name: the name that all have.
        topics: their topics, no two alike.
        taken: names that other joints have.

    Returns:
        As many names, no two alike: what a topic does not end with as all do, before the name.
    """
    parts = [topic.strip("/").split("/") for topic in topics]
    while all(parts) and len({own[-1] for own in parts}) == 1:
        parts = [own[:-1] for own in parts]
    return _unique(["_".join([*own, name]) for own in parts], taken)


def _unique(names: list[str], others: Collection[str] = ()) -> list[str]:
    """Number names that are still alike, or that others have."""
    taken: set[str] = set(others)
    given = set(names)
    following: Counter[str] = Counter()
    result = []
    for name in names:
        candidate = name
        while candidate in taken or (candidate != name and candidate in given):
            following[name] += 1
            candidate = f"{name}_{following[name] + 1}"
        taken.add(candidate)
        result.append(candidate)
    return result


def printable(text: str) -> str:
    """Escape what would act on a terminal or break a line, as Python writes it in a string.

    Args:
        text: any text, such as a topic that someone else's recorder wrote.

    Returns:
        The text itself where all of it can be printed.
    """
    return _ACTING.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def writable(names: Sequence[str], kind: str) -> tuple[list[str], list[ReadingNote]]:
    """Rename what the readers of a URDF can not hold.

    Pinocchio, which most robotics software reads URDFs with, has a joint and a frame named
    "universe" in every model; a name of blanks is none.

    Args:
        names: names of joints or of SUs, no two alike.
        kind: "joint" or "SU".

    Returns:
        As many names, no two alike, and notes on those that differ.
    """
    taken = {name for name in names if not _unwritable(name)}
    found = []
    for name in names:
        new, number = name, 2
        if _unwritable(name):
            plain = new = f"{name.strip()}_{kind.lower()}".strip("_")
            while new in taken:
                new, number = f"{plain}_{number}", number + 1
            taken.add(new)
        found.append(new)
    notes = [
        ReadingNote(
            "renamed",
            f"the {kind} {name!r} is called {new!r}, as a URDF can not hold its name",
            (name, new),
        )
        for name, new in zip(names, found, strict=True)
        if new != name
    ]
    return found, notes


def _unwritable(name: str) -> bool:
    return not name.strip() or name in RESERVED


def shortened(names: Sequence[str], most: int = 8) -> str:
    """The first names of a list, and how many there are more."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
