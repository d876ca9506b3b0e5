"""The batch validation: figures of a run, what falls short, the tables."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import validate
from batch.records import Record
from scipy.spatial.transform import Rotation
from validation.cases import Case, Circumstance, robots_named
from validation.measure import perform, sensor_rotations
from validation.records import Figures, Over, Run
from validation.summary import grouped, shortfalls
from validation.table import report

from skin2urdf.errors import UsageError

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = ROOT / "scripts"
SMALL = ("--robots", "so101", "--poses", "6", "--jobs", "0")


def run(*arguments: str | Path) -> int:
    return int(validate.main([str(argument) for argument in arguments]))


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one run leaves."""
    path = tmp_path_factory.mktemp("runs") / "deep" / "runs.jsonl"
    assert run(*SMALL, "--output", path) == 0
    return path


@pytest.fixture
def runs(output: Path, tmp_path: Path) -> Path:
    """The same in a file of one's own."""
    path = tmp_path / "runs.jsonl"
    path.write_bytes(output.read_bytes())
    return path


def made(**figures: Any) -> Run:
    """A run with the given figures, good ones where none are given."""

    def over(position: float, bound: float) -> Over:
        return Over(5, position, bound, 0.01, 0.01, 0.01, 0.01)

    seed, circumstance = figures.pop("seed", 0), figures.pop("circumstance", Circumstance())
    position, bound = figures.pop("position_mm", 0.1), figures.pop("bound_mm", 0.1)
    good: dict[str, Any] = {
        "tree_right": True, "tree_differences": (), "types_right": True, "cost_per_dof": 1.0,
        "n_dofs": 5, "n_poses": 12, "hypotheses": (1.0,), "axis_angle_deg": 0.01,
        "axis_distance_mm": 0.1, "determined": over(position, bound),
        "every": over(position, bound), "sus": (), "n_open": 0, "joint_verdicts": {},
        "seconds": {"simulate": 9.0, "features": 1.0}, "notes": (),
    }  # fmt: skip
    return Record(Case("so101", seed, circumstance), Figures(**(good | figures)))


def test_a_run_is_one_line_with_its_key_and_figures(output: Path) -> None:
    (line,) = lines_of(output)
    words = ["so101", "mems", "tilted", "one", "6poses", "17bit", "servo", "seed0"]
    assert line["key"].split() == words
    figures = line["figures"]
    assert figures["tree_right"]
    assert figures["types_right"]
    assert figures["cost_per_dof"] < 2.0
    assert 0.0 < figures["determined"]["position_mm"] < 0.5
    assert 0.0 < figures["determined"]["orientation_deg"] < 0.05
    assert figures["n_dofs"] == 5
    assert {"simulate", "features", "estimation", "compare"} <= set(figures["seconds"])


def test_figures_over_sus_are_those_of_the_sus(output: Path) -> None:
    (line,) = lines_of(output)
    sus = [su for su in line["figures"]["sus"] if su["verdict"] == "determined"]
    assert len(sus) == line["figures"]["determined"]["n"] >= 3
    for name in ("position_mm", "position_bound_mm"):
        mean_square = np.mean([su[name] ** 2 for su in sus])
        assert line["figures"]["determined"][name] ** 2 == pytest.approx(mean_square)


def test_errors_and_bounds_are_of_one_size(output: Path) -> None:
    (line,) = lines_of(output)
    over = line["figures"]["determined"]
    assert 0.2 < over["position_mm"] / over["position_bound_mm"] < 3.0
    assert 0.2 < over["orientation_deg"] / over["orientation_bound_deg"] < 3.0


def test_a_robot_that_can_not_be_read_is_a_line_and_not_the_end(tmp_path: Path) -> None:
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot name='nothing'/>", encoding="utf-8")
    path = tmp_path / "runs.jsonl"
    assert run("--robots", broken, "--recordings", "2", "--jobs", "0", "--output", path) == 1
    lines = lines_of(path)
    assert [line["case"]["seed"] for line in lines] == [0, 1]
    assert all("UnreadableInputError" in line["failure"]["kind"] for line in lines)


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ({}, []),
        ({"tree_right": False, "tree_differences": ("joint x",)}, ["joint x"]),
        ({"cost_per_dof": 2.5}, ["2.5"]),
        ({"cost_per_dof": None}, ["-"]),
        ({"position_mm": 0.6, "bound_mm": 0.5}, ["0.6 mm"]),
        ({"position_mm": 0.4, "bound_mm": 0.1}, ["4.0 times"]),
    ],
)
def test_shortfalls_are_named(figures: dict[str, Any], words: list[str]) -> None:
    found = shortfalls(made(**figures))
    assert len(found) == len(words)
    assert all(word in text for word, text in zip(words, found, strict=True))


