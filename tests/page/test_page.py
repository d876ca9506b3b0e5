"""The page of a calibration: whole, alone, safe, and readable in a real browser."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrated import calibration, simulation
from chromium import Tab, needs_chromium, opened, resize

from skin2urdf.cli.main import main
from skin2urdf.output import save
from skin2urdf.page import html
from skin2urdf.page.advice import advice
from skin2urdf.page.contents import Contents, load_contents
from skin2urdf.page.fit_figures import activity_figure
from skin2urdf.page.html import as_page
from skin2urdf.page.robot_figure import robot_figure
from skin2urdf.recording.reading import read
from skin2urdf.recording.writing import write
from skin2urdf.replay import replay, traces_of
from skin2urdf.scene.overlay import alongside

HOSTILE = "</script><script>window.stolen=1</script><img src=http://evil.test/x onerror=alert(1)>&"


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration as it is written."""
    path, _ = save(calibration(), tmp_path_factory.mktemp("page") / "robot.urdf")
    return path


@pytest.fixture(scope="module")
def contents(urdf: Path) -> Contents:
    """What its page shows, with the truth laid over it and the readings of the fit."""
    truth = urdf.with_name("truth.urdf")
    truth.write_text(simulation().truth.urdf)
    return replace(load_contents(urdf, other=truth), traces=traces_of(calibration().along))


@pytest.fixture(scope="module")
def page(contents: Contents) -> str:
    return as_page(contents)


def renamed(value: Any, names: dict[str, str]) -> Any:
    """A document with other names, as keys and as values."""
    if isinstance(value, dict):
        return {names.get(k, k): renamed(v, names) for k, v in value.items()}
    if isinstance(value, list):
        return [renamed(item, names) for item in value]
    return names.get(value, value) if isinstance(value, str) else value


@cache
def hostile(urdf: Path) -> str:
    """The page of a robot whose SUs, notes and logs are named to act on a browser."""
    whole = load_contents(urdf)
    names = {su: f"{HOSTILE}{i}" for i, su in enumerate([*whole.document["sus"]][:2])}
    document = renamed(json.loads(json.dumps(whole.document)), names)
    document["notes"] = [HOSTILE]
    document["inputs"][0]["path"] = HOSTILE
    traces = tuple(replace(t, su=names.get(t.su, t.su)) for t in traces_of(calibration().along))
    return as_page(replace(whole, document=document, traces=traces))


class Elements(HTMLParser):
    """Names of all elements of a page, and all attributes that may fetch or run something."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: list[str] = []
        self.acting: list[tuple[str, str | None]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note one."""
        self.names.append(tag)
        self.acting += [
            (name, value)
            for name, value in attrs
            if name in {"src", "srcset", "href", "action", "data"} or name.startswith("on")
        ]


def test_a_page_refers_to_nothing_outside_of_itself(page: str) -> None:
    found = Elements(page)
    assert found.names.count("script") == 3
    assert all(v and v.startswith(("#", "data:")) for _, v in found.acting)
    assert "default-src 'none'" in page


def test_the_verdict_is_the_first_that_is_said(page: str) -> None:
    words = calibration().quality
    body = page[page.index("<body>") :]
    assert body.index(f"<strong>{words}</strong>") < body.index("<h2")


def test_names_of_all_joints_sus_and_what_is_not_known_are_there(
    page: str, contents: Contents
) -> None:
    document = contents.document
    for name in (*document["joints"], *document["sus"]):
        assert f">{name}<" in page
    for words in document["observability"]["sus"].values():
        assert all(each["what"] in page for each in words["words"])


def test_the_same_contents_give_the_same_page(page: str, contents: Contents) -> None:
    assert as_page(contents) == page


def test_names_from_logs_add_no_elements(urdf: Path, page: str) -> None:
    bad = Elements(hostile(urdf))
    assert set(bad.names) == set(Elements(page).names)
    assert bad.names.count("script") == 3
    assert all(v and v.startswith(("#", "data:")) for _, v in bad.acting)


