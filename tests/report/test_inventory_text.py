"""What `info` says of whole logs and of logs that lack something."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated import simulation

from skin2urdf.recording.records import JointStream, Recording
from skin2urdf.recording.writing import write
from skin2urdf.report.inventory import as_document, as_text
from skin2urdf.report.plain import dumps
from skin2urdf.survey import explore, survey


def written(path: Path, recording: Recording) -> Path:
    write(recording, path)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("log") / "whole.mcap", simulation().recording)


def changed(**parts: object) -> Recording:
    return replace(simulation().recording, **parts)  # type: ignore[arg-type]


def test_a_whole_log(log: Path) -> None:
    seen = survey(log)
    text, document = as_text(seen), as_document(seen)
    assert json.loads(dumps(document)) == document
    recording = simulation().recording
    assert list(document["joints"]) == [j.name for j in recording.joints]
    assert list(document["sus"]) == [s.name for s in recording.sus]
    for joint in document["joints"].values():
        assert joint["rate"] == pytest.approx(125, rel=0.05)
        assert joint["patterns"] == 3
        assert joint["structural_moves"] >= 1
    assert document["poses_with_pattern"] == 3
    assert [(problem.kind, problem.number) for problem in seen.problems] == [("few poses", 3)]
    assert document["missing"] == [problem.words for problem in seen.problems]
    for name in (*document["joints"], *document["sus"], "/joint_states", "sensor_msgs/msg/Imu"):
        assert name in text


def test_a_joint_that_never_moves(tmp_path: Path) -> None:
    recording = simulation().recording
    first = recording.joints[0]
    still = JointStream(first.name, first.time, np.full_like(first.position, 0.3))
    log = written(tmp_path / "log.mcap", changed(joints=(still, *recording.joints[1:])))
    still = [problem.name for problem in survey(log).problems if problem.kind == "still joint"]
    assert still == [first.name]


@pytest.mark.parametrize(
    ("parts", "lacks"),
    [({"sus": ()}, "Imu"), ({"joints": ()}, "JointState")],
    ids=["no SUs", "no joints"],
)
def test_a_log_that_lacks_topics(tmp_path: Path, parts: dict[str, object], lacks: str) -> None:
    seen = survey(written(tmp_path / "log.mcap", changed(**parts)))
    assert seen.recording is None
    text = as_text(seen)
    (problem,) = seen.obstacles
    assert (problem.kind, seen.problems) == ("refused", seen.obstacles)
    assert lacks in problem.words
    assert problem.words in text.replace("\n    ", " ")
    assert json.loads(dumps(as_document(seen)))["missing"] == [problem.words]


def test_a_robot_that_never_rests(tmp_path: Path) -> None:
    recording = simulation().recording
    restless = tuple(
        JointStream(j.name, j.time, np.sin(3.0 * j.time + i))
        for i, j in enumerate(recording.joints)
    )
    seen = survey(written(tmp_path / "log.mcap", changed(joints=restless)))
    assert seen.sampled is not None
    assert seen.sampled.at_rest == ()
    assert seen.obstacles == ()
    assert "no patterns" in [problem.kind for problem in seen.problems]
    assert as_document(seen)["rests"] == 0


def test_exploring_finds_the_tree_without_estimating(log: Path) -> None:
    stages = []
    explored = explore([log], progress=lambda stage, share: stages.append((stage, share)))
    assert explored.tree is not None
    assert explored.tree.joint_names == simulation().truth.joint_names
    assert stages[-1] == ("structure", 1.0)
