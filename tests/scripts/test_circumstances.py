"""scripts/circumstances.py in short form: what is drawn, one recording, and how it is judged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import circumstances
import pytest
from batch.records import Failure, Record
from batch.store import Store
from bench.measured import Figures
from drawn.circumstances import drawn
from drawn.table import complete, report, shortfalls
from drawn.trials import Case, Outcome, Trial
from good_figures import GOOD

from skin2urdf.simulation.defects import Defect, LocalGravity


def trial(figures: Figures, *words: str, seed: int = 0) -> Trial:
    return Record(Case(seed), Outcome("panda", words, (), 1000, ("su_1",), figures), "code")


def test_a_recording_is_drawn_calibrated_and_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out.jsonl"
    words = ["--first-seed", "110", "--joints", "2", "--recordings", "1", "--jobs", "0"]
    assert circumstances.main([*words, "--output", str(output)]) == 0
    (kept,) = Store(output, Case, Outcome).records.values()
    assert kept.figures.figures.tree_right
    assert kept.figures.figures.position_ratio is not None
    before = output.read_bytes()
    capsys.readouterr()
    circumstances.main(["--summary-only", "--output", str(output)])
    assert output.read_bytes() == before
    shown = capsys.readouterr().out
    assert all(word in shown for word in kept.figures.words)


def test_a_seed_draws_everything_and_all_seeds_every_kind(tmp_path: Path) -> None:
    many = [drawn(seed, 5, tmp_path) for seed in range(300)]
    again = drawn(7, 5, tmp_path)
    assert again == replace(many[7], robot=again.robot)
    words = {word for each in many for word in each.words}
    kinds = {kind.__name__ for kind in Defect.__subclasses__()}
    assert kinds <= words
    assert {"random tree", "robot", "any URDF", "some bare", "no defect"} <= words
    for each in many:
        elsewhere = any(isinstance(defect, LocalGravity) for defect in each.settings.defects)
        assert not (elsewhere and each.gravity_told)


@pytest.mark.parametrize(
    ("figures", "words", "false"),
    [
        (GOOD, (), 0),
        (replace(GOOD, position_mm=0.09), (), 1),
        (replace(GOOD, tree_right=False), (), 1),
        (replace(GOOD, tree_right=False, verdict="bad"), (), 0),
        (replace(GOOD, named=(("contact", "joint1"),)), (), 1),
        (replace(GOOD, named=(("saturated", "su_1"),)), (), 0),
        (replace(GOOD, named=(("saturated", "su_2"),)), (), 1),
        (replace(GOOD, named=(("intermittent", "su_2"),)), ("Lost",), 0),
        (replace(GOOD, named=(("intermittent", "su_2"),)), ("Spikes",), 1),
        (Figures(refusal="BadFitError: cost 70", exit_status=1), (), 0),
    ],
)
def test_what_is_stated_has_to_be_true(
    figures: Figures, words: tuple[str, ...], false: int
) -> None:
    assert len(shortfalls(trial(figures, *words))) == false
    assert complete([trial(figures, *words)]) == (false == 0)
    assert report([trial(figures, *words)])


def test_errors_that_are_no_words_and_long_times_count() -> None:
    assert shortfalls(Record(Case(0), Failure("KeyError", "a"), "code"))
    usual = [trial(GOOD, seed=seed) for seed in range(20)]
    assert complete(usual)
    assert not complete([*usual, trial(replace(GOOD, seconds=12.0), seed=20)])


def test_impossible_options_are_refused_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert circumstances.main(["--joints", "1"]) == 2
    assert "--joints" in capsys.readouterr().err
