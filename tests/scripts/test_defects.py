"""scripts/defects.py in short form: one recording of the bench, and how results are judged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import defects
import pytest
from batch.records import Record
from batch.store import Store
from bench.measured import NORMALISED, Figures
from bench.rows import ROWS, SOUND
from bench.table import report, shortfalls
from bench.trials import TWO_ARMS, Case, Trial, robot
from good_figures import GOOD

from skin2urdf.simulation.mechanism import load_mechanism


def trial(figures: Figures, row: str = SOUND) -> Trial:
    return Record(Case("panda", row, 0), figures, "code")


def test_a_recording_is_calibrated_compared_and_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out.jsonl"
    words = ["--robots", "so101", "--rows", "low-pass 94 Hz", "--recordings", "1", "--poses", "3"]
    words += ["--excite", "all", "--jobs", "0", "--output", str(output)]
    assert defects.main(words) in (0, 1)
    (kept,) = Store(output, Case, Figures).records.values()
    assert kept.figures.n_sus == 6
    assert kept.figures.tree_right
    for true, stated in (
        (kept.figures.position_mm, kept.figures.position_stated_mm),
        (kept.figures.orientation_deg, kept.figures.orientation_stated_deg),
    ):
        assert true is not None
        assert stated is not None
        assert 0.0 < true < 100 * stated
    assert set(kept.figures.blocks) == set(NORMALISED)
    assert all(block.squared > 0.0 for block in kept.figures.blocks.values())
    assert kept.figures.known_deg is not None
    assert 0.0 < kept.figures.known_deg <= kept.figures.orientation_deg
    before = output.read_bytes()
    capsys.readouterr()
    defects.main([*words[:-4], "--jobs", "0", "--output", str(output), "--summary-only"])
    assert output.read_bytes() == before
    assert "low-pass 94 Hz" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("figures", "fallen"),
    [
        (GOOD, 0),
        (replace(GOOD, position_mm=0.09), 1),
        (replace(GOOD, position_mm=0.09, orientation_deg=0.01), 2),
        (replace(GOOD, tree_right=False), 1),
        (replace(GOOD, named=(("contact", "joint1"),)), 2),
        (Figures(refusal="BadFitError: cost 70", exit_status=1), 1),
    ],
)
def test_what_can_not_be_believed_falls_short(figures: Figures, fallen: int) -> None:
    assert len(shortfalls(trial(figures))) == fallen
    assert report([trial(figures)])


def test_a_cause_is_no_shortfall_beside_a_defect() -> None:
    told = replace(GOOD, causes=("elastic", "slack"))
    assert not shortfalls(trial(told, "gears 14/7 kNm/rad"))
    assert len(shortfalls(trial(told))) == 2
    assert "elastic 1; slack 1" in report([trial(told)])


def test_cases_have_keys_of_their_own() -> None:
    options = defects.parser().parse_args(["--recordings", "2", "--first-seed", "7"])
    cases = defects.cases_of(options)
    assert len({case.key for case in cases}) == len(cases) == 2 * 3 * len(ROWS)
    assert {case.seed for case in cases} == {7, 8}
    assert cases[0].row == SOUND
    free = replace(cases[0], excite="none", minutes=2.0)
    assert free.settings.duration == 120.0
    assert free.key != cases[0].key
    slow = replace(cases[0], imu_rate=100.0)
    assert slow.settings.imu_rate == 100.0
    assert slow.key != cases[0].key


def test_impossible_options_are_refused_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert defects.main(["--poses", "0"]) == 2
    assert "--poses" in capsys.readouterr().err


def test_the_tree_has_two_arms() -> None:
    spec = robot(TWO_ARMS)
    parent = load_mechanism(spec, spec.base_rpy).parent
    assert len(parent) == 8
    assert list(parent).count(-1) == 2