def test_ellipsoids_are_as_large_as_said(contents: Contents) -> None:
    figure, times = robot_figure(contents)
    (mesh,) = [t for t in figure.data if t.name.startswith("SU: 1 sd")]
    name, su = next(
        (n, su) for n, su in contents.document["sus"].items() if su["verdict"] == "determined"
    )
    center = contents.frames()[name][:3, 3]
    largest = np.sqrt(np.linalg.eigvalsh(np.array(su["covariance"])[:3, :3]).max())
    vertices = np.stack([mesh.x, mesh.y, mesh.z], axis=1)
    own = np.linalg.norm(vertices - center, axis=1)
    assert own[own < 1.5 * times * largest].max() == pytest.approx(times * largest, rel=0.1)


def test_names_of_all_sus_lie_in_the_box_and_before_their_sus(contents: Contents) -> None:
    figure, _ = robot_figure(contents)
    (names,) = [t for t in figure.data if getattr(t, "mode", "") == "text"]
    assert len(names.text) == len(contents.document["sus"])
    at = np.stack([names.x, names.y, names.z], axis=1)
    scene = figure.layout.scene
    box = np.array([scene[f"{axis}axis"].range for axis in "xyz"])
    assert (box[:, 0] < at).all()
    assert (at < box[:, 1]).all()
    eye = np.array([scene.camera.eye[axis] for axis in "xyz"])
    sus = np.array([contents.frames()[name][:3, 3] for name in contents.document["sus"]])
    assert ((at - sus) @ eye > 0).all()


def test_the_estimate_lies_on_the_truth(contents: Contents) -> None:
    assert contents.other is not None
    frames = contents.frames()
    known = [n for n, su in contents.document["sus"].items() if su["verdict"] == "determined"]
    shown = alongside(contents.other.robot, contents.positions, frames)
    sus = {name: T @ su for part, T in shown for name, su in part.sus.items()}
    assert known
    for name in known:
        assert np.linalg.norm(sus[name][:3, 3] - frames[name][:3, 3]) < 2e-3
    for part, T in shown:
        if part.joint in contents.document["joints"]:
            assert np.linalg.norm(T[:3, 3] - frames[part.joint][:3, 3]) < 2e-3


