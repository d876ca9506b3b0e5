"""Outputs that are closed or full, paths that can not be, names that would act on a terminal."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from simulated import changed_sus, simulation

from skin2urdf.cli.main import main
from skin2urdf.recording.records import SuStream
from skin2urdf.recording.writing import write
from skin2urdf.urdf.loading import load_robot

LONG = "x" * 300


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_said_in_one_sentence() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "skin2urdf", "simulate", "--list"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 2


def test_a_closed_output_is_no_error() -> None:
    done = subprocess.run(  # noqa: S603 - our own words
        ["/bin/sh", "-c", f"exec {sys.executable} -m skin2urdf simulate --list >&-"],
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    "words",
    [
        ["info", f"{LONG}.mcap"],
        ["explore", f"{LONG}.mcap"],
        ["calibrate", f"{LONG}.mcap", "-o", "a.urdf"],
        ["calibrate", "log.mcap", "-o", f"{LONG}.urdf"],
        ["simulate", "ur3", "-o", f"{LONG}.mcap"],
        ["simulate", f"{LONG}.urdf", "-o", "log.mcap"],
        ["compare", f"{LONG}.urdf", f"{LONG}.urdf"],
    ],
    ids=lambda words: words[0],
)
def test_names_no_disk_holds_are_errors_in_words(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("error: ")


def test_names_that_act_on_a_terminal_or_are_taken_end_in_a_urdf(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = simulation(
        "ur3", n_poses=3, excite="all", seed=3, imu_rate=250.0, joint_rate=125.0
    ).recording
    first, second, *others = recording.joints
    joints = (replace(first, name="universe"), replace(second, name="a\x1b[31m\nerror: b"), *others)
    last = recording.sus[-1].name

    def renamed(su: SuStream) -> SuStream:
        name = "su\x9b" if su.name == last else su.name
        return replace(su, name=name, topic=f"/{su.name}\x1b")

    sus = changed_sus(recording, renamed)
    log, urdf = tmp_path / "log.mcap", tmp_path / "robot.urdf"
    write(replace(sus, joints=joints), log)
    assert main(["calibrate", str(log), "-o", str(urdf), "--motion", "patterns"]) == 0
    told = capsys.readouterr()
    assert all(line.isprintable() for line in (told.out + told.err).splitlines())
    assert "'universe_joint'" in told.out
    names = set(load_robot(urdf).model.names)
    assert {"universe_joint", "a\\x1b[31m\\nerror: b"} <= names
