"""Where a page goes."""

from __future__ import annotations

from pathlib import Path

from skin2urdf.errors import UsageError
from skin2urdf.files import check_target, write_atomically

_ENDINGS = (".html", ".htm")


def check_page(path: str | Path) -> Path:
    """Make sure that a page can be written at ``path``, before the work that it shows.

    Raises:
        UsageError: another ending, or nothing can be written there.
    """
    if Path(path).suffix.lower() not in _ENDINGS:
        raise UsageError(f"{path}: a report is a page", "use a name that ends in .html")
    return check_target(path)


def write_page(path: str | Path, page: str) -> Path:
    """Write a page; the old one stays until the new one is whole.

    Raises:
        UsageError: nothing can be written there.
    """
    target = check_page(path)
    write_atomically(target, page)
    return target
