"""What a log does not tell is read from the JSON beside an estimated URDF."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from skin2urdf.errors import UnreadableInputError
from skin2urdf.urdf.compare import load_determined, load_open, load_unobservable


def test_unobservable_directions_are_read_from_json(tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    assert load_unobservable(path) is None
    for empty in ({}, [], {"observability": None}, {"observability": {"joints": {}}}):
        path.write_text(json.dumps(empty))
        assert load_unobservable(path) is None
    sus = {
        "a": {"unobservable": [[0, 0, 2, 0, 0, 0], [0, 0, 1, 0, 0, 0]]},
        "b": {"unobservable": []},
        "c": {"unobservable": None},
        "d": {"verdict": "determined"},
    }
    path.write_text(json.dumps({"observability": {"sus": sus}}))
    read = load_unobservable(path)
    assert read is not None
    assert {name: rows.shape for name, rows in read.items()} == {
        "a": (1, 6),
        "b": (0, 6),
        "c": (6, 6),
    }
    np.testing.assert_allclose(np.abs(read["a"]), [[0, 0, 1, 0, 0, 0]])


@pytest.mark.parametrize("bad", ["", "{", '{"observability": {"sus": {"a": {"unobservable": 3}}}}'])
def test_a_json_that_is_none_is_named(tmp_path: Path, bad: str) -> None:
    path = tmp_path / "robot.json"
    path.write_text(bad)
    with pytest.raises(UnreadableInputError, match=r"robot\.json"):
        load_unobservable(path)


def test_determined_sus_are_read_from_json(tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    assert load_determined(path) is None
    for empty in ({}, [], {"sus": None}, {"sus": {"a": {}}}):
        path.write_text(json.dumps(empty))
        assert load_determined(path) is None
    verdicts = {"a": "determined", "b": "weak", "c": "not observable", "d": "determined"}
    path.write_text(json.dumps({"sus": {name: {"verdict": v} for name, v in verdicts.items()}}))
    assert load_determined(path) == {"a", "d"}
    faults = [{"kind": "mirrored", "subject": "d"}, {"kind": "loose", "subject": "a"}]
    sus = {name: {"verdict": v} for name, v in verdicts.items()}
    path.write_text(json.dumps({"sus": sus, "faults": faults}))
    assert load_determined(path) == {"a"}
    path.write_text("{")
    with pytest.raises(UnreadableInputError, match=r"robot\.json"):
        load_determined(path)


def test_open_directions_between_branches_are_read_from_json(tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    assert load_open(path) == ()
    for empty in ({}, [], {"observability": None}, {"observability": {"sus": {}}}):
        path.write_text(json.dumps(empty))
        assert load_open(path) == ()
    entry = {"joints": {"a": [0, 0, 1, 0, 0, 0]}, "sus": {"su": [1, 0, 0, 0, 0, 0.5]}, "words": {}}
    path.write_text(json.dumps({"observability": {"between_branches": [entry, entry]}}))
    first, second = load_open(path)
    assert second.joints.keys() == first.joints.keys() == {"a"}
    np.testing.assert_array_equal(first.joints["a"], [0, 0, 1, 0, 0, 0])
    np.testing.assert_array_equal(first.sus["su"], [1, 0, 0, 0, 0, 0.5])


@pytest.mark.parametrize(
    "bad",
    [7, [7], [{"joints": {}}], [{"joints": {"a": [1, 2]}, "sus": {}}],
     [{"joints": {}, "sus": {"a": [None, 0, 0, 0, 0, 0]}}], [{"joints": [], "sus": {}}]],
)  # fmt: skip
def test_open_directions_of_another_shape_are_refused(tmp_path: Path, bad: object) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps({"observability": {"between_branches": bad}}))
    with pytest.raises(UnreadableInputError, match=r"robot\.json"):
        load_open(path)
