"""Numbered labels of SUs, DoFs, segments and joints, and text that fits a width."""

from __future__ import annotations

from collections.abc import Sequence

from skin2urdf.report.canvas import text_width


def segment_id(segment: int) -> str:
    """``S1`` is the reference segment; the paper counts from 1."""
    return f"S{segment + 1}"


def joint_id(joint: int) -> str:
    """``J1`` is the joint that carries ``S2``."""
    return f"J{joint + 1}"


def numbers(indices: Sequence[int], limit: int = 1_000_000) -> str:
    """Numbers from 1 on, with ranges: ``1, 4-6``.

    Args:
        indices: ascending indices from 0 on.
        limit: longest list of numbers and ranges; what is beyond it is only counted.
    """
    runs: list[list[int]] = []
    for i in indices:
        if runs and i == runs[-1][-1] + 1:
            runs[-1].append(i)
        else:
            runs.append([i])
    parts: list[str] = []
    for k, run in enumerate(runs):
        if k == limit:
            return f"{', '.join(parts)}, + {sum(len(r) for r in runs[k:])} more"
        if len(run) > 2:
            parts.append(f"{run[0] + 1}\N{EN DASH}{run[-1] + 1}")
        else:
            parts += [str(i + 1) for i in run]
    return ", ".join(parts)


def wrapped(text: str, size: float, width: float) -> list[str]:
    """Break a text at its spaces.

    Args:
        text: words.
        size: size of the type [pt].
        width: longest line [in]; only a single word may be longer.
    """
    lines: list[str] = []
    for word in text.split():
        if lines and text_width(f"{lines[-1]} {word}", size) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def shortened(lines: Sequence[str], limit: int) -> list[str]:
    """At most ``limit`` lines, the last of which says how many are left out."""
    if len(lines) <= limit:
        return list(lines)
    return [*lines[: limit - 1], f"+ {len(lines) - limit + 1} more"]
