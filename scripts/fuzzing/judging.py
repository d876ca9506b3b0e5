"""Whether a result is wrong without a word."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np


def wrong_in_silence(urdf: Path, truth: Path, sound: set[str]) -> str:
    """What is wrong with a result that says no more than the sound log's, empty if nothing.

    Args:
        urdf: what a mutant was calibrated to.
        truth: the robot.
        sound: all that the sound log's result says in words.
    """
    from skin2urdf.urdf.compare import compare, load_determined, load_open, load_unobservable

    beside = urdf.with_suffix(".json")
    document = json.loads(beside.read_text())
    if spoken(document) - sound:
        return ""
    comparison = compare(
        urdf,
        truth,
        unobservable=load_unobservable(beside),
        anchors=load_determined(beside),
        open_directions=load_open(beside),
        rng=np.random.default_rng(0),
    )
    millimetres = document["fit"]["expected_su_position_mm"]
    stated = float("inf") if millimetres is None else 1e-3 * float(millimetres)
    if not comparison.tree_equal:
        return "a wrong tree without a word"
    if comparison.position.rms > 2.0 * stated:
        rms = comparison.position.rms
        return f"wrong by {1e3 * rms:.3g} mm, {1e3 * stated:.3g} stated, without a word"
    return ""


def spoken(document: dict[str, object]) -> set[str]:
    """All notes and faults of a result, and its verdict."""
    verdict = document.get("verdict")
    said = {str(verdict.get("quality"))} if isinstance(verdict, dict) else set()
    for key in ("notes", "faults"):
        found = document.get(key, [])
        said |= {json.dumps(item) for item in found} if isinstance(found, list) else set()
    return said
