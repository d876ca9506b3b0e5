"""In-memory recordings are timed as if they came from a file."""

from dataclasses import replace

import numpy as np
import pytest

from skin2urdf.calibration.pipeline import recordings_of
from skin2urdf.recording.reading import read
from skin2urdf.recording.records import JointStream, Recording, SuStream
from skin2urdf.recording.retiming import retimed
from skin2urdf.recording.writing import write


def _noisy(seed: int) -> tuple[Recording, np.ndarray]:
    rng = np.random.default_rng(seed)
    true = np.arange(4000) / 250.0
    stamps = true + rng.normal(0, 2e-4, true.size)
    q = 0.3 * np.sin(2 * np.pi * 1.5 * true)
    f = np.stack([np.sin(9 * true), np.cos(7 * true), 9.8 + 0 * true], axis=1)
    f += rng.normal(0, 1e-2, f.shape)
    return (
        Recording((JointStream("j", stamps, q), JointStream("k", stamps, 2 * q)),
                  (SuStream("su", stamps, f, "/su"),), start=1.7e9),
        true,
    )  # fmt: skip


def test_noisy_stamps_of_regular_samples_are_made_regular() -> None:
    recording, true = _noisy(0)
    found = retimed(recording)
    for stream in (*found.joints, *found.sus):
        error = stream.time - true
        assert np.std(error) < 3e-5
    assert np.array_equal(found.joints[0].time, found.joints[1].time)
    assert found.joints[0].stamp_noise == pytest.approx(2e-4, rel=0.1)


def test_times_are_those_of_the_same_recording_in_a_file(tmp_path) -> None:
    recording, _ = _noisy(1)
    path = tmp_path / "log.mcap"
    write(recording, path)
    there = read(path)
    here = retimed(recording)
    offset = there.start - recording.start
    for a, b in zip((*here.joints, *here.sus), (*there.joints, *there.sus), strict=True):
        assert a.time == pytest.approx(b.time + offset, abs=2e-6)
    for j, k in zip(here.joints, there.joints, strict=True):
        assert k.stamp_noise == pytest.approx(j.stamp_noise, rel=0.01)


def test_exact_times_stay_as_they_are() -> None:
    recording, true = _noisy(2)
    exact = replace(recording, joints=tuple(replace(j, time=true) for j in recording.joints))
    found = retimed(exact).joints[0]
    assert found.time == pytest.approx(true, abs=1e-8)
    assert found.stamp_noise < 1e-8


def test_what_is_regular_already_keeps_the_noise_of_its_stamps() -> None:
    once = retimed(_noisy(3)[0])
    twice = retimed(once)
    assert twice.joints[0].stamp_noise == once.joints[0].stamp_noise > 1e-4
    assert np.array_equal(twice.joints[0].time, once.joints[0].time)


def test_calibrations_take_no_stamps_for_times(tmp_path) -> None:
    """Stamps of joints that scatter make positions that are off, and lengths with them."""
    recording, _ = _noisy(4)
    path = tmp_path / "log.mcap"
    write(recording, path)
    here, there = recordings_of([recording, read(path)], lambda _: None)
    for a, b in zip(here.joints, there.joints, strict=True):
        assert a.time - a.time[0] == pytest.approx(b.time - b.time[0], abs=2e-6)
        assert a.stamp_noise == pytest.approx(b.stamp_noise, rel=0.01)
