"""scripts/reproduce_paper.py in short form: its tables, and what they must show."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import reproduce_paper

ROOT = Path(__file__).resolve().parents[2]


def reproduced(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """What the script prints, without a start of Python."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["scripts/reproduce_paper.py", *arguments])
        reproduce_paper.main()
    return capsys.readouterr().out


def reproduce(*arguments: str) -> str:
    environment = dict(os.environ, PYTHONPATH=str(ROOT), OMP_NUM_THREADS="1")
    done = subprocess.run(  # noqa: S603 - our own words
        [sys.executable, "scripts/reproduce_paper.py", *arguments],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return done.stdout


def test_tables_of_fig_6_are_printed() -> None:
    text = reproduce("--seed", "3")
    for title in (
        "DoF-DoF transformation",
        "DoF-SU transformation",
        "SU placements",
        "Optimization",
    ):
        assert title in text
    row = next(line for line in text.splitlines() if line.startswith("DoF 1-2 a "))
    assert row.split()[3:6] == ["0.200", "0.204", "+0.004"]
    assert max(len(line) for line in text.splitlines()) < 140
    assert "Over" not in text.split()


def test_default_is_more_exact_than_the_papers_method_and_faster(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = json.loads(reproduced(capsys, "--json", "--seeds", "2"))
    statistics = found["statistics"]
    assert statistics["default_optimum"] == statistics["paper_converged"] == 2
    assert sum(statistics["default_seconds"]) < sum(statistics["paper_seconds"])
    parameters = found["parameters"]
    assert len(parameters) == len(statistics["bound"]) == 63
    for parameter, default, paper, bound in zip(
        parameters,
        statistics["default_rms"],
        statistics["paper_rms"],
        statistics["bound"],
        strict=True,
    ):
        assert default < (0.01 if parameter["unit"] == "m" else 0.02), parameter
        assert bound < default * 50, parameter
        assert default < 4 * bound, parameter
        assert default < max(paper, 2 * bound), parameter


def test_markdown_without_the_papers_method(capsys: pytest.CaptureFixture[str]) -> None:
    text = reproduced(capsys, "--markdown", "--default-only", "--seeds", "2")
    assert "| DoF 1-2 a | 0.200 | 0.204 | +0.004 | - | - |" in text
    assert ("2", "2") in re.findall(r"(\d+) of (\d+)", text)
