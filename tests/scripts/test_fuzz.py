"""A short form of scripts/fuzz.py: mutants of a small log through the commands that read logs."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from fuzzing.mutations import MUTATIONS, mutated_bytes, mutated_messages
from fuzzing.performing import PATIENCE, STATUSES, Command, perform, perform_in_turn
from fuzzing.sharing import digest
from fuzzing.sound import formats

from skin2urdf.cli.main import INTERNAL_ERROR, main
from skin2urdf.recording.reading import read


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A log that calibrates, as small as one can be."""
    path = tmp_path_factory.mktemp("fuzz") / "log.mcap"
    words = ["simulate", "ur3", "-o", str(path), "--poses", "2", "--seed", "5", "--excite", "all"]
    assert main([*words, "--imu-rate", "50", "--joint-rate", "50", "--quiet"]) == 0
    return path.read_bytes()


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.__name__)
def test_mutants_end_in_time_and_in_words(
    mutation: object, sound: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert callable(mutation)
    log = tmp_path / "log.mcap"
    log.write_bytes(sound)
    begin = time.monotonic()
    assert main(["info", str(log)]) == 0
    usual = time.monotonic() - begin
    for seed in range(2):
        log.write_bytes(mutation(sound, np.random.default_rng(seed)))
        begin = time.monotonic()
        assert main(["info", str(log)]) in STATUSES
        told = capfd.readouterr()
        assert INTERNAL_ERROR not in told.out + told.err
        assert time.monotonic() - begin < PATIENCE * usual + 10.0


def test_mutants_of_every_format_end_in_words(
    sound: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(sound)
    for ending, whole in formats(log).items():
        mutant = tmp_path / f"mutant{ending}"
        mutant.write_bytes(whole)
        assert main(["info", str(mutant), "--quiet"]) == 0
        mutant.write_bytes(mutated_bytes(whole, np.random.default_rng(0)))
        assert main(["info", str(mutant)]) in STATUSES
        told = capfd.readouterr()
        assert INTERNAL_ERROR not in told.out + told.err


def test_a_mutant_through_the_whole_way(sound: bytes, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(mutated_messages(sound, np.random.default_rng(1)))
    outcome = perform(["calibrate", str(log), "-o", str(tmp_path / "a.urdf")], 120.0, 1 << 31)
    assert outcome.fault == ""


def test_what_a_command_does_wrong_is_seen(tmp_path: Path) -> None:
    assert perform(["info", str(tmp_path / "none.mcap")], 60.0, 1 << 30).status == 2
    assert perform(["simulate", "--list"], 1e-4, 1 << 30).fault
    assert not perform(["simulate", "--list"], 60.0, 1 << 30).fault
    assert perform(["info", "--no-such-option"], 60.0, 1 << 30).status == 2


def test_mutants_can_be_made_again(sound: bytes) -> None:
    for mutation in MUTATIONS:
        first, second = (mutation(sound, np.random.default_rng(3)) for _ in range(2))
        assert first == second
        assert first != sound


def test_commands_that_share_a_process_end_as_they_do_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    none = ["info", str(tmp_path / "none.mcap")]
    quick = Command(["simulate", "--list"], 60.0)
    with capfd.disabled():
        outcomes = perform_in_turn([quick, Command(none, 60.0), quick], 1 << 30).outcomes
        alone = perform(none, 60.0, 1 << 30)
    assert [outcome.status for outcome in outcomes] == [0, 2, 0]
    assert outcomes[0].output == outcomes[2].output
    assert outcomes[1].output == alone.output
    assert not any(outcome.fault for outcome in outcomes)


def test_a_command_that_ends_its_process_is_the_last_one(tmp_path: Path) -> None:
    quick = Command(["simulate", "--list"], 60.0)
    long = ["simulate", "talos", "-o", str(tmp_path / "log.mcap"), "--imu-rate", "1000", "--quiet"]
    outcomes = perform_in_turn([quick, Command(long, 0.1), quick], 1 << 32).outcomes
    assert len(outcomes) == 2
    assert not outcomes[0].fault
    assert outcomes[1].fault
    assert outcomes[1].status not in STATUSES


def test_what_commands_do_alike_is_done_once_and_changes_nothing(
    sound: bytes, tmp_path: Path
) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(sound)
    words = [["info", str(log)], ["explore", str(log)]]
    together = perform_in_turn([Command(w, 60.0) for w in words], 1 << 30)
    alone = [perform_in_turn([Command(w, 60.0)], 1 << 30) for w in words]
    assert [o.output for o in together.outcomes] == [a.outcomes[0].output for a in alone]
    assert {together.heard, *(a.heard for a in alone)} == {digest(read(log))}
    # What one of them takes from the other counts for both.
    shared = perform_in_turn([Command(words[0], 60.0)] * 2, 1 << 30).outcomes
    assert shared[1].seconds > 0.5 * shared[0].seconds


def test_a_recording_that_is_known_is_not_calibrated_again(sound: bytes, tmp_path: Path) -> None:
    log, urdf = tmp_path / "log.mcap", tmp_path / "robot.urdf"
    log.write_bytes(sound)
    commands = [
        Command(["info", str(log)], 60.0),
        Command(["calibrate", str(log), "-o", str(urdf)], 60.0),
    ]
    performed = perform_in_turn(commands, 1 << 30, {digest(read(log))})
    assert [(o.fault, o.status) for o in performed.outcomes] == [("", 0)]
    assert not urdf.exists()
    other = tmp_path / "other.mcap"
    other.write_bytes(mutated_messages(sound, np.random.default_rng(1)))
    assert digest(read(other)) != digest(read(log))
