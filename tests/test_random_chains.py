"""scripts/random_chains.py in short form: chains drawn, measured apart from the package, judged."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "scripts"))

from chains import judge, summary  # noqa: E402
from chains.draw import Chain, draw  # noqa: E402
from chains.judge import Case, Outcome, judged  # noqa: E402

from skin2urdf.estimation.problem.cost import Cost  # noqa: E402
from skin2urdf.estimation.problem.state import State  # noqa: E402
from skin2urdf.estimation.solve import estimate as module  # noqa: E402
from skin2urdf.geometry.so3 import rotation_exp  # noqa: E402


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
    text = summary.report([good, shown, hidden])
    assert "2 of 3 chains are not at the global optimum; 1 of these" in text
    assert "chain 2" in text
    assert "NOT RECOGNISED" not in next(line for line in text.splitlines() if "chain 2" in line)
    assert "NOT RECOGNISED" in next(line for line in text.splitlines() if "chain 3" in line)
    assert Outcome.from_json(good.to_json()) == good


def test_the_script_goes_on_where_it_stopped(tmp_path: Path) -> None:
    output = tmp_path / "chains.jsonl"
    environment = dict(os.environ, PYTHONPATH=str(ROOT))

    def run(chains: int) -> str:
        done = subprocess.run(  # noqa: S603 - our own words
            [sys.executable, "scripts/random_chains.py", "--chains", str(chains), "--workers", "0",
             "--output", str(output)],
            cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    run(2)
    first = output.read_text(encoding="utf-8")
    assert "0 of 3 chains are not at the global optimum" in run(3)
    assert output.read_text(encoding="utf-8").startswith(first)
    assert len(output.read_text(encoding="utf-8").splitlines()) == 3
