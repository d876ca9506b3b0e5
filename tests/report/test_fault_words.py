"""Every kind of fault has words made of its numbers, and the JSON has both."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import get_args

import numpy as np
import pytest
from calibrated import calibration

from skin2urdf.faults import Fault, FaultKind
from skin2urdf.report.document import as_document
from skin2urdf.report.faults import fault_words
from skin2urdf.report.plain import dumps
from skin2urdf.report.summary import as_text


def fault(kind: FaultKind) -> Fault:
    return Fault(
        kind, "it", log=1, begin=12.25, end=34.5, end_log=1, size=0.375, deviation=0.0125,
        turn=0.25, sus=("other_su",) if kind == "swapped" else ("it", "it_before"),
    )  # fmt: skip


@pytest.mark.parametrize("kind", get_args(FaultKind))
def test_every_kind_has_words_and_what_to_do(kind: FaultKind) -> None:
    words = fault_words(fault(kind), 2)
    assert "it" in words.what
    assert "nan" not in str(words)
    assert words.remedy
    assert words.remedy in str(words)


@pytest.mark.parametrize("kind", ["loose", "swapped", "encoder sign", "encoder jump", "contact"])
def test_a_log_is_named_where_there_are_several(kind: FaultKind) -> None:
    shown = replace(fault(kind), detail="in a log" if kind == "swapped" else "")
    assert "log 2" in fault_words(shown, 2).what
    assert "log 2" not in fault_words(shown, 1).what


def test_sizes_are_told_in_the_units_of_the_report() -> None:
    jump = replace(fault("encoder jump"), unit="rad")
    assert f"{np.rad2deg(0.375):.2f} deg" in fault_words(jump, 1).what
    assert "375.00 mm" in fault_words(replace(jump, unit="m"), 1).what
    slip = fault_words(fault("loose"), 1).what
    assert "375.0 mm" in slip
    assert f"{np.rad2deg(0.25):.2f} deg" in slip
    assert "mm" not in fault_words(replace(fault("loose"), size=np.nan), 1).what


def test_numbers_and_words_stand_in_the_json_and_words_in_the_summary() -> None:
    slip = fault("loose")
    found = replace(calibration(), faults=(slip, Fault("mirrored", "su_2")))
    told, other = as_document(found)["faults"]
    assert dumps(told)
    assert told["begin"] == 12.25
    assert told["turn"] == 0.25
    assert told.keys() == {*asdict(slip), "words", "remedy"}
    assert told["words"] == fault_words(slip, 1).what
    assert other["begin"] is None
    assert str(fault_words(slip, 1)) in as_text(found).replace("\n    ", " ")
