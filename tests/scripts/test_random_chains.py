"""scripts/random_chains.py in short form: chains drawn, measured apart from the package, judged."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from batch.records import Failure, Record
from chains import judge, summary
from chains.draw import Chain, draw
from chains.judge import Case, Outcome, judged, outcome_of

from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.solve import estimate as module
from skin2urdf.geometry.so3 import rotation_exp

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("seed", range(16))
def test_a_random_chain_is_estimated_at_its_optimum(seed: int) -> None:
    outcome = judged(Case(seed))
    assert not outcome.failed
    assert outcome.cost_per_dof < judge.SUSPICIOUS
    assert outcome.tree is not False
    assert outcome.told >= outcome.open


def test_a_chain_is_a_function_of_its_seed() -> None:
    a, b, c = draw(5), draw(5), draw(6)
    np.testing.assert_array_equal(a.axes, b.axes)
    np.testing.assert_array_equal(a.q, b.q)
    assert a.n_dofs != c.n_dofs or not np.array_equal(a.axes, c.axes)


def test_all_kinds_of_chains_are_drawn() -> None:
    drawn = [draw(seed) for seed in range(200)]
    for attribute in ("posture", "layout", "measured"):
        assert len({getattr(chain, attribute) for chain in drawn}) >= 3
    assert {r for chain in drawn for r in chain.relations} == {
        "free", "parallel", "perpendicular", "intersecting", "wrist",
    }  # fmt: skip
    assert {chain.n_dofs for chain in drawn} == set(range(2, 10))
    assert any("prismatic" in chain.types for chain in drawn)


def test_neighbours_lie_as_their_relation_says() -> None:
    for chain in map(draw, range(60)):
        for i, relation in enumerate(chain.relations):
            a, b = chain.axes[i], chain.axes[i + 1]
            apart = abs(float((chain.points[i + 1] - chain.points[i]) @ np.cross(a, b)))
            if relation == "parallel":
                assert abs(a @ b) == pytest.approx(1.0)
            if relation in ("perpendicular", "wrist"):
                assert a @ b == pytest.approx(0.0, abs=1e-12)
            if relation in ("intersecting", "wrist"):
                assert apart == pytest.approx(0.0, abs=1e-12)


def test_a_lost_start_is_recognised_by_its_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """An estimate that stays at turned orientations is a failure, and its cost says so."""
    chain = _slopes_on_every_segment()

    def lost(cost: Cost, *_: object) -> tuple[State, tuple[float, ...]]:
        state = judge.true_state(chain, cost.tree)
        T = state.T_parent_joint.copy()
        T[1, :3, :3] = T[1, :3, :3] @ rotation_exp(np.array([[2.0, 1.0, 0.0]]))[0]
        return replace(state, T_parent_joint=T), (np.inf,)

    monkeypatch.setattr(module, "followed_starts", lost)
    monkeypatch.setattr(module, "minimise", lambda cost, state, _: (state, cost.at(state).chi2))
    outcome = judged(Case(chain.seed))
    assert outcome.failed
    assert outcome.recognised


def _slopes_on_every_segment() -> Chain:
    for seed in range(100):
        chain = draw(seed)
        if chain.layout == "each" and chain.measured == "pattern" and chain.n_dofs > 3:
            return chain
    raise AssertionError


def test_the_summary_tells_failures_by_seed_and_whether_they_show() -> None:
    good = Outcome(
        1, 3, 3, 9, ("tilted", "each", "pattern"), 0.1, "", True, 1.0, 90.0, 90.0, 0.9, 2, 2
    )
    shown = replace(good, seed=2, chi2=900.0, cost_per_dof=9.0)
    hidden = replace(good, seed=3, agreement=50.0)
    text = summary.report([Record(Case(o.seed), o) for o in (good, shown, hidden)])
    head = next(line for line in text.splitlines() if re.match(r"2 \w+ 3 ", line))
    assert re.findall(r"\d+", head) == ["2", "3", "1"]
    assert "NOT RECOGNISED" not in next(line for line in text.splitlines() if "chain 2" in line)
    assert "NOT RECOGNISED" in next(line for line in text.splitlines() if "chain 3" in line)


def test_a_chain_whose_process_died_is_of_its_kind_and_failed() -> None:
    outcome = outcome_of(Record(Case(5), Failure("BrokenProcessPool", "gone")))
    assert outcome.failed
    assert "gone" in outcome.error
    assert (outcome.dofs, outcome.kind[0]) == (draw(5).n_dofs, draw(5).posture)


def test_a_dask_cluster_does_the_same_work(tmp_path: Path) -> None:
    """A cluster on loopback, in a process of its own: this one only talks to its scheduler.

    Its worker knows nothing of the scripts but what the batch sends.
    """
    pytest.importorskip("distributed")
    program, output = tmp_path / "cluster.py", tmp_path / "chains.jsonl"
    program.write_text(CLUSTER, encoding="utf-8")
    done = subprocess.run(  # noqa: S603 - our own words
        [sys.executable, program, ROOT / "scripts" / "random_chains.py", output],
        capture_output=True, text=True, check=False, timeout=120, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in output.read_text(encoding="utf-8").splitlines()]
    assert sorted(line["case"]["seed"] for line in lines) == [5, 6]
    for line in lines:
        assert line["figures"]["dofs"] == draw(line["case"]["seed"]).n_dofs
        assert line["figures"]["tree"] is not False


CLUSTER = """
import subprocess, sys
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(
        n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
        processes=False, protocol="tcp",
    ) as cluster:
        script, output = sys.argv[1:]
        arguments = ["--chains", "2", "--first-seed", "5", "--output", output]
        command = [sys.executable, script, *arguments, "--scheduler", cluster.scheduler_address]
        sys.exit(subprocess.run(command).returncode)
"""
