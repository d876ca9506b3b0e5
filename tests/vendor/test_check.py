"""Is a calibration still true: what is as it was, and what moved, died or was exchanged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from vendor.model_robot import Recorded, model, recorded

from skin2urdf.arrays import F64
from skin2urdf.cli.main import main
from skin2urdf.errors import UnreadableInputError
from skin2urdf.geometry.se3 import exp, inverse, log
from skin2urdf.output import save_on_model, write_pair
from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.recording.writing import write
from skin2urdf.report.check import as_document, as_text
from skin2urdf.vendor.calibrate import calibrate_with_model
from skin2urdf.vendor.checking import Checked, check
from skin2urdf.vendor.known_skin import load_skin
from skin2urdf.vendor.repairing import repaired

SLIP = np.array([0.004, -0.003, 0.0, 0.0, 0.02, 0.0])


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return recorded(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module")
def calibrated(toy: Recorded, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration and its JSON."""
    path = tmp_path_factory.mktemp("calibrated") / "robot.urdf"
    save_on_model(calibrate_with_model(toy.recording, model()), path)
    return path


def with_slip(calibrated: Path, folder: Path, su: str, twist: F64) -> Path:
    """The calibration of a robot on which an SU sat elsewhere."""
    document = json.loads(calibrated.with_suffix(".json").read_bytes())
    T = np.array(document["sus"][su]["T_joint_su"]) @ exp(twist)
    document["sus"][su]["T_joint_su"] = T.tolist()
    path = folder / "slipped.urdf"
    write_pair(path, calibrated.read_bytes().decode(), document)
    return path


def on(toy: Recorded, link: str) -> str:
    """The SU on a link."""
    return next(su.name for su in toy.recording.sus if toy.link[su.name] == link)


def verdicts(checked: Checked) -> dict[str, str]:
    return {su.name: su.what for su in checked.sus}


def test_what_is_as_it_was_raises_no_alarm(toy: Recorded, calibrated: Path, tmp_path: Path) -> None:
    log_file, history = tmp_path / "log.mcap", tmp_path / "history.jsonl"
    write(toy.recording, log_file)
    history.write_text('{"true": false}\n')
    given = ["check", str(log_file), str(calibrated), "--history", str(history), "--quiet"]
    assert main(given) == 0
    lines = [json.loads(line) for line in history.read_text().splitlines()]
    assert [line["true"] for line in lines] == [False, True]
    assert lines[1]["sus"].keys() == {su.name for su in toy.recording.sus}


def test_a_slip_is_found_with_its_size_and_that_su_alone_is_renewed(
    toy: Recorded, calibrated: Path, tmp_path: Path
) -> None:
    su = on(toy, "three")
    slipped = with_slip(calibrated, tmp_path, su, SLIP)
    checked = check(toy.recording, slipped)
    assert verdicts(checked)[su] == "moved"
    assert sum(each.changed for each in checked.sus) == 1
    (found,) = (each for each in checked.sus if each.changed)
    assert found.shift[0] == pytest.approx(0.005, abs=5 * found.shift[1])
    assert found.turn[0] == pytest.approx(0.02, abs=5 * found.turn[1])
    text, document = repaired(checked)
    path = tmp_path / "again.urdf"
    write_pair(path, text, document)
    renewed = {each.name: each for each in load_skin(path).sus}
    off = log(inverse(toy.T_link_su[su]) @ renewed[su].T_link_su)
    assert off @ np.linalg.solve(renewed[su].covariance, off) < 25
    # Nothing but the numbers of one origin.
    old, new = slipped.read_bytes().split(b"\n"), path.read_bytes().split(b"\n")
    changed = [i for i, (a, b) in enumerate(zip(old, new, strict=True)) if a != b]
    assert len(changed) == 1
    before = json.loads(slipped.with_suffix(".json").read_bytes())["sus"]
    after = json.loads(path.with_suffix(".json").read_bytes())["sus"]
    assert {name for name in after if after[name] != before[name]} == {su}


def test_exchanged_and_dead_sus_are_named(toy: Recorded, calibrated: Path) -> None:
    two, three, one = (on(toy, link) for link in ("two", "three", "one"))
    names = {two: three, three: two, one: one}
    sus = [replace(su, name=names[su.name]) for su in toy.recording.sus]
    dead = [
        replace(su, specific_force=np.zeros_like(su.specific_force)) if su.name == one else su
        for su in sus
    ]
    mixed: Recording = replace(
        toy.recording, sus=tuple(sorted(dead, key=lambda su: su.name)), digest=""
    )
    checked = check(mixed, calibrated)
    assert verdicts(checked) == {two: "exchanged", three: "exchanged", one: "gone"}
    places = {su.name: su.place_of for su in checked.sus}
    assert places[two] == three
    assert places[three] == two


def test_of_what_the_log_does_not_tell_no_figures_are_shown(
    toy: Recorded, calibrated: Path
) -> None:
    checked = check(toy.recording, calibrated)
    assert as_text(checked).count("+-") == 2 * sum(su.told for su in checked.sus) > 0
    silent = replace(checked, sus=tuple(replace(su, what="open") for su in checked.sus))
    assert "+-" not in as_text(silent)
    assert {su["shift_sd"] for su in as_document(silent)["sus"].values()} == {None}


def test_what_changed_beyond_one_joint_alone_points_at_its_encoder(
    toy: Recorded, calibrated: Path
) -> None:
    def shifted(joint: JointStream) -> JointStream:
        return replace(joint, position=joint.position + 0.05 * (joint.name == "lift"))

    joints = tuple(map(shifted, toy.recording.joints))
    checked = check(replace(toy.recording, joints=joints), calibrated)
    assert not checked.true
    assert checked.in_common == "lift"


def test_a_urdf_without_its_json_is_refused(calibrated: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.urdf"
    alone.write_bytes(calibrated.read_bytes())
    with pytest.raises(UnreadableInputError):
        load_skin(alone)
