from __future__ import annotations

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from skin2urdf.errors import UsageError
from skin2urdf.paper.exploration import Exploration, explore
from skin2urdf.report import figures
from skin2urdf.report.canvas import Canvas, text_width
from skin2urdf.report.figures import draw_exploration
from skin2urdf.report.labels import numbers, shortened, wrapped

SVG = "{http://www.w3.org/2000/svg}"


def arm(n: int) -> Exploration:
    return explore(
        np.tri(n + 1, n, -1, dtype=bool)[::-1],
        [f"su_{u:04x}" for u in range(n + 1)],
        [f"arm_{d + 1}_joint" for d in range(n)],
    )


def humanoid(fingers: int) -> Exploration:
    """Two arms and two legs of a three-DoF, a one-DoF and a two-DoF joint; fingers on the arms."""
    names: list[str] = []
    rows: list[list[int]] = [[], []]

    def chain(limb: str, joints: tuple[int, ...], base: list[int]) -> list[int]:
        moved = list(base)
        for joint, n in enumerate(joints):
            for k in range(n):
                moved.append(len(names))
                names.append(f"{limb}_{joint}_{k}_joint")
            rows.extend([list(moved)] * (2 - joint % 2))
        return moved

    for side in ("left", "right"):
        chain(f"{side}_leg", (3, 1, 2), [])
        palm = chain(f"{side}_arm", (3, 1, 2), [])
        for finger in range(fingers):
            chain(f"{side}_finger{finger}", (1, 2), palm)
    activity = np.array([[d in row for d in range(len(names))] for row in rows])
    activity = activity[np.random.default_rng(0).permutation(len(rows))]
    return explore(activity, [f"su_{u:04x}" for u in range(len(rows))], names)


def loop() -> Exploration:
    rows = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], dtype=bool)
    return explore(rows, ["a", "b", "c", "d"], ["x", "y"])


def bare() -> Exploration:
    rows = np.array([[1, 1, 0, 0, 0], [1, 0, 1, 0, 0], [0, 0, 0, 1, 0]], dtype=bool)
    return explore(rows, ["a", "b", "c"], ["v", "w", "x", "y", "z"])


CASES = {"arm": arm(10), "humanoid": humanoid(4), "loop": loop(), "bare": bare()}


@pytest.fixture(params=CASES)
def exploration(request: pytest.FixtureRequest) -> Exploration:
    return CASES[request.param]


