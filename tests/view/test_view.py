"""The viewer: robots that move with their joints, in a real browser and for this machine alone."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from calibrated import calibration, simulation
from chromium import needs_chromium, opened, resize
from random_robots import Joint, robot_of

from skin2urdf.cli.main import main
from skin2urdf.output import save
from skin2urdf.recording.records import JointStream
from skin2urdf.scene.robot import BASE, along_axes
from skin2urdf.urdf.loading import load_robot
from skin2urdf.view import viewer
from skin2urdf.view.actors import Play, load_play
from skin2urdf.view.recorded import Motion
from skin2urdf.view.viewer import HOST, Viewer


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Play:
    """A calibration beside the truth."""
    folder = tmp_path_factory.mktemp("view")
    urdf, _ = save(calibration(), folder / "robot.urdf")
    truth = folder / "truth.urdf"
    truth.write_text(simulation().truth.urdf)
    return load_play(urdf, truth)


@pytest.fixture(scope="module")
def shown(play: Play) -> Iterator[Viewer]:
    """The same in a viewer, with a log in which all joints go from 0.1 to 0.3 in two seconds."""
    time = np.array([0.0, 2.0])
    joints = tuple(JointStream(name, time, np.array([0.1, 0.3])) for name in play.limits)
    running = Viewer(play, Motion(joints, 2.0), port=8391)
    yield running
    running.stop()


def test_both_robots_stand_on_each_other_in_any_configuration(play: Play) -> None:
    assert play.second is not None
    rng = np.random.default_rng(0)
    known = [name for name, lines in play.about.items() if "determined" in lines]
    assert known
    for _ in range(5):
        q = {name: rng.uniform(low, high) for name, (low, high) in play.limits.items()}
        first, second = play.first.frames(q), play.second.frames(q)
        for name in known:
            joint, mesh = play.first.sus[name]
            on, other = play.second.sus[name]
            here = mesh.moved(first[joint]).vertices.mean(axis=0)
            there = other.moved(second[on]).vertices.mean(axis=0)
            assert np.linalg.norm(here - there) < 3e-3


def test_sliders_have_the_ranges_that_the_log_saw(play: Play) -> None:
    for name, seen in zip(calibration().model.tree.joint_names, calibration().limits, strict=True):
        assert play.limits[name] == pytest.approx(tuple(seen), abs=1e-6)


def test_an_su_tells_where_it_sits_and_how_well_that_is_known(play: Play) -> None:
    for lines in play.about.values():
        assert lines[0].startswith("on ")
    said = [line for lines in play.about.values() for line in lines]
    assert any(re.search(r"[0-9.]+ mm, [0-9.]+ deg rms$", line) for line in said)


def test_any_urdf_can_be_shown_without_json_and_limits(tmp_path: Path) -> None:
    plain = tmp_path / "plain.urdf"
    plain.write_text(
        '<robot name="a"><link name="b"/><link name="c/d"/><joint name="j/k" type="continuous">'
        '<parent link="b"/><child link="c/d"/><axis xyz="1 0 0"/></joint></robot>'
    )
    play = load_play(plain)
    low, high = play.limits["j/k"]
    assert low < 0 < high
    assert set(play.first.frames({"j/k": 1.0})) == {BASE, "j/k"}


def test_a_log_plays_and_begins_anew(shown: Viewer) -> None:
    shown.tick(1.0)
    assert list(shown.positions.values()) == pytest.approx([0.2] * 6)
    shown.tick(0.5)
    assert list(shown.positions.values()) == pytest.approx([0.25] * 6)
    shown.tick(1.0)
    assert list(shown.positions.values()) == pytest.approx([0.1] * 6)


def test_joints_go_where_they_are_sent(shown: Viewer, play: Play) -> None:
    first = next(iter(play.limits))
    shown.move({first: -0.3, "no such joint": 1.0})
    assert shown.positions[first] == -0.3
    assert set(shown.positions) == set(play.limits)


def test_it_listens_on_this_machine_alone(shown: Viewer) -> None:
    assert shown.address.startswith(f"http://{HOST}:")
    assert HOST == "127.0.0.1"
    port = int(shown.address.rpartition(":")[2])
    with socket.create_connection((HOST, port), timeout=5):
        pass
    own = socket.gethostbyname(socket.gethostname())
    if not own.startswith("127."):
        with pytest.raises(OSError):
            socket.create_connection((own, port), timeout=5)


@pytest.mark.parametrize(
    "words", [["no.urdf"], ["no.urdf", "--port", "70000"], ["no.urdf", "--port", "0"]]
)
def test_bad_usage_is_said(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", *words]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_a_missing_library_is_named_with_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(viewer, "find_spec", lambda _: None)
    assert main(["view", "robot.urdf"]) == 2
    assert "skin2urdf[view]" in capsys.readouterr().err


@needs_chromium
def test_a_browser_shows_it_without_an_error_and_asks_nobody_else(
    shown: Viewer, play: Play, tmp_path: Path
) -> None:
    with opened(shown.address, height=500) as tab:
        tab.wait_for("document.querySelector('canvas') !== null")
        for width in (1280, 400):
            resize(tab, width, 500)
            words = "document.body.innerText"
            tab.wait_for(f"{list(play.limits)}.every(name => {words}.includes(name))")
            tab.wait_for(f"document.documentElement.scrollWidth <= {width}")
            assert len(tab.screenshot(tmp_path / "view.png")) > 10_000
        shown.choose(next(iter(play.about)))
        tab.wait_for("document.querySelector('textarea').value.includes('\\non ')")
        assert not tab.errors
        asked = [re.sub(r"^(\w+:(//[^/]*)?).*", r"\1", address) for address in tab.requests]
        here = shown.address.removeprefix("http")
        assert set(asked) <= {"data:", "blob:", f"http{here}", f"ws{here}"}


def test_the_axis_of_a_single_joint_is_found(tmp_path: Path) -> None:
    spec = robot_of((Joint("alone", -1, "revolute", axis=(1.0, 0.0, 0.0)),), tmp_path)
    (T,) = along_axes(load_robot(spec.urdf), {"alone": np.eye(4)}).values()
    np.testing.assert_allclose(T[:3, 2], [1.0, 0.0, 0.0], atol=1e-12)
