"""Records own arrays that nobody writes to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from skin2urdf.arrays import F64, Bool, Int, Record


@dataclass(frozen=True, eq=False)
class _Kept(Record):
    place: F64
    number: Int
    some: tuple[Bool, ...]
    name: str
    more: F64 | None = None


def test_a_record_makes_its_arrays_read_only_and_of_their_types() -> None:
    place = np.zeros(3)
    kept = _Kept(place, np.array([1.0, 2.0]), (np.array([1, 0]),), "F64", np.arange(2))
    assert kept.more is not None
    for array, dtype in (
        (kept.place, np.float64),
        (kept.number, np.int64),
        (kept.some[0], np.bool_),
        (kept.more, np.float64),
    ):
        assert array.dtype == dtype
        assert not array.flags.writeable
    place[0] = 1.0
    assert kept.place[0] == 0.0
    assert kept.name == "F64"
    assert _Kept(place, kept.number, (), "").more is None


def test_records_share_what_nobody_can_write_to() -> None:
    first = _Kept(np.zeros(3), np.zeros(1, dtype=np.int64), (), "")
    assert _Kept(first.place, first.number, (), "").place is first.place
    with pytest.raises(ValueError, match="read-only"):
        first.place[0] = 1.0
