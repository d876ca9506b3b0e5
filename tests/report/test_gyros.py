"""Gyroscopes in the report, the JSON file and what a log is said to hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated import calibration, simulation

from skin2urdf.calibration.result import Calibration
from skin2urdf.recording.writing import write
from skin2urdf.report.document import as_document
from skin2urdf.report.gyros import gyro_notes
from skin2urdf.report.inventory import as_document as inventory_document
from skin2urdf.survey import survey


def test_the_document_has_every_gyroscope() -> None:
    found = calibration()
    tree, truth = found.model.tree, simulation().truth
    sus = as_document(found)["sus"]
    for u, name in enumerate(tree.su_names):
        gyro, true = sus[name]["gyro"], truth.gyros[[s.name for s in truth.sus].index(name)]
        if tree.su_joint[u] < 0:
            assert not gyro["used"]
            assert gyro["why_not"]
            continue
        assert gyro["used"]
        sd = np.array(gyro["bias_sd"])
        assert np.abs((np.array(gyro["bias"]) - true.bias) / sd).max() < 5
        assert len(gyro["misalignment"]) == 6
        assert gyro["noise"] == pytest.approx(true.grade.noise_rms * np.pi / 180, rel=0.9)


def test_what_counted_and_what_did_not_is_told() -> None:
    found = calibration()
    assert found.along is not None
    assert found.along.gyros is not None
    gyros = found.along.gyros
    plain = len(gyro_notes(found))
    last = int(np.flatnonzero(gyros.used)[-1])
    off = np.arange(len(gyros.used)) == last
    odd = replace(gyros, used=gyros.used & ~off, contradict=off)
    contradicted: Calibration = replace(found, along=replace(found.along, gyros=odd))
    assert len(gyro_notes(contradicted)) == plain + 1
    name = found.model.tree.su_names[last]
    assert any(name in note for note in gyro_notes(contradicted))
    assert not as_document(contradicted)["sus"][name]["gyro"]["used"]
    without = replace(found, along=replace(found.along, gyros=None))
    assert gyro_notes(without) == []
    assert as_document(without)["sus"][name]["gyro"] is None


def test_a_survey_says_who_has_a_gyroscope(tmp_path: Path) -> None:
    recording = simulation().recording
    first, *others = recording.sus
    some = replace(recording, sus=(replace(first, angular_velocity=None), *others))
    write(some, tmp_path / "log.mcap")
    sus = inventory_document(survey(tmp_path / "log.mcap"))["sus"]
    assert {name: figures["gyroscope"] for name, figures in sus.items()} == {
        su.name: su.name != first.name for su in recording.sus
    }
