"""Names of SUs: the frame_id where that is unique, else made from the topic."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence


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


def _unique(names: list[str]) -> list[str]:
    """Number names that are still alike."""
    taken: set[str] = set()
    result = []
    for name in names:
        candidate, number = name, 2
        while candidate in taken or (candidate != name and candidate in names):
            candidate, number = f"{name}_{number}", number + 1
        taken.add(candidate)
        result.append(candidate)
    return result
