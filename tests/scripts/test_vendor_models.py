"""Trials on given models: what counts as right, and that every kind of model is what it says."""

from __future__ import annotations

from dataclasses import replace

import check_slips
import numpy as np
import pytest
from batch.records import Record
from models.slips import Noticed, Slip
from models.table import report, shortfalls
from models.trials import Found, Kind, Trial

SOUND = Found(
    error="", joints=(), expected=(), tilt_deg=0.1, turned=False, true_tilt_deg=0.0, left=0.8,
    right_link=1.0, n_sus=5, position_mm=0.1, position_stated_mm=0.1, orientation_deg=0.01,
    orientation_stated_deg=0.01, nees=1.0, n_corrections=0, n_within=0, seconds=1.0,
)  # fmt: skip
REFUSED = replace(SOUND, error="ModelMismatchError", joints=("a",), expected=("a",))


@pytest.mark.parametrize(
    ("kind", "found", "right"),
    [
        ("sound", SOUND, True),
        ("sound", REFUSED, False),
        ("mount", replace(SOUND, tilt_deg=180.0, true_tilt_deg=180.0, turned=True), True),
        ("mount", replace(SOUND, tilt_deg=180.0, true_tilt_deg=180.0), False),
        ("mount", replace(SOUND, true_tilt_deg=90.0, turned=True), False),
        ("sound", replace(SOUND, turned=True), False),
        ("placement", REFUSED, True),
        ("sense", REFUSED, True),
        ("sense", replace(REFUSED, expected=("b",)), False),
        ("zero", replace(SOUND, expected=("a",)), False),
        ("flange", replace(SOUND, nees=3.0), True),
        ("flange", replace(SOUND, nees=5.0), False),
        ("robot", REFUSED, True),
        ("robot", SOUND, False),
    ],
)
def test_a_trial_is_right_where_what_is_wrong_was_named(
    kind: Kind, found: Found, right: bool
) -> None:
    run = Record(Trial("panda", kind, 0), found, "")
    assert (shortfalls(run) == []) is right
    assert kind in report([run])


@pytest.mark.parametrize(("slipped", "changed", "right"), [
    ("", (), True), ("", ("a",), False), ("a", ("a",), True), ("a", (), False),
    ("a", ("a", "b"), False),
])  # fmt: skip
def test_a_slip_has_to_be_found_and_nothing_else(
    slipped: str, changed: tuple[str, ...], right: bool
) -> None:
    found = Noticed(slipped, changed, True, 1.0, 0.1, 0.0, 0.01, 1.0, 0.9, 1.0, 1.0)
    run = Record(Slip("panda", 0, 1.0 if slipped else 0.0, 0.0), found, "")
    assert (check_slips.shortfalls(run) == []) is right
    assert np.isfinite(len(check_slips.report([run])))