def test_the_targets_hold_for_the_tilted_base_alone() -> None:
    bad: dict[str, Any] = {"position_mm": 0.6, "bound_mm": 0.5}
    assert shortfalls(made(**bad))
    assert not shortfalls(made(**bad, circumstance=Circumstance(posture="upright")))


def test_the_ratio_is_rms_over_rms_and_not_a_mean_of_ratios() -> None:
    runs = [
        made(seed=0, position_mm=3.0, bound_mm=1.0),
        made(seed=1, position_mm=4.0, bound_mm=7.0),
        made(seed=2, position_mm=99.0, bound_mm=1.0, tree_right=False),
    ]
    (group,) = grouped(runs, lambda run: (run.case.robot,))
    assert group.position_ratio == pytest.approx(math.sqrt((9 + 16) / (1 + 49)))
    assert group.position_mm == pytest.approx(math.sqrt((9 + 16) / 2))
    assert (group.n_runs, group.n_tree, group.n_converged) == (3, 2, 2)
    assert group.seconds == 1.0


def test_the_rotation_inside_a_sensor_is_found() -> None:
    Q = Rotation.from_rotvec([0.01, -0.02, 0.005]).as_matrix()
    S = np.array([[1.02, 0.004, 0.0], [0.004, 0.97, 0.002], [0.0, 0.002, 1.01]])
    np.testing.assert_allclose(sensor_rotations(np.array([S @ Q]))[0], Q, atol=1e-12)


def test_turning_the_truth_takes_the_floor_out() -> None:
    """What is left of the orientation's error is small beside the rotation inside the sensors."""
    over = perform(Case("so101", 1, Circumstance(grade="bma150", poses=6))).determined
    assert over.orientation_deg is not None
    assert over.orientation_beside_floor_deg is not None
    assert over.orientation_deg > 0.1
    assert over.orientation_beside_floor_deg < 0.3 * over.orientation_deg


def test_all_robots_and_urdfs_can_be_named() -> None:
    assert {"panda", "so101"} <= set(robots_named(["all"]))
    urdfs = robots_named(["urdfs"])
    assert len(urdfs) > 50
    assert Path(Case(urdfs[0], 0, Circumstance()).robot_or_path).is_file()
    for stub in ("ur3.urdf", "quadrotor_base.urdf", "iris_simple.urdf"):
        assert not any(name.endswith(f"/{stub}") for name in urdfs)
    with pytest.raises(UsageError, match="nobody"):
        robots_named(["nobody"])


def test_keys_tell_cases_apart() -> None:
    kinds = [
        Circumstance(), Circumstance(grade="ideal"), Circumstance(posture="upright"),
        Circumstance(excite="all"), Circumstance(poses=5), Circumstance(encoder_bits=None),
        Circumstance(tracking="soft"), Circumstance(refine="casadi"),
        Circumstance(through_mcap=True),
    ]  # fmt: skip
    cases = [Case(robot, seed, kind) for robot in "ab" for seed in (0, 1) for kind in kinds]
    assert len({case.key for case in cases}) == len(cases)


def test_the_report_shows_what_fell_short() -> None:
    text = report([made(seed=0), made(seed=1, tree_right=False, tree_differences=("leans",))])
    assert "2  1!  1!" in " ".join(text.split()).replace(" 1!", "  1!")
    (short,) = (line for line in text.splitlines() if "leans" in line)
    assert made(seed=1).case.key in short
    heads, row = text.splitlines()[1], text.splitlines()[3]
    assert heads.split()[:3] == ["DoFs", "SUs", "runs"]
    assert row.split("servo")[1].split()[:3] == ["5", "5", "2"]
    assert report([]) == "No runs.\n"


def test_the_plot_is_an_image(runs: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    image = tmp_path / "plots" / "runs.png"
    assert run("--output", runs, "--summary-only", "--plot", image) == 0
    assert image.read_bytes().startswith(b"\x89PNG")


def test_the_script_runs_by_itself() -> None:
    done = _python(SCRIPTS / "validate.py", "--help")
    assert done.returncode == 0
    assert "--scheduler" in done.stdout


def test_what_there_is_none_of_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("--grades", "best", "--output", tmp_path / "x") == 2
    assert '"best"' in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def _python(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command: Sequence[str] = [sys.executable, *map(str, arguments)]
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    return subprocess.run(  # noqa: S603 - our own script
        command, capture_output=True, text=True, check=False, timeout=120,
        env={**os.environ, "PYTHONPATH": path}, cwd=ROOT,
    )  # fmt: skip
