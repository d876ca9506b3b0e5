"""Two files, written together or not at all."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated import calibration, simulation

from skin2urdf import output
from skin2urdf.calibration.result import Calibration
from skin2urdf.errors import BadFitError, Skin2UrdfError, UsageError
from skin2urdf.output import document_beside, output_paths, save
from skin2urdf.urdf.compare import compare, load_determined, load_open, load_unobservable
from skin2urdf.urdf.loading import load_robot


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_both_files_are_written_and_belong_together(tmp_path: Path) -> None:
    urdf, beside = save(calibration(), tmp_path / "arm.urdf")
    assert names(tmp_path) == ["arm.json", "arm.urdf"]
    tree = calibration().model.tree
    robot = load_robot(urdf)
    assert tuple(robot.joint_types) == tree.joint_names
    assert set(tree.su_names) <= robot.links
    document = json.loads(beside.read_text())
    assert document["urdf"]["file"] == "arm.urdf"
    assert document_beside(urdf) == beside


def test_the_json_of_another_urdf_is_not_taken(tmp_path: Path) -> None:
    urdf, beside = save(calibration(), tmp_path / "arm.urdf")
    urdf.write_text(urdf.read_text() + "\n")
    assert document_beside(urdf) is None
    beside.write_text("no JSON")
    assert document_beside(urdf) is None
    beside.unlink()
    assert document_beside(urdf) is None


def test_name_and_visuals_can_be_chosen(tmp_path: Path) -> None:
    urdf, _ = save(calibration(), tmp_path / "a.urdf", name="lab arm", visuals=False)
    root = ET.fromstring(urdf.read_text())  # noqa: S314 - our own file
    assert root.get("name") == "lab arm"
    assert not root.findall(".//visual")
    urdf, _ = save(calibration(), tmp_path / "a.urdf")
    root = ET.fromstring(urdf.read_text())  # noqa: S314 - our own file
    assert root.get("name") == "a"
    assert root.findall(".//visual")


@pytest.mark.parametrize("name", ["robot.json", "robot.JSON", "robot.mcap", "none/robot.urdf"])
def test_places_that_can_not_be_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError) as raised:
        output_paths(tmp_path / name)
    assert raised.value.remedy
    assert names(tmp_path) == []


def test_a_folder_in_the_place_of_the_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "robot.json").mkdir()
    with pytest.raises(UsageError, match=r"robot\.json"):
        output_paths(tmp_path / "robot.urdf")


def bad() -> Calibration:
    """A result that does not explain its readings, as the paper's method may end with."""
    found = calibration().estimate
    return replace(calibration(), along=None, estimate=replace(found, chi2=1e3 * found.chi2))


def test_a_bad_result_takes_no_place_of_a_good_one(tmp_path: Path) -> None:
    assert bad().quality == "bad"
    with pytest.raises(BadFitError):
        save(bad(), tmp_path / "robot.urdf")
    assert names(tmp_path) == []
    save(calibration(), tmp_path / "robot.urdf")
    old = (tmp_path / "robot.urdf").read_text()
    with pytest.raises(BadFitError) as raised:
        save(bad(), tmp_path / "robot.urdf")
    assert raised.value.remedy
    assert (tmp_path / "robot.urdf").read_text() == old
    save(bad(), tmp_path / "robot.urdf", even_bad=True)
    assert json.loads((tmp_path / "robot.json").read_text())["verdict"]["quality"] == "bad"


@pytest.mark.parametrize("step", ["check_urdf", "as_document", "dumps"])
def test_a_failure_leaves_the_old_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    for name in ("robot.urdf", "robot.json"):
        (tmp_path / name).write_text(f"old {name}")

    def fail(*_: object) -> None:
        raise Skin2UrdfError("no")

    monkeypatch.setattr(output, step, fail)
    with pytest.raises(Skin2UrdfError, match="no"):
        save(calibration(), tmp_path / "robot.urdf")
    assert names(tmp_path) == ["robot.json", "robot.urdf"]
    assert (tmp_path / "robot.urdf").read_text() == "old robot.urdf"
    assert (tmp_path / "robot.json").read_text() == "old robot.json"


def test_a_full_disk_leaves_the_old_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "robot.urdf").write_text("old")
    (tmp_path / "robot.json").write_text("old")
    whole = output.write_atomically

    def write(path: Path, text: str) -> None:
        if path.suffix == ".json":
            raise UsageError("full")
        whole(path, text)

    monkeypatch.setattr(output, "write_atomically", write)
    with pytest.raises(UsageError):
        save(calibration(), tmp_path / "robot.urdf")
    assert names(tmp_path) == ["robot.json", "robot.urdf"]
    assert {path.read_text() for path in tmp_path.iterdir()} == {"old"}


def test_a_comparison_takes_the_json_that_belongs_to_the_estimate(tmp_path: Path) -> None:
    urdf, beside = save(calibration(), tmp_path / "arm.urdf")
    truth = tmp_path / "truth.urdf"
    truth.write_text(simulation().truth.urdf)

    def error(**told: object) -> float:
        rng = np.random.default_rng(0)
        return compare(urdf, truth, n_configurations=20, rng=rng, **told).position.rms

    informed = error()
    explicit = {
        "unobservable": load_unobservable(beside),
        "anchors": load_determined(beside),
        "open_directions": load_open(beside),
    }
    assert informed == error(**explicit)
    # The first axis is vertical: the SU on the first joint may sit anywhere along it.
    assert error(unobservable={}) > 2 * informed
    urdf.write_text(urdf.read_text() + "\n")
    assert error() == error(unobservable={})


def test_limits_can_be_chosen(tmp_path: Path) -> None:
    names = calibration().model.tree.joint_names
    seen = calibration().limits
    urdf, _ = save(calibration(), tmp_path / "a.urdf", limits="seen")
    np.testing.assert_array_equal([load_robot(urdf).limits[n] for n in names], seen)
    for limits, count in (("wide", 0), ("soft", len(names))):
        urdf, _ = save(calibration(), tmp_path / "a.urdf", limits=limits)
        assert urdf.read_text().count("<safety_controller") == count
    file = tmp_path / "limits.yaml"
    file.write_text(f"{names[1]}: [-2, 2.5]")
    urdf, _ = save(calibration(), tmp_path / "b.urdf", limits=file)
    assert load_robot(urdf).limits[names[1]] == (-2, 2.5)
    for lower, upper in load_robot(urdf).limits.values():
        assert lower < 0 < upper


def test_comparisons_stay_inside_of_what_was_seen(tmp_path: Path) -> None:
    truth = tmp_path / "truth.urdf"
    truth.write_text(simulation().truth.urdf)
    wide, seen = (
        save(calibration(), tmp_path / f"{limits}.urdf", limits=limits)[0]
        for limits in ("wide", "seen")
    )
    errors = [
        compare(urdf, truth, n_configurations=20, rng=np.random.default_rng(0)).position
        for urdf in (wide, seen)
    ]
    assert errors[0] == errors[1]
