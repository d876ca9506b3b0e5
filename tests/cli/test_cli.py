"""The command line as a user meets it: results, exit statuses, and errors that help."""

from __future__ import annotations

import argparse
import io
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import calibrated
import numpy as np
import pytest

from skin2urdf import survey
from skin2urdf.cli import terminal
from skin2urdf.cli.arguments import refuse_to_overwrite
from skin2urdf.cli.commands.calibrate import calibration_settings
from skin2urdf.cli.commands.simulate import simulation_settings
from skin2urdf.cli.main import INTERNAL_ERROR, main
from skin2urdf.cli.parser import COMMANDS, make_parser
from skin2urdf.errors import BadFitError, StructureError, UsageError
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.files import write_atomically
from skin2urdf.recording.reading import read
from skin2urdf.recording.writing import write
from skin2urdf.simulation import SimulationSettings

SHORT = ["--poses", "3", "--excite", "all", "--imu-rate", "100", "--joint-rate", "50", "--seed=5"]


class Files(NamedTuple):
    """A log and its truth, an estimate and its JSON, and what the command told of them."""

    log: Path
    truth: Path
    urdf: Path
    json: Path
    out: str
    err: str


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """A recording and what was made of it, all by the command line."""
    folder = tmp_path_factory.mktemp("cli")
    names = ("log.mcap", "truth.urdf", "robot.urdf", "robot.json")
    log, truth, urdf, document = (folder / name for name in names)
    assert main(["simulate", "so101", "-o", str(log), "--truth", str(truth), *SHORT]) == 0
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        assert main(["calibrate", str(log), "-o", str(urdf), "--name", "arm"]) == 0
    return Files(log, truth, urdf, document, out.getvalue(), err.getvalue())


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*words: object) -> tuple[int, str, str]:
        status = main([str(word) for word in words])
        return (status, *capsys.readouterr())

    return call


def test_an_su_is_left_out_by_name(files: Files, run: Run, tmp_path: Path) -> None:
    words = ("calibrate", files.log, "-o", tmp_path / "robot.urdf", "--motion", "patterns")
    status, out, _ = run(*words, "--without", "no_such_su")
    assert (status, out, list(tmp_path.iterdir())) == (2, "", [])
    names = list(json.loads(files.json.read_text())["sus"])
    assert run(*words, "--without", names[-1], "--quiet")[0] == 0
    document = json.loads((tmp_path / "robot.json").read_text())
    assert list(document["sus"]) == names[:-1]
    assert document["settings"]["without"] == [names[-1]]


def test_a_log_that_is_given_twice_is_refused(files: Files, run: Run, tmp_path: Path) -> None:
    copied = Path(shutil.copy(files.log, tmp_path / "copy.mcap"))
    status, out, _ = run("calibrate", files.log, copied, "-o", tmp_path / "robot.urdf")
    assert (status, out, list(tmp_path.iterdir())) == (2, "", [copied])


def test_calibrate_tells_the_verdict_first_and_the_files_last(files: Files) -> None:
    assert files.err == ""
    lines = files.out.splitlines()
    assert lines[0].startswith("good: 5 joints, 6 SUs;")
    assert files.urdf.name in lines[-1]
    assert files.json.name in lines[-1]
    assert files.json.is_file()
    assert '<robot name="arm">' in files.urdf.read_text()


def test_an_su_to_be_repaired_is_told_by_verdict_and_exit_status(
    files: Files, run: Run, tmp_path: Path
) -> None:
    recording = read(files.log)
    dead = recording.sus[3]
    nothing = replace(dead, specific_force=np.zeros_like(dead.specific_force))
    sus = tuple(nothing if su is dead else su for su in recording.sus)
    write(replace(recording, sus=sus), tmp_path / "dead.mcap")
    words = ("-o", tmp_path / "a.urdf", "--motion", "patterns")
    status, out, _ = run("calibrate", tmp_path / "dead.mcap", *words)
    assert status == 3
    assert out.startswith("fair: ")
    assert any(dead.name in line and "dead" in line for line in out.splitlines())
    assert (tmp_path / "a.urdf").is_file()


def test_calibrate_prints_the_json_it_writes(files: Files, run: Run, tmp_path: Path) -> None:
    status, out, _ = run("calibrate", files.log, "-o", tmp_path / "a.urdf", "--json")
    assert status == 0
    printed, written = json.loads(out), json.loads((tmp_path / "a.json").read_text())
    del written["urdf"]
    assert printed == written
    assert printed["inputs"][0]["path"] == str(files.log)
    assert len(printed["inputs"][0]["digest"]) == 64