def test_a_log_read_again_is_predicted_as_in_the_fit(urdf: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    write(simulation().recording, log)
    document = json.loads(urdf.with_suffix(".json").read_text())
    document["inputs"][0]["digest"] = read(log).digest
    fitted = {trace.su: trace for trace in traces_of(calibration().along)}
    _, again = replay(log, document)
    assert {trace.su for trace in again} == set(fitted)
    for trace in again:
        # Stamps that are read from a file are smoothed, those of a recording in memory are not.
        assert 0 < trace.rms < 1.1 * fitted[trace.su].rms
        assert np.abs(trace.reading - trace.predicted).max() < 0.2


def test_a_foreign_log_is_refused(urdf: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    write(simulation().recording, log)
    assert main(["report", str(urdf), "--log", str(log), "-o", str(tmp_path / "a.html")]) == 2
    assert not (tmp_path / "a.html").exists()


def test_names_of_joints_have_room_above_who_moves_with_whom(contents: Contents) -> None:
    long = {name: name + "_of_a_very_long_name" * 3 for name in contents.document["joints"]}
    figure = activity_figure(renamed(contents.document, long))
    # A letter of 12 px is about 7 px wide.
    assert figure.layout.margin.t > 7 * max(map(len, long.values()))
    assert figure.layout.height > figure.layout.margin.t + figure.layout.margin.b


def test_advice_names_each_remedy_once(contents: Contents) -> None:
    found = advice(contents.document)
    assert len({each.remedy for each in found}) == len(found)
    told = [words for each in found for words in each.learns]
    asked = [
        words
        for su in contents.document["observability"]["sus"].values()
        for words in su["words"]
        if words["remedy"]
    ]
    assert asked
    assert {f"{words['what']}: {words['why']}" for words in asked} <= set(told)
    assert len(set(told)) == len(told)


def test_poses_that_features_do_not_predict_ask_for_no_more_poses(contents: Contents) -> None:
    """A robot with more than rigid links is judged by all samples, however many poses it has."""

    def asked(*, of_features: bool) -> set[str]:
        goodness = {**contents.document["goodness"], "prediction": None}
        goodness["of_features"] = of_features
        return {each.remedy for each in advice({**contents.document, "goodness": goodness})}

    known = {each.remedy for each in advice(contents.document)}
    assert asked(of_features=False) == known
    assert len(asked(of_features=True) - known) == 1


def test_the_command_writes_a_page_beside_the_urdf(
    urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(urdf)]) == 0
    assert "robot.html" in capsys.readouterr().out
    assert urdf.with_suffix(".html").read_text().startswith("<!doctype html>")


@pytest.mark.parametrize("output", ["robot.pdf", "robot.urdf", "no/such/folder/robot.html"])
def test_no_page_is_written_where_none_can_be(
    urdf: Path, output: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = urdf.read_bytes()
    assert main(["report", str(urdf), "-o", str(urdf.parent / output)]) == 2
    assert capsys.readouterr().err.startswith("error: ")
    assert urdf.read_bytes() == before


def test_without_the_json_or_with_another_the_command_says_so(
    urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = tmp_path / "alone.urdf"
    alone.write_bytes(urdf.read_bytes())
    assert main(["report", str(alone)]) == 2
    document = json.loads(urdf.with_suffix(".json").read_text())
    del document["goodness"]
    alone.with_suffix(".json").write_text(json.dumps(document))
    assert main(["report", str(alone)]) == 2
    assert capsys.readouterr().err.count("error: ") == 2
    assert not alone.with_suffix(".html").exists()


def test_a_missing_library_is_named_with_how_to_get_it(
    urdf: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(html, "find_spec", lambda name: None if name == "plotly" else object())
    assert main(["report", str(urdf)]) == 2
    told = capsys.readouterr().err
    assert "plotly" in told
    assert "skin2urdf[report]" in told


_WHOLE = """document.getElementById('robot').data?.every(
    trace => trace.visible === true || trace.visible === undefined
             || trace.name === 'names of joints')"""


def drawn(tab: Tab) -> None:
    """Bring everything into sight and wait for it; for the robot, until it is drawn in 3D."""
    ready = "e => e.querySelector(e.id === 'robot' ? 'canvas' : '.main-svg') !== null"
    tab.wait_for("document.readyState === 'complete'")
    for name in tab.run("[...document.querySelectorAll('.plot')].map(e => e.id)"):
        tab.run(f"document.getElementById('{name}').scrollIntoView()")
        tab.wait_for(f"({ready})(document.getElementById('{name}'))")
    tab.wait_for(_WHOLE)


@needs_chromium
def test_the_page_renders_without_an_error_and_asks_for_nothing(page: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.html"
    file.write_text(page)
    with opened(file.as_uri()) as tab:
        for width in (1280, 400):
            resize(tab, width)
            drawn(tab)
            tab.wait_for(f"document.documentElement.scrollWidth <= {width}")
            assert len(tab.screenshot(tmp_path / "page.png")) > 10_000
        assert tab.run("document.querySelectorAll('#su option').length") > 0
        assert not tab.errors
        assert {re.sub(":.*", "", address) for address in tab.requests} <= {"file", "data", "blob"}


@needs_chromium
def test_what_is_out_of_sight_is_drawn_at_once_for_a_printer(page: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.html"
    file.write_text(page)
    with opened(file.as_uri(), height=60) as tab:
        tab.wait_for("document.readyState === 'complete'")
        figures = "[...document.querySelectorAll('.plot')]"
        assert not tab.run(f"{figures}.some(e => e.querySelector('.main-svg'))")
        tab.run("window.dispatchEvent(new Event('beforeprint'))")
        assert tab.run(f"{figures}.every(e => e.querySelector('.main-svg'))")
        assert tab.run(_WHOLE)
        assert not tab.errors


@needs_chromium
def test_names_that_act_on_a_browser_do_nothing(urdf: Path, tmp_path: Path) -> None:
    file = tmp_path / "robot.html"
    file.write_text(hostile(urdf))
    with opened(file.as_uri()) as tab:
        drawn(tab)
        assert tab.run("window.stolen === undefined")
        assert tab.run("document.querySelectorAll('img').length") == 0
        assert not tab.errors
        assert {re.sub(":.*", "", address) for address in tab.requests} <= {"file", "data", "blob"}
