"""What exports are made from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from calibrated import calibration
from hypothesis import given
from hypothesis import strategies as st

from skin2urdf.errors import UnreadableInputError
from skin2urdf.export.source import Source, load_source, quaternion, rotation_of_rpy
from skin2urdf.urdf.names import BASE_LINK

ANGLE = st.floats(-np.pi, np.pi)


def test_sus_are_those_of_the_json(source: Source) -> None:
    tree = calibration().model.tree
    assert {su.known_as for su in source.sus} == set(tree.su_names)
    (base,) = (su for su in source.sus if su.joint.parent == BASE_LINK)
    assert base.position_open
    assert base.open_words
    first = source.movable[0].child
    (along,) = (su for su in source.sus if su.joint.parent == first)
    assert not along.position_open
    assert along.open_words
    placed = source.placed_sus()
    assert base not in placed
    assert len(placed) == tree.n_sus - 1
    assert any(base.name in line for line in source.header)


def test_without_its_json_a_urdf_has_sus_by_their_joints(urdf: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.urdf"
    alone.write_bytes(urdf.read_bytes())
    source = load_source(alone)
    assert source.document is None
    assert {su.name for su in source.sus} == set(calibration().model.tree.su_names)
    assert not any(su.position_open for su in source.sus)


@pytest.mark.parametrize(
    "text", ["<robot", "<a/>", "<robot><link name='a'/><link name='b'/></robot>"]
)
def test_what_is_no_urdf_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(text)
    with pytest.raises(UnreadableInputError) as raised:
        load_source(path)
    assert raised.value.remedy


def test_numbers_that_are_none_are_refused(urdf: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(urdf.read_text().replace('xyz="0.0 0.0 0.0"', 'xyz="0.0 nan 0.0"'))
    with pytest.raises(UnreadableInputError, match="nan"):
        load_source(path)


@given(ANGLE, ANGLE, ANGLE)
def test_rotations_are_pinocchios(roll: float, pitch: float, yaw: float) -> None:
    R = rotation_of_rpy(np.array([roll, pitch, yaw]))
    np.testing.assert_allclose(R, pin.rpy.rpyToMatrix(roll, pitch, yaw), atol=1e-15)
    w, x, y, z = quaternion(R)
    np.testing.assert_allclose(pin.Quaternion(w, x, y, z).matrix(), R, atol=1e-12)
