"""Readings from which gravity was taken off are called that."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from simulated import changed_sus, simulation

from skin2urdf.errors import InsufficientDataError
from skin2urdf.geometry.units import FORCE_UNITS
from skin2urdf.notes import Note
from skin2urdf.recording.records import SuStream
from skin2urdf.signals.sampling import sampled_together


def weightless(su: SuStream) -> SuStream:
    """What is left of readings where a driver subtracts nearly all that is slow."""
    force = su.specific_force
    return replace(su, specific_force=0.02 * (force - force.mean(axis=0)))


def test_a_bias_as_large_as_gravity_in_g_is_no_gravity() -> None:
    """It keeps its direction however the SU is turned; what a sensor in g reads does not."""
    recording = simulation().recording
    names = [su.name for su in recording.sus]

    def changed(su: SuStream) -> SuStream:
        if su.name == names[-1]:
            return replace(su, specific_force=0.1 * weightless(su).specific_force + 0.47)
        in_g = su.name == names[-2]
        return replace(su, specific_force=su.specific_force / 9.81) if in_g else su

    ((sampled,), _) = sampled_together([changed_sus(recording, changed)])
    assert [(fault.kind, fault.subject) for fault in sampled.faults] == [("wrong unit", names[-1])]
    converted = [note.sus for note in sampled.notes if isinstance(note, Note)]
    assert (names[-2],) in converted


def test_readings_without_gravity_are_refused_by_that_name() -> None:
    recording = simulation().recording
    with pytest.raises(InsufficientDataError) as lacking:
        sampled_together([changed_sus(recording, weightless)])
    assert lacking.value.lacks == "gravity"


@pytest.mark.parametrize("unit", ["mm/s^2", "cm/s^2", "ft/s^2"])
def test_readings_in_another_unit_are_refused_by_its_name(unit: str) -> None:
    factor = FORCE_UNITS[unit]
    recording = changed_sus(
        simulation().recording,
        lambda su: replace(su, specific_force=su.specific_force / factor),
    )
    with pytest.raises(InsufficientDataError, match=re.escape(unit)) as lacking:
        sampled_together([recording])
    assert lacking.value.lacks == "gravity"


def test_one_such_sensor_among_others_is_left_out() -> None:
    recording = simulation().recording
    first = recording.sus[0].name
    one = changed_sus(recording, lambda su: weightless(su) if su.name == first else su)
    ((sampled,), _) = sampled_together([one])
    assert [(fault.kind, fault.subject) for fault in sampled.faults] == [("wrong unit", first)]