def test_compare_finds_the_estimate_close_to_the_truth(files: Files, run: Run) -> None:
    status, out, err = run("compare", files.urdf, files.truth)
    assert (status, err) == (0, "")
    assert out.startswith("Tree: ")
    status, out, _ = run(
        "compare", files.urdf, files.truth, "--json", "--align", "base", "--configurations", 20
    )
    assert status == 0
    overall = json.loads(out)["overall"]
    assert overall["position_mm"]["rms"] < 0.5
    assert overall["orientation_deg"]["rms"] < 0.05


def test_compare_without_the_json_says_so(files: Files, run: Run, tmp_path: Path) -> None:
    (tmp_path / "alone.urdf").write_bytes(files.urdf.read_bytes())
    status, _, err = run("compare", tmp_path / "alone.urdf", files.truth)
    assert status == 0
    assert err.startswith("note: ")
    assert "JSON" in err


def test_compare_of_different_trees_exits_with_1(files: Files, run: Run, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.urdf"
    text = files.truth.read_text()
    wrong.write_text(text.replace('name="elbow_flex"', 'name="other"'))
    status, out, _ = run("compare", files.urdf, wrong)
    assert status == 1
    assert out.startswith("Tree: WRONG")


def test_explore_shows_matrix_tree_and_limbs(files: Files, run: Run) -> None:
    status, out, _ = run("explore", files.log)
    assert status == 0
    (limb,) = (line.split() for line in out.splitlines() if line.startswith("limb "))
    assert "5" in limb
    assert limb[limb.index("shoulder_pan") + 1] == ">"
    status, out, _ = run("explore", files.log, "--json")
    assert len(json.loads(out)["tree"]["joints"]) == 5


def test_explore_shows_a_contradiction_and_fails(
    files: Files, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = survey.explore([files.log])
    broken = replace(found, tree=None, contradiction=StructureError("crossing", "remedy"))
    monkeypatch.setattr(survey, "explore", lambda *_, **__: broken)
    status, out, err = run("explore", files.log)
    assert status == 1
    assert files.log.name not in err
    assert "shoulder_pan" in out
    assert [line.split() for line in err.splitlines()] == [["error:", "crossing"], ["->", "remedy"]]


def test_info_shows_what_is_there_and_what_is_missing(files: Files, run: Run) -> None:
    status, out, err = run("info", files.log)
    assert (status, err) == (0, "")
    status, document, _ = run("info", files.log, "--json")
    (problem,) = json.loads(document)["missing"]
    assert problem in out.replace("\n    ", " ")
    assert json.loads(document)["poses_with_pattern"] == 3


def test_quiet_prints_nothing(files: Files, run: Run, tmp_path: Path) -> None:
    log, urdf = tmp_path / "l.mcap", tmp_path / "t.urdf"
    commands = [
        ("simulate", "so101", "-o", log, "--truth", urdf, "--poses", 1),
        ("explore", files.log),
        ("info", files.log),
        ("compare", files.urdf, files.truth),
    ]
    for command in commands:
        assert run(*command, "--quiet") == (0, "", "")


def test_simulate_lists_its_robots(run: Run) -> None:
    status, out, _ = run("simulate", "--list")
    assert status == 0
    assert any(line.startswith("panda ") and "Franka" in line for line in out.splitlines())


def test_simulate_takes_its_options(run: Run, tmp_path: Path) -> None:
    words = ["--poses", 1, "--sus-per-segment", 2, "--sus-on-base", 0, "--excite", "all"]
    words += ["--base-rpy", 10, 20, 30, "--grade", "ideal", "--tracking", "none", "--lag", 5]
    words += ["--encoder-bits", 0, "--jitter", 0, "--compression", "none", "--no-index"]
    status, out, _ = run("simulate", "so101", "-o", tmp_path / "log.mcap", *words, "--no-chunks")
    assert status == 0
    assert re.findall(r"\b(\d+) ", out)[:3] == ["5", "10", "1"]


def test_simulate_moves_without_patterns(run: Run, tmp_path: Path) -> None:
    words = ["--excite", "none", "--minutes", 0.2, "--structural", "--imu-rate", 100]
    status, out, _ = run("simulate", "so101", "-o", tmp_path / "log.mcap", *words)
    assert status == 0
    assert "5 joints, 6 SUs" in out
    assert run("simulate", "so101", "-o", tmp_path / "log.mcap", "--minutes", 1)[0] == 2


@pytest.mark.parametrize(
    ("words", "status", "says"),
    [
        (["calibrate", "{log}", "-o", "{tmp}/none/a.urdf"], 2, "mkdir -p"),
        (["calibrate", "{log}", "-o", "{log}"], 2, "{log}"),
        (["calibrate", "{log}", "-o", "{tmp}/a.json"], 2, "robot.urdf"),
        (["calibrate", "{tmp}/none.mcap", "-o", "{tmp}/a.urdf"], 2, "{tmp}/none.mcap"),
        (["calibrate", "{empty}", "-o", "{tmp}/a.urdf"], 2, "{empty}"),
        (["calibrate", "{text}", "-o", "{tmp}/a.urdf"], 2, "{text}"),
        (["calibrate", "{log}", "-o", "{tmp}/a.urdf", "--bias", "nan"], 2, "--bias"),
        (["calibrate", "{log}", "-o", "{tmp}/a.urdf", "--threshold", "-1"], 2, "--threshold"),
        (["calibrate", "{log}", "-o", "{tmp}/a.urdf", "--threshold", "1000"], 2, "--threshold"),
        (["explore", "{log}", "--threshold", "1000"], 2, "--threshold"),
        (["calibrate", "{log}", "-o", "{tmp}/a.urdf", "--gravity", "0"], 2, "--gravity"),
        (["calibrate", "{log}", "-o", "{tmp}/a.urdf", "--gravity", "981"], 2, "--gravity"),
        (["calibrate", "{log}", "-o", "{tmp}/a.urdf", "--limits", "narrow"], 2, "narrow"),
        (
            ["calibrate", "{log}", "-o", "{tmp}/a.urdf", "--model", "bag", "--limits", "seen"],
            2,
            "--limits",
        ),
        (["export", "{text}", "--to", "mjcf"], 2, "{text}"),
        (["export", "{truth}", "--to", "imu"], 2, "skin2urdf calibrate"),
        (["compare", "{text}", "{truth}"], 2, "{text}"),
        (["check", "{truth}", "{log}"], 2, "LOG URDF"),
        (["compare", "{log}", "{truth}"], 2, "ESTIMATE TRUTH"),
        (["report", "{log}"], 2, "URDF"),
        (["export", "{log}", "--to", "mjcf"], 2, "URDF"),
        (["info", "{truth}"], 2, "LOG"),
        (["calibrate", "{json}", "-o", "{tmp}/a.urdf"], 2, "LOG .."),
        (["compare", "{truth}", "{tmp}/none.urdf"], 2, "{tmp}/none.urdf"),
        (["compare", "{truth}", "{truth}", "--seed", "-1"], 2, "--seed"),
        (["explore", "{text}"], 2, "{text}"),
        (["explore", "{log}", "--plot", "{tmp}/none/a.svg"], 2, "mkdir -p"),
        (["explore", "{text}", "--plot", "{tmp}/a.jpg"], 2, ".svg"),
        (["explore", "{text}", "--plot", "{tmp}/a"], 2, ".svg"),
        (["info", "{text}"], 2, "{text}"),
        (["simulate", "panda"], 2, "--list"),
        (["simulate", "marvin", "-o", "{tmp}/a.mcap"], 2, "panda"),
        (["simulate", "panda", "-o", "{tmp}/none/a.mcap"], 2, "mkdir -p"),
        (["simulate", "panda", "-o", "{tmp}/a.mcap", "--truth", "{tmp}/a.mcap"], 2, "{tmp}/a.mcap"),
        (["simulate", "{truth}", "-o", "{truth}"], 2, "{truth}"),
        (["simulate", "panda", "-o", "{tmp}/a.txt"], 2, ".mcap"),
        (["check", "{log}", "{urdf}", "-o", "{tmp}/a", "--history", "{tmp}/a.json"], 2, "a.json"),
        (["simulate", "panda", "-o", "{tmp}/a.mcap", "--poses", "0"], 2, "--poses"),
        (["simulate", "panda", "-o", "{tmp}/a.mcap", "--imu-rate", "1e9"], 2, "--imu-rate"),
        (["simulate", "panda", "-o", "{tmp}/a.mcap", "--encoder-bits", "-1"], 2, "--encoder-bits"),
        (["simulate", "panda", "-o", "{tmp}/a.mcap", "--minutes", "1"], 2, "--minutes"),
        (["plan", "--model", "panda", "-o", "{tmp}/p.yaml", "--range", "1"], 2, "--range"),
        (["plan", "--model", "panda", "-o", "{tmp}/p.yaml", "--share", "nan"], 2, "--share"),
        *(
            (["simulate", "panda", "-o", "{tmp}/a.mcap", "--plan", "{text}", *more], 2, more[0])
            for more in (["--poses", "4"], ["--excite", "none"], ["--minutes", "2"])
        ),
        (["simulate", "panda", "-o", "{tmp}/a.mcap", "--plan", "{text}"], 2, "{text}"),
    ],
    ids=lambda value: " ".join(value[:1]) if isinstance(value, list) else str(value),
)
def test_errors_say_what_to_do_and_leave_nothing(
    files: Files, run: Run, tmp_path: Path, words: list[str], status: int, says: str
) -> None:
    inputs = tmp_path / "inputs"
    inputs.mkdir()
    (inputs / "empty").touch()
    (inputs / "text").write_text("hello")
    places = {
        **files._asdict(),
        "tmp": tmp_path,
        "empty": inputs / "empty",
        "text": inputs / "text",
    }
    done, out, err = run(*(word.format(**places) for word in words))
    assert (done, out) == (status, "")
    first, second = err.splitlines()
    assert first.startswith("error: ")
    assert second.startswith("  -> ")
    assert says.format(**places) in err
    assert [path.name for path in tmp_path.iterdir()] == ["inputs"]
    assert sorted(path.name for path in inputs.iterdir()) == ["empty", "text"]


def test_a_bad_fit_writes_nothing(
    files: Files, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise BadFitError("unexplained", "remedy", 900.0)

    monkeypatch.setattr("skin2urdf.calibration.pipeline.calibrate", fail)
    status, out, err = run("calibrate", files.log, "-o", tmp_path / "a.urdf")
    assert (status, out, err.split()) == (1, "", ["error:", "unexplained", "->", "remedy"])
    assert not list(tmp_path.iterdir())


def test_a_bad_result_is_shown_and_not_written(
    files: Files, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = calibrated.calibration()
    worse = replace(found.estimate, chi2=1e3 * found.estimate.chi2)
    bad = replace(found, along=None, estimate=worse)
    monkeypatch.setattr("skin2urdf.calibration.pipeline.calibrate", lambda *_, **__: bad)
    urdf = tmp_path / "a.urdf"
    urdf.write_text("a good one")
    status, out, err = run("calibrate", files.log, "-o", urdf)
    assert status == 1
    assert out.startswith("bad: ")
    assert "--force" in err
    assert urdf.read_text() == "a good one"
    assert [path.name for path in tmp_path.iterdir()] == ["a.urdf"]
    status, out, err = run("calibrate", files.log, "-o", urdf, "--force")
    assert (status, err) == (1, "")
    assert "<robot" in urdf.read_text()
    last = out.splitlines()[-1]
    assert last.count("a.urdf") == 2, "the older file is named"
    assert last.count("a.json") == 1


def test_outputs_that_were_there_are_named(files: Files, run: Run, tmp_path: Path) -> None:
    plot, log = tmp_path / "tree.svg", tmp_path / "log.mcap"
    commands = {
        plot: ("explore", files.log, "--plot", plot),
        log: ("simulate", "so101", "-o", log, "--poses", 1, "--imu-rate", 100),
    }
    for target, command in commands.items():
        assert run(*command)[1].splitlines()[-1].count(target.name) == 1
        assert run(*command)[1].splitlines()[-1].count(target.name) == 2


def test_info_exits_with_1_where_no_calibration_is_possible(
    files: Files, run: Run, tmp_path: Path
) -> None:
    recording = read(files.log)
    still = tuple(replace(j, position=np.zeros_like(j.position)) for j in recording.joints)
    write(replace(recording, joints=still), tmp_path / "still.mcap")
    status, out, err = run("info", tmp_path / "still.mcap")
    assert (status, err) == (1, "")
    status, document, _ = run("info", tmp_path / "still.mcap", "--json")
    assert status == 1
    obstacles = json.loads(document)["obstacles"]
    assert obstacles
    assert all(obstacle in out.replace("\n    ", " ") for obstacle in obstacles)
    assert not json.loads(run("info", files.log, "--json")[1])["obstacles"]


def test_a_folder_that_is_no_bag_is_not_taken_silently(
    files: Files, run: Run, tmp_path: Path
) -> None:
    shutil.copy(files.log, tmp_path / "monday.mcap")
    status, out, _ = run("info", tmp_path)
    assert status == 0
    assert "monday.mcap" in out
    shutil.copy(files.log, tmp_path / "tuesday.mcap")
    status, out, err = run("info", tmp_path)
    assert (status, out) == (2, "")
    assert "monday.mcap" in err
    assert "tuesday.mcap" in err


@pytest.mark.parametrize(
    ("raised", "status", "says"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (ZeroDivisionError("0/0"), 1, f"{INTERNAL_ERROR}: ZeroDivisionError: 0/0"),
        (RecursionError(), 1, f"{INTERNAL_ERROR}: RecursionError"),
        (MemoryError("16 GiB"), 1, "16 GiB"),
    ],
    ids=["interrupt", "defect", "defect without words", "memory"],
)
def test_no_traceback_reaches_a_user(
    run: Run, monkeypatch: pytest.MonkeyPatch, raised: BaseException, status: int, says: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr(survey, "survey", fail)
    done, out, err = run("info", "log.mcap")
    assert (done, out) == (status, "")
    assert says in err
    assert "Traceback" not in err
    assert (INTERNAL_ERROR in err) == (INTERNAL_ERROR in says)


@pytest.mark.parametrize("error", [ZeroDivisionError("0/0"), BadFitError("no")])
def test_debug_shows_where_an_error_comes_from(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(survey, "survey", fail)
    with pytest.raises(type(error)):
        main(["info", "log.mcap", "--debug"])


def test_a_reader_who_goes_away_is_no_error() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "skin2urdf", "simulate", "--list"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    complaint = process.stderr.read()
    process.stderr.close()
    assert (process.wait(timeout=60), complaint) == (0, b"")


def test_a_terminal_without_the_characters_is_no_error(files: Files) -> None:
    done = subprocess.run(  # noqa: S603 - our own words
        [sys.executable, "-m", "skin2urdf", "explore", files.log],
        env={"PYTHONIOENCODING": "ascii", "PATH": ""},
        capture_output=True,
        check=False,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"wrist_roll" in done.stdout


def test_defaults_in_the_help_are_those_of_the_estimation(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    parser = make_parser()
    given = parser.parse_args(["calibrate", "log.mcap", "-o", "robot.urdf"])
    settings = calibration_settings(given)
    assert asdict(settings.estimation.priors) == asdict(Priors())
    with pytest.raises(SystemExit):
        parser.parse_args(["calibrate", "--help"])
    text = capsys.readouterr().out
    priors = Priors()
    for option, default in (
        ("--bias", f"{priors.bias / 9.81e-3:.0f}"),
        ("--scale", f"{priors.scale:g}"),
        ("--cross", f"{priors.cross:g}"),
        ("--gravity", f"{priors.gravity:g}"),
    ):
        line = next(line for line in text.splitlines() if f"  {option} " in line)
        assert default in line


def test_options_reach_the_settings() -> None:
    words = ["--bias", "10", "--scale", "0", "--cross", "0.002", "--gravity", "9.78"]
    words += ["--no-intrinsics", "--refine", "casadi", "--threshold", "0.1"]
    given = make_parser().parse_args(["calibrate", "l", "-o", "r", *words])
    settings = calibration_settings(given)
    priors = settings.estimation.priors
    assert priors.bias == pytest.approx(10e-3 * 9.81)
    assert (priors.scale, priors.cross, priors.gravity) == (0.0, 0.002, 9.78)
    assert not settings.estimation.intrinsics
    assert settings.estimation.refine == "casadi"
    assert settings.static_threshold == pytest.approx(0.981)
    assert settings.gyro
    deaf = make_parser().parse_args(["calibrate", "l", "-o", "r", "--no-gyro"])
    assert not calibration_settings(deaf).gyro


def test_outputs_of_one_name_are_told_from_inputs(tmp_path: Path) -> None:
    taken, free = tmp_path / "log.mcap", tmp_path / "robot.urdf"
    refuse_to_overwrite([taken], free, free.with_suffix(".json"))
    told = []
    for outputs in ([taken], [free, tmp_path / "sub" / ".." / free.name]):
        with pytest.raises(UsageError) as caught:
            refuse_to_overwrite([taken], *outputs)
        told.append(str(caught.value).replace(str(outputs[-1]), ""))
    assert told[0] != told[1]


def test_a_value_may_begin_with_a_minus() -> None:
    """Whatever it goes on with after a digit, as places in the south do."""

    def parsed(*words: str) -> argparse.Namespace:
        return make_parser().parse_args(words)

    calibrate = "calibrate", "l", "-o", "r"
    assert parsed(*calibrate, "--site", "-33.9,20").site == (-33.9, 20.0)
    assert parsed(*calibrate, "--site", "48").site == (48.0, 0.0)
    assert parsed(*calibrate, "--gravity", "-9.81e0").gravity == -9.81
    assert parsed("plan", "-o", "p", "--base-rpy", "-1e1", "2", "-.5").base_rpy == [-10, 2, -0.5]


@pytest.mark.parametrize(
    ("words", "says", "not_says"),
    [
        (("--site", "95,3"), "95", "9000"),
        (("--site", "abc"), "abc", "9000"),
        (("--site", "-48,99999"), "99999", "48"),
        (("--site", "48,high"), "high", "48"),
        (("--bandwidth", "abc"), "abc", "_bandwidth"),
        (("--bandwidth", "40:x"), "40:x", "_bandwidth"),
        (("--correct", "all:abc"), "all:abc", "_correction"),
    ],
)
def test_a_wrong_value_is_named_as_the_user_knows_it(
    words: tuple[str, str], says: str, not_says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["calibrate", "l", "-o", "r", *words])
    assert stopped.value.code == 2
    first, second = capsys.readouterr().err.splitlines()
    assert words[0] in first
    assert says in first
    assert not_says not in first
    assert "skin2urdf calibrate --help" in second


def test_defaults_in_the_help_are_those_of_the_simulation() -> None:
    given = make_parser().parse_args(["simulate", "panda", "-o", "log.mcap"])
    assert simulation_settings(given) == SimulationSettings()


def test_simulated_sus_have_gyroscopes_where_they_are_asked_for(run: Run, tmp_path: Path) -> None:
    log, words = tmp_path / "log.mcap", ["--excite", "none", "--minutes", 0.1, "--imu-rate", 50]
    for given in ([], ["--gyro", 0.2], ["--gyro", "cheap"]):
        assert run("simulate", "so101", "-o", log, *words, *given)[0] == 0
        assert all((su.angular_velocity is not None) == bool(given) for su in read(log).sus)
    for wrong in ("none", -1):
        assert run("simulate", "so101", "-o", log, *words, "--gyro", wrong)[0] == 2


def test_without_a_word_all_commands_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    told = capsys.readouterr()
    assert not told.out
    assert all(f" {name} " in told.err or f" {name}\n" in told.err for name in COMMANDS)


@pytest.mark.parametrize("command", ["calibrate", "simulate", "compare", "explore", "info"])
def test_help_teaches_with_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([command, "--help"])
    assert stopped.value.code == 0
    out = capsys.readouterr().out
    assert f"example:\n  skin2urdf {command} " in out
    assert "--quiet" in out


class Watched(io.StringIO):
    """An error stream that is a terminal."""

    def isatty(self) -> bool:
        """It is."""
        return True


def test_a_bar_appears_after_a_while_and_only_where_someone_watches(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def shown(stream: io.StringIO, patience: float, quiet: bool = False) -> str:
        """What a bar has put on a stream until it is there, or for a while."""
        monkeypatch.setattr(sys, "stderr", stream)
        with terminal.progress_bar(quiet, patience) as bar:
            bar("reading", 0.7)
            bar("features", 0.0)
            end = time.monotonic() + (20.0 if patience < 1.0 and stream.isatty() else 0.1)
            while "features" not in stream.getvalue() and time.monotonic() < end and not quiet:
                time.sleep(0.01)
        return stream.getvalue()

    monkeypatch.setenv("TERM", "xterm")
    text = shown(Watched(), 0.0)
    assert "reading" in text
    assert "features" in text
    assert shown(Watched(), 60.0) == ""
    assert shown(Watched(), 0.0, quiet=True) == ""
    assert shown(io.StringIO(), 0.0) == ""  # standard error is no terminal here
    assert capsys.readouterr().out == ""


def test_explore_draws_a_picture(files: Files, run: Run, tmp_path: Path) -> None:
    status, _, err = run("explore", files.log, "--plot", tmp_path / "a.svg", "--quiet")
    assert (status, err) == (0, "")
    assert "<svg" in (tmp_path / "a.svg").read_text()


def test_the_written_truth_is_whole(files: Files, tmp_path: Path) -> None:
    text = files.truth.read_text()
    write_atomically(tmp_path / "copy.urdf", text)
    assert text.rstrip().endswith("</robot>")
    assert all(name in text for name in ("shoulder_pan", "elbow_flex", "wrist_roll"))