@pytest.fixture
def texts(
    exploration: Exploration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[tuple[float, float], list[tuple[str, float, float, float, float]]]:
    """Size of the page, and each text with the left, top, right and bottom of its place [in]."""
    artists: list[Any] = []
    original = Canvas.text

    def text(self: Canvas, at: tuple[float, float], text: str, size: float, **how: Any) -> None:
        original(self, at, text, size, **how)
        artists.append(self._axes.texts[-1])

    monkeypatch.setattr(Canvas, "text", text)
    draw_exploration(exploration, tmp_path / "figure.svg")
    figure = artists[0].figure
    renderer = FigureCanvasAgg(figure).get_renderer()
    width, height = figure.get_size_inches()
    placed = []
    for artist in artists:
        (left, bottom), (right, top) = artist.get_window_extent(renderer).get_points() / figure.dpi
        if artist.get_text():
            placed.append((artist.get_text(), left, height - top, right, height - bottom))
    return (width, height), placed


def test_no_text_overlaps_another_or_leaves_the_page(
    texts: tuple[tuple[float, float], list[tuple[str, float, float, float, float]]],
) -> None:
    (width, height), placed = texts
    boxes = np.array([box for _, *box in placed])
    assert boxes[:, :2].min() >= 0
    assert (boxes[:, 2:] <= [width, height]).all()
    shrunk = boxes + np.array([1, 1, -1, -1]) * 0.005
    for k in range(len(placed) - 1):
        rest = shrunk[k + 1 :]
        apart = (
            (rest[:, 0] >= shrunk[k, 2])
            | (rest[:, 2] <= shrunk[k, 0])
            | (rest[:, 1] >= shrunk[k, 3])
            | (rest[:, 3] <= shrunk[k, 1])
        )
        clash = [placed[k + 1 + int(i)][0] for i in np.flatnonzero(~apart)]
        assert not clash, f"{placed[k][0]} overlaps {clash}"


def test_everything_is_named(
    exploration: Exploration,
    texts: tuple[tuple[float, float], list[tuple[str, float, float, float, float]]],
) -> None:
    written = [text for text, *_ in texts[1]]
    assert {*exploration.su_names, *exploration.dof_names} <= set(written)
    if exploration.is_tree:
        for n, dofs in enumerate(exploration.joints):
            # Above the sorted and the merged matrix, below the raw one, and in the tree.
            assert written.count(f"J{n + 1}") == 3 + len(dofs)
            assert all(written.count(exploration.dof_names[d]) == 2 for d in dofs)
        for sus in exploration.segments:
            assert all(written.count(exploration.su_names[u]) == 2 for u in sus)
    else:
        assert not any("Kinematic tree" in text for text in written)
    words = " ".join(written).lower()
    for violation in exploration.violations:
        assert violation.words.lower() in words
        assert violation.remedy.lower() in words


def test_the_svg_is_whole_and_the_same_every_time(exploration: Exploration, tmp_path: Path) -> None:
    first, second = tmp_path / "first.svg", tmp_path / "second.svg"
    draw_exploration(exploration, first)
    draw_exploration(exploration, str(second))
    assert first.read_bytes() == second.read_bytes()
    assert ET.parse(first).getroot().tag == f"{SVG}svg"  # noqa: S314
    assert not re.search(r"<dc:date>|20\d\d-\d\d-\d\d", first.read_text())


def test_text_in_an_svg_can_be_read_and_searched(exploration: Exploration, tmp_path: Path) -> None:
    draw_exploration(exploration, tmp_path / "figure.svg")
    root = ET.parse(tmp_path / "figure.svg").getroot()  # noqa: S314
    written = {element.text for element in root.iter(f"{SVG}text")}
    assert {*exploration.su_names, *exploration.dof_names} <= written


def test_another_process_draws_the_same(tmp_path: Path) -> None:
    here, there = tmp_path / "here.svg", tmp_path / "there.svg"
    draw_exploration(loop(), here)
    code = (
        "import numpy as np, sys\n"
        "from skin2urdf.report.figures import draw_exploration\n"
        "from skin2urdf.paper.exploration import explore\n"
        "rows = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], dtype=bool)\n"
        "draw_exploration(explore(rows, list('abcd'), list('xy')), sys.argv[1])\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code, str(there)], check=True)  # noqa: S603
    assert here.read_bytes() == there.read_bytes()


@pytest.mark.parametrize(("ending", "start"), [("png", b"\x89PNG"), ("PDF", b"%PDF-")])
def test_other_formats_go_by_the_ending(tmp_path: Path, ending: str, start: bytes) -> None:
    path = tmp_path / f"figure.{ending}"
    draw_exploration(arm(3), path)
    assert path.read_bytes().startswith(start)


def test_a_path_that_can_not_be_drawn_to(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\.jpeg"):
        draw_exploration(arm(2), tmp_path / "figure.jpeg")
    with pytest.raises(UsageError, match="nowhere"):
        draw_exploration(arm(2), tmp_path / "nowhere" / "figure.svg")


def test_importing_figures_does_not_load_matplotlib() -> None:
    code = f"import sys, {figures.__name__}; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)  # noqa: S603


@pytest.mark.parametrize(
    ("indices", "words"),
    [
        ((), ""),
        ((0,), "1"),
        ((0, 1, 4), "1, 2, 5"),
        ((1, 2, 3, 7, 8, 9), "2\N{EN DASH}4, 8\N{EN DASH}10"),
    ],
)
def test_numbers(indices: tuple[int, ...], words: str) -> None:
    assert numbers(indices) == words


def test_long_lists_are_cut_short_with_a_count() -> None:
    assert numbers((0, 2, 4, 6, 7, 8), limit=2) == "1, 3, + 4 more"
    assert shortened(["a", "b", "c"], 3) == ["a", "b", "c"]
    assert shortened(["a", "b", "c", "d"], 3) == ["a", "b", "+ 2 more"]


def test_wrapped_lines_fit_and_keep_all_words() -> None:
    text = "a segment that hangs on more than one joint " * 5
    lines = wrapped(text, 8.0, 2.0)
    assert len(lines) > 3
    assert all(text_width(line, 8.0) <= 2.0 for line in lines)
    assert " ".join(lines).split() == text.split()
    assert wrapped("unbreakable", 8.0, 0.1) == ["unbreakable"]
