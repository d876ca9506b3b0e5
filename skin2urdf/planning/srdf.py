"""Links that may touch, from the SRDF that MoveIt's assistant writes beside a URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from skin2urdf.errors import UnreadableInputError


def links_that_may_touch(path: str | Path) -> frozenset[frozenset[str]]:
    """Pairs of links under ``disable_collisions``.

    Args:
        path: SRDF (``<disable_collisions link1="a" link2="b" reason="Adjacent"/>``).

    Raises:
        UnreadableInputError: the file can not be read, or is something else.
    """
    try:
        root = ET.parse(path).getroot()  # noqa: S314 - expat refuses what grows without bounds
    except OSError as error:
        raise UnreadableInputError(
            str(path), f"can not be read: {error.strerror or error}", "check the path"
        ) from error
    except ET.ParseError as error:
        raise UnreadableInputError(str(path), f"is no XML: {error}", _REMEDY) from error
    pairs = [(each.get("link1"), each.get("link2")) for each in root.iter("disable_collisions")]
    if root.tag != "robot" or not all(a and b for a, b in pairs):
        raise UnreadableInputError(str(path), "is no SRDF", _REMEDY)
    return frozenset(frozenset((a, b)) for a, b in pairs if a and b)


_REMEDY = 'write <robot name="r"><disable_collisions link1="a" link2="b"/></robot>'
