"""scripts/gyros.py in short form: one recording with gyroscopes and without, and the tables."""

from __future__ import annotations

from pathlib import Path

import gyros
import pytest
from batch.records import Record
from batch.store import Store
from gyroscopes.table import report, shortfalls
from gyroscopes.trials import Case, Figures, Judged, Trial
from montecarlo.records import Block

GOOD = Judged(
    position_mm=0.05,
    position_stated_mm=0.04,
    orientation_deg=0.003,
    orientation_stated_deg=0.004,
    axis_deg=0.001,
    verdict="good",
    tree_right=True,
    blocks={"gyro bias": Block(3.0, 6, 6, 6)},
)


def trial(listening: Judged, deaf: Judged = GOOD) -> Trial:
    return Record(Case("panda", "tilted", 0), Figures(listening, deaf), "code")


def test_a_recording_is_calibrated_twice_and_kept(tmp_path: Path) -> None:
    output = tmp_path / "out.jsonl"
    words = ["--robots", "so101", "--postures", "tilted", "--recordings", "1", "--poses", "2"]
    assert gyros.main([*words, "--jobs", "0", "--output", str(output)]) == 0
    (kept,) = Store(output, Case, Figures).records.values()
    for judged in (kept.figures.listening, kept.figures.deaf):
        assert judged.tree_right
        assert judged.orientation_deg is not None
        assert judged.orientation_deg > 0
    assert kept.figures.listening.blocks["gyro bias"].dimensions > 0
    assert "gyro bias" not in kept.figures.deaf.blocks


def test_tables_hold_both_and_what_fell_short() -> None:
    table = report([trial(GOOD), trial(GOOD)])
    assert table.count("2") > 2
    # Six directions in each of two recordings, half of what is stated.
    assert "12" in table
    assert "0.5" in table
    assert shortfalls(trial(GOOD)) == []
    assert shortfalls(trial(GOOD, Judged(refusal="no"))) == []
    assert shortfalls(trial(Judged(refusal="no\nreally"))) == ["no"]
    assert len(shortfalls(trial(Judged(verdict="good")))) == 1
    assert report([]) == "No recordings.\n"


def test_what_can_not_be_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert gyros.main(["--poses", "0"]) == 2
    assert "--poses" in capsys.readouterr().err
