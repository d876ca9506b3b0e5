"""SUs are left out of logs by name, topic or pattern; one that fits none is no silent one."""

from __future__ import annotations

from dataclasses import replace

import pytest
from simulated import changed_sus, simulation

from skin2urdf.errors import UsageError
from skin2urdf.recording.choosing import without_sus
from skin2urdf.recording.records import Recording


def log() -> Recording:
    recording = simulation().recording
    return changed_sus(recording, lambda su: replace(su, topic=f"/arm/{su.name}/imu"))


def names(recordings: list[Recording]) -> list[list[str]]:
    return [[su.name for su in recording.sus] for recording in recordings]


def test_an_su_is_left_out_by_name_or_topic() -> None:
    first, second, *others = [su.name for su in log().sus]
    found = without_sus([log(), log()], [first, f"/arm/{second}/imu"])
    assert names(found) == [others, others]


def test_a_pattern_leaves_out_all_that_it_fits() -> None:
    first, *_, last = (su.name for su in log().sus)
    others = [[name for name in names([log()])[0] if name not in (first, last)]]
    assert names(without_sus([log()], [f"/arm/{first[:-1]}[{first[-1]}]/*", f"{last}*"])) == others
    with pytest.raises(UsageError):
        without_sus([log()], ["/arm/*"])


def test_without_patterns_logs_stay_as_they_are() -> None:
    assert names(without_sus([log()], [])) == names([log()])


def test_a_pattern_that_fits_none_is_bad_usage() -> None:
    with pytest.raises(UsageError) as wrong:
        without_sus([log()], ["su_of_no_robot"])
    assert all(su.name in str(wrong.value.remedy) for su in log().sus[:2])
