"""Values of records as plain JSON, and its text."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import Any

import numpy as np

_LIBRARIES = ("numpy", "scipy", "pin", "nlopt", "casadi")


def versions() -> dict[str, str | None]:
    """Versions of this package, of Python and of the libraries that compute."""
    result: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("skin2urdf", *_LIBRARIES):
        try:
            result[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            result[name] = None
    return result


def to_plain(value: Any) -> Any:
    """Turn records' values into what JSON can hold; NaN and infinity become None."""
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        # Most are finite, and those of a thousand SUs would be looked through one by one.
        sound = value.dtype.kind in "biu" or (value.dtype.kind == "f" and np.isfinite(value).all())
        return value.tolist() if sound else to_plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def dumps(document: Mapping[str, Any]) -> str:
    """JSON text of a plain document: indented, lists of plain values on one line."""
    return _lines(document, "") + "\n"


def _lines(value: Any, indent: str) -> str:
    """JSON text of plain values, indented."""
    deeper = indent + "  "
    if isinstance(value, dict) and value:
        items = [f"{json.dumps(key)}: {_lines(item, deeper)}" for key, item in value.items()]
    elif isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        items = [_lines(item, deeper) for item in value]
    else:
        return json.dumps(value, allow_nan=False)
    begin, end = "{}" if isinstance(value, dict) else "[]"
    return f"{begin}\n{deeper}" + f",\n{deeper}".join(items) + f"\n{indent}{end}"
