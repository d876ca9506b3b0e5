"""A controller on a calibrated URDF, held against the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated import calibration, simulation

from skin2urdf.output import save

pytest.importorskip("pink", reason="needs pin-pink")
demo = pytest.importorskip("control_demo", reason="needs pin-pink and daqp")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A small calibration and its truth."""
    folder = tmp_path_factory.mktemp("control")
    truth = folder / "truth.urdf"
    truth.write_text(simulation().truth.urdf)
    return save(calibration(), folder / "robot.urdf")[0], truth


def test_sus_reach_targets_and_retreat_along_their_normals(files: tuple[Path, Path]) -> None:
    bench = demo.Bench(*files)
    rng = np.random.default_rng(0)
    reached, retreated = demo.targets(bench, 4, rng), demo.retreats(bench, 2, rng)
    assert len(reached.sus) == 4
    assert len(retreated.sus) == 2
    assert set(retreated.sus) <= set(reached.sus) | set(bench.sus)
    met, text = demo.report(reached, retreated)
    assert met, text
    # Not zero: the truth is the plant.
    assert reached.position.min() > 1e-6


def test_errors_of_the_plant_are_seen(files: tuple[Path, Path]) -> None:
    """A calibration whose wrist is bent by 2 deg misses its targets by as much."""
    bench = demo.Bench(*files)
    bent = bench.plant.displaced({"wrist_3_joint": np.array([0, 0, 0, np.deg2rad(2), 0, 0])}, {})
    bench.plant = bent
    bench.sus = [su for su in bench.sus if "wrist_3_joint" in bent.chain(su)]
    reached = demo.targets(bench, 2, np.random.default_rng(1))
    assert np.rad2deg(reached.orientation) == pytest.approx([2, 2], rel=0.1)
    met, _ = demo.report(reached, replace(reached, direction=np.zeros(2)))
    assert not met


def test_all_errors_are_drawn(tmp_path: Path) -> None:
    reached = demo.Outcome(("a", "b"), np.ones(2), np.ones(2), np.zeros(0), 0)
    retreated = demo.Outcome(("b",), np.zeros(0), np.zeros(0), np.ones(1), 1)
    demo.draw(reached, retreated, "title", tmp_path / "c.png")
    assert (tmp_path / "c.png").stat().st_size > 10_000
