"""Every command of the README and the guides does what they say, in order, on a small log."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest
from folding_arm import folding_arm
from test_readme import FENCE, PAGES

from skin2urdf.cli.main import main
from skin2urdf.cli.parser import make_parser
from skin2urdf.recording.writing import write
from skin2urdf.simulation import SimulationSettings, load_robot, simulate

SMALLER = {
    "ur5": "vendor.urdf", "panda": "vendor.urdf", "--minutes 3": "--minutes 0.9",
    "--minutes 2": "--minutes 0.9", "--minutes 1": "--minutes 0.9",
    "--excite all": "--excite all --poses 2 --imu-rate 100",
    "--excite none": "--excite none --imu-rate 100",
    "--excite series": "--excite series --imu-rate 100",
    "--plan plan.yaml": "--plan plan.yaml --imu-rate 100",
    "--limits joint_limits.yaml": "--limits joint_limits.yaml --grade mems --minutes 0.9",
    "--base-rpy 25 15 0": "--base-rpy 25 15 0 --grade mems",
}  # fmt: skip
"""What makes a command quick: the small robot in place of arms, and less time."""
PARSED_ALONE = {
    "skin2urdf view": "opens a browser",
    "skin2urdf convert old.bag": "needs a ROS 1 bag",
    "skin2urdf completion": "is held by tests of the terminal",
    "--style ur": "needs an arm of six joints",
    "--method paper": "is held by tests of the paper's method, and searches for long",
    "--refine casadi": "is held by tests of the refinement, and compiles for long",
}
"""Commands that are not run, and why."""


def commands(page: Path) -> Iterator[str]:
    """Lines of the fenced ``sh`` blocks of a page that call the program."""
    for block in FENCE.findall(page.read_text(encoding="utf-8")):
        for line in block.replace("\\\n", " ").splitlines():
            if line.strip().startswith("skin2urdf "):
                yield line.strip()


def words_of(line: str) -> list[str]:
    """Arguments of a command, up to where the shell takes its output."""
    words = shlex.split(line, comments=True)[1:]
    return list(takewhile(lambda word: word not in ("|", ">"), words))


@pytest.fixture(scope="module")
def given_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a reader of the guides has: logs, a vendor's URDF, limits, a table."""
    folder = tmp_path_factory.mktemp("reader")
    vendor = folder / "vendor.urdf"
    vendor.write_text(folding_arm("1.2 0 0"), encoding="utf-8")
    for name, rpy in (("log", (0.4, 0.3, 0.0)), ("upright", (0.0, 0.0, 0.0))):
        settings = SimulationSettings(
            n_poses=3, excite="all", seed=11, base_rpy=rpy, imu_rate=100.0, joint_rate=50.0
        )
        done = simulate(load_robot(vendor), settings)
        write(done.recording, folder / f"{name}.mcap")
        (folder / "truth.urdf").write_text(done.truth.urdf, encoding="utf-8")
    shutil.copy(folder / "log.mcap", folder / "tilted.mcap")
    rows = np.column_stack([np.arange(0.0, 2.0, 0.01), np.zeros((200, 3)), np.full(200, 9.81)])
    head = "time[s],j0[rad],su_a.x[m/s^2],su_a.y[m/s^2],su_a.z[m/s^2]"
    np.savetxt(folder / "table.csv", rows, delimiter=",", header=head, comments="")
    limits = "joint_limits:\n" + "".join(
        f"  j{i}: {{min_position: -2.5, max_position: 2.5, max_velocity: 2.0}}\n" for i in range(3)
    )
    (folder / "joint_limits.yaml").write_text(limits, encoding="utf-8")
    return folder


def test_the_commands_of_all_pages_do_what_they_say(
    given_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done: set[tuple[str, ...]] = set()
    for page in PAGES:
        # What another page has written over is as it was; what it made is there.
        shutil.copytree(given_files, tmp_path, dirs_exist_ok=True)
        for line in commands(page):
            words = words_of(line)
            make_parser().parse_args(words)
            if tuple(words) in done or any(part in line for part in PARSED_ALONE):
                continue
            done.add(tuple(words))
            shown = f"{line} "
            for long, short in SMALLER.items():
                shown = shown.replace(f" {long} ", f" {short} ")
            assert main([*words_of(shown)]) == 0, f"{page.stem}: {line}"
