"""YAML with comments at its top."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any


def yaml_text(table: Mapping[str, Any], comments: Iterable[str]) -> str:
    """A table as YAML, in its own order, numbers at full precision.

    Args:
        table: strings, numbers, lists and tables.
        comments: lines for the top.
    """
    import yaml

    head = "".join(f"# {' '.join(line.split())}\n" for line in comments)
    body = yaml.safe_dump(
        dict(table), sort_keys=False, default_flow_style=None, allow_unicode=True, width=1000
    )
    return head + str(body)
