"""What all batch scripts share: the store, the workers, the options."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import defects
import faults
import monte_carlo
import pytest
import random_chains
import validate
from batch import figures, run
from batch.provenance import Checkout, checkout, package_digest
from batch.records import Failure, Record, parsed
from batch.store import Store
from toy_batch import TOYS, Square, Toy, parser

ROOT = Path(__file__).resolve().parents[2]


def done(output: Path, *arguments: str | Path, ends: Mapping[int, str] | None = None) -> int:
    """Exit status of the toy script."""
    options = parser().parse_args([str(a) for a in ("--output", output, *arguments)])
    options.ends = dict(ends or {})
    return run.main(TOYS, options)


def started(output: Path, *arguments: str | Path) -> subprocess.Popen[str]:
    """The toy script in a process of its own."""
    path = os.pathsep.join(map(str, (ROOT, ROOT / "tests", ROOT / "scripts")))
    return subprocess.Popen(  # noqa: S603 - our own script
        [sys.executable, ROOT / "tests" / "toy_batch.py", "--output", output, *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def until(true: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait for something to happen."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_case_is_one_line_with_its_key_its_figures_and_its_code(tmp_path: Path) -> None:
    output = tmp_path / "deep" / "toys.jsonl"
    assert done(output, "--jobs", "0", "--recordings", "1", "--first-seed", "4") == 0
    (line,) = lines_of(output)
    assert line["key"] == "toy seed4"
    assert line["figures"]["value"] == 16.0
    assert line["code"] == checkout().state(package_digest())


def test_what_is_in_the_output_is_not_done_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, diary = tmp_path / "toys.jsonl", tmp_path / "diary"
    assert done(output, "--jobs", "0", "--diary", diary) == 0
    first = output.read_bytes()
    assert done(output, "--jobs", "0", "--diary", diary, "--recordings", "5") == 0
    assert output.read_bytes().startswith(first)
    assert [line.split()[0] for line in diary.read_text().splitlines()] == list("01234")
    assert done(output, "--summary-only") == 0
    shown = [text for text in capsys.readouterr().out.splitlines() if text.startswith("0.0 ")]
    assert shown == ["0.0 1.0 4.0", "0.0 1.0 4.0 9.0 16.0", "0.0 1.0 4.0 9.0 16.0"]


def test_a_failure_is_a_line_and_is_done_again_when_asked_for(tmp_path: Path) -> None:
    output = tmp_path / "toys.jsonl"
    assert done(output, "--jobs", "0", ends={1: "raises"}) == 1
    assert [("failure" in line) for line in lines_of(output)] == [False, True, False]
    failure = lines_of(output)[1]["failure"]
    assert (failure["kind"], failure["message"]) == ("ValueError", "seed 1")
    assert failure["where"].startswith("toy_batch.py:")
    assert done(output, "--jobs", "0") == 1
    assert len(lines_of(output)) == 3
    assert done(output, "--jobs", "0", "--retry") == 0
    assert len(lines_of(output)) == 4


def test_a_worker_that_dies_takes_no_other_case_with_it(tmp_path: Path) -> None:
    output = tmp_path / "toys.jsonl"
    assert done(output, "--jobs", "2", "--recordings", "4", ends={1: "dies"}) == 1
    lines = {line["case"]["seed"]: line for line in lines_of(output)}
    assert sorted(lines) == [0, 1, 2, 3]
    assert lines.pop(1)["failure"]["kind"] == "BrokenProcessPool"
    processes = {line["figures"]["process"] for line in lines.values()}
    assert os.getpid() not in processes


def test_a_killed_batch_leaves_no_worker_and_goes_on_where_it_ended(tmp_path: Path) -> None:
    output, diary = tmp_path / "toys.jsonl", tmp_path / "diary"
    with started(output, "--jobs", "1", "--diary", diary, "--seconds", "0.5") as batch:
        until(lambda: output.exists() and bool(output.read_text()))
        until(lambda: len(diary.read_text().splitlines()) == 2)
        batch.send_signal(signal.SIGKILL)
        batch.communicate()
    worker = int(diary.read_text().split()[-1])
    until(lambda: not Path(f"/proc/{worker}").exists())
    with output.open("a") as file:
        file.write('{"key": "toy seed1", "figu')
    assert done(output, "--jobs", "0", "--diary", diary) == 0
    assert [line.split()[0] for line in diary.read_text().splitlines()] == list("0112")
    store = Store(output, Toy, Square)
    assert sorted(store.records) == ["toy seed0", "toy seed1", "toy seed2"]
    assert store.broken == 1


def test_two_batches_share_an_output_and_its_cases(tmp_path: Path) -> None:
    output, diary = tmp_path / "toys.jsonl", tmp_path / "diary"
    arguments = ("--jobs", "0", "--diary", diary, "--seconds", "0.1", "--recordings", "8")
    both = [started(output, *arguments) for _ in range(2)]
    said = [batch.communicate()[0].splitlines()[-2] for batch in both]
    assert [batch.returncode for batch in both] == [0, 0]
    assert said == [" ".join(f"{n * n:.1f}" for n in range(8))] * 2
    entries = [line.split() for line in diary.read_text().splitlines()]
    assert sorted(seed for seed, _ in entries) == list("01234567")
    assert len(lines_of(output)) == 8


def test_a_case_that_a_dead_batch_had_is_taken_up(tmp_path: Path) -> None:
    store, diary = Store(tmp_path / "toys.jsonl", Toy, Square), tmp_path / "diary"
    with started(store.path, "--jobs", "0", "--diary", diary, "--seconds", "60") as other:
        until(diary.exists)
        assert not store.claim(Toy(0))
        assert store.claim(Toy(1))
        other.kill()
        other.communicate()
        assert store.claim(Toy(0))
    store.close()


def test_an_output_of_another_script_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "other.jsonl"
    output.write_text('{"key": "a", "case": {"robot": "panda"}}\n' * 2, encoding="utf-8")
    assert done(output, "--jobs", "0") == 2
    assert str(output) in capsys.readouterr().err
    assert len(lines_of(output)) == 2
    assert done(tmp_path / "new.jsonl", "--jobs", "-1") == 2


@dataclass(frozen=True)
class Part:
    """Of a record."""

    values: tuple[float, ...]
    kind: Literal["a", "b"] = "a"


@dataclass(frozen=True)
class Everything:
    """All that figures may hold."""

    number: float
    maybe: float | None
    parts: tuple[Part, ...]
    pair: tuple[str, int]
    named: Mapping[str, Part]
    flag: bool = False


def test_a_record_survives_its_line() -> None:
    part = Part((1.0, 2.0), "b")
    whole = Everything(1.5, None, (part, part), ("x", 3), {"y": part}, True)
    record = Record(Toy(3), whole, "abc")
    assert parsed(record.to_json(), Toy, Everything) == record
    failed = Record(Toy(3), Failure("KeyError", "x", "y.py:1 z"))
    assert parsed(failed.to_json(), Toy, Everything) == failed
    endless = Everything(math.inf, math.nan, (), ("", 0), {})
    back = parsed(Record(Toy(1), endless).to_json(), Toy, Everything).figures
    assert math.isnan(back.number)
    assert back.maybe is None


@pytest.mark.parametrize(
    "line",
    [
        "", "[]", "{}", "null", '{"case": 3}', '{"case": {"seed": 1',
        '{"code": "", "case": {"seed": 1}}',
        '{"code": "", "case": {}, "figures": {"value": 1.0}}',
        '{"code": "", "case": {"seed": "one"}, "figures": {"value": 1.0}}',
        '{"code": "", "case": {"seed": 1}, "figures": {"value": 1.0, "other": 2}}',
    ],
)  # fmt: skip
def test_what_is_no_record_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        parsed(line, Toy, Square)


def test_the_code_is_a_commit_or_says_what_differs_from_it() -> None:
    here = Checkout("commit", "package", "")
    assert here.state("package") == "commit"
    assert here.state("changed") == "commit+changed"
    assert Checkout("commit", "package", "scripts").state("package") == "commit+scripts"
    assert Checkout("", "", "scripts").state("changed") == "changed+scripts"


def test_two_states_of_the_code_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "toys.jsonl"
    assert done(output, "--jobs", "0", "--recordings", "1") == 0
    store = Store(output, Toy, Square)
    store.append(Record(Toy(1), Square(1.0), "another"))
    store.close()
    capsys.readouterr()
    assert done(output, "--summary-only") == 0
    said = capsys.readouterr().out
    assert "another" in said
    assert checkout().state(package_digest()) in said


def test_all_scripts_have_the_same_options() -> None:
    shared = ("output", "first_seed", "recordings", "jobs", "scheduler", "retry", "summary_only")
    for script in (validate, defects, faults, monte_carlo, random_chains):
        options = script.parser().parse_args(
            ["--output", "x", "--first-seed", "7", "--recordings", "2", "--jobs", "0"]
        )
        assert all(hasattr(options, name) for name in shared)
        assert {case.seed for case in script.BATCH.cases(options)} == {7, 8}


def test_ratios_are_of_root_mean_squares_over_rows_that_have_both() -> None:
    rows = [(3.0, 1.0), (4.0, 7.0), (None, 1.0), (1.0, math.nan)]
    assert figures.ratio(rows) == pytest.approx(math.sqrt((9 + 16) / (1 + 49)))
    assert figures.ratio([(1.0, 0.0)]) is None
    assert figures.rms([3.0, None, math.inf, 4.0]) == pytest.approx(math.sqrt(12.5))
    assert figures.rms([None]) is None


def test_cells_mark_what_exceeds_a_limit() -> None:
    assert figures.cell(1.25, 1, 1.3) == "1.2"
    assert figures.cell(1.35, 2, 1.3) == "1.35!"
    assert figures.short(1234.5) == "1.23e+03"
    assert figures.cell(None, 2) == figures.short(math.nan) == figures.NONE
    assert (figures.count(3, 3), figures.count(2, 3)) == ("3", "2!")


def test_columns_of_a_table_line_up() -> None:
    text = figures.table(
        "things", [("a", "mm"), ("b", "")], [("one", ("1", "22")), ("2", ("", "3"))]
    )
    heads, units, rule, one, two = text.splitlines()
    assert heads.index("a") == one.index("1")
    assert units.endswith("mm")
    assert len(rule) == len(one) == len(two) == len(heads)
