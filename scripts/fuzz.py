"""Mutate small logs and see that every command ends in time, in words, and never wrong in silence.

Sound logs of a robot with two joints are simulated and calibrated once. Mutants of their bytes
(flipped, cut, repeated), of their MCAP records (left out, doubled, exchanged, with other lengths),
of their messages (stamps, values, order, payloads) and of the bytes of the same logs in other
formats (database, ROS 1 bag, table, packed) then go through `info`, `explore` and `calibrate`, in a
process that has a limit of time and memory. A mutant fails where a command is killed by a limit or
a signal, prints a traceback or an internal error, ends with an unknown status, or writes a URDF
that is wrong by more than twice what it states without a word that the sound log's result does not
have. The process is a fork of this one, in which everything is loaded, and goes through all
commands, which share what they do alike; where one fails, each gets a process of its own, and that
is what counts. A mutant that the first command reads as bit by bit the same recording as an earlier
log is not calibrated once more, as nothing that follows can differ.
Mutants that fail are kept. Each mutant is a line of the output as soon as it is finished, and one
that is there is not done again.

    python scripts/fuzz.py --mutants 20000 --seconds 36000 --output fuzz.jsonl
    python scripts/fuzz.py --summary-only --output fuzz.jsonl
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import os
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fuzzing.judging import spoken, wrong_in_silence
from fuzzing.mutations import PLAN
from fuzzing.performing import GRACE, PATIENCE, Command, Outcome, perform, perform_in_turn
from fuzzing.sound import MOTIONS, formats, sound_log

from skin2urdf.cli.main import main as skin2urdf

COMMANDS = ("info", "explore", "calibrate")
# Of which log so many mutants in a row are made, a round of formats each: most are of the one that
# takes the least time.
MOTION_PLAN = ("all", *3 * ("one",), "series", *3 * ("one",), "none", *3 * ("one",))


class Original(NamedTuple):
    """A sound log, and what the commands make of it.

    Attributes:
        truth: the robot that it was recorded on.
        formats: the log in every format, by the end of its name.
        seconds: processor time of each command.
        said: all that its result says in words.
        answers: how each command ended for a recording that was read before, by its digest.
    """

    truth: Path
    formats: Mapping[str, bytes]
    seconds: Mapping[str, float]
    said: set[str]
    answers: dict[str, dict[str, Outcome]]


def words_of(name: str, log: Path, urdf: Path) -> list[str]:
    """A command on a log."""
    return [name, str(log), *(["-o", str(urdf)] if name == "calibrate" else [])]


def original(place: Path, excite: str, commands: list[str], memory: int) -> Original:
    """Make a sound log, and see what the commands make of it.

    Args:
        place: a folder for it.
        excite: how its joints move, a key of `MOTIONS`.
        commands: names of the commands.
        memory: bytes that each may take.

    Raises:
        SystemExit: one does not succeed.
    """
    log, truth = sound_log(place, excite)
    urdf = place / "robot.urdf"
    # What a command loads, its mutants need not load again: they are forks of this process.
    for name in commands:
        skin2urdf([*words_of(name, log, urdf), "--quiet"])
    seconds = {}
    alone = [Command(words_of(name, log, urdf), 600.0) for name in commands]
    performed = perform_in_turn(alone, memory)
    for name, outcome in zip(commands, performed.outcomes, strict=True):
        print(f"{excite}, {name}: status {outcome.status}, {outcome.seconds:.1f} s", flush=True)
        if outcome.status:
            raise SystemExit(f"{name} ends so for the sound log: {outcome.output.strip()}")
        seconds[name] = outcome.seconds
    beside = urdf.with_suffix(".json")
    said = spoken(json.loads(beside.read_text())) if beside.exists() else set()
    answers = {performed.heard: dict(zip(commands, performed.outcomes, strict=True))}
    return Original(truth, formats(log), seconds, said, answers)


def finished(output: Path) -> list[dict[str, Any]]:
    """The mutants that an output holds; a line that was cut off is none."""
    found = []
    for line in output.read_text().splitlines() if output.exists() else []:
        with contextlib.suppress(json.JSONDecodeError):
            found.append(json.loads(line))
    return found


def summary(records: list[dict[str, Any]]) -> str:
    """How the commands ended, and what failed."""
    statuses: Counter[tuple[str, int]] = Counter()
    failures = []
    for record in records:
        statuses.update(record["statuses"].items())
        failures += [f"  {record['key']}: {fault}" for fault in record["faults"]]
    again = sum(record.get("again", False) for record in records)
    head = f"{len(records)} mutants ({again} read as another), {len(failures)} failures"
    lines = [head, *failures]
    order = sorted(statuses.items(), key=str)
    return "\n".join([*lines, *(f"  {name}: status {s}: {n}" for (name, s), n in order)])


def main() -> None:
    """Mutate, run, judge, sum up."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--mutants", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=600.0, help="time for all of them")
    parser.add_argument("--memory", type=int, default=1024, help="of one command [MiB]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--keep", type=Path, default=Path("fuzz"), help="where failures go")
    parser.add_argument(
        "--output", type=Path, default=Path("fuzz.jsonl"), help="a line for each mutant"
    )
    parser.add_argument("--summary-only", action="store_true", help="do nothing, show the output")
    options = parser.parse_args()
    if not options.summary_only:
        end = time.monotonic() + options.seconds
        with tempfile.TemporaryDirectory() as folder, contextlib.suppress(KeyboardInterrupt):
            fuzz(Path(folder), options, end)
    records = finished(options.output)
    print(summary(records))
    raise SystemExit(1 if any(record["faults"] for record in records) else 0)


def fuzz(place: Path, options: argparse.Namespace, end: float) -> None:
    """Do the mutants that are not done yet, up to a time.

    Args:
        place: a folder for what is needed meanwhile.
        options: as declared.
        end: time on the monotonic clock after which no mutant begins [s].
    """
    memory = options.memory << 20
    originals = {
        excite: original(place / excite, excite, options.commands, memory) for excite in MOTIONS
    }
    # What there is now is not looked through again in every fork, which would copy its memory.
    gc.freeze()
    done = {record["key"] for record in finished(options.output)}
    with options.output.open("a") as output:
        for number in range(options.mutants):
            if time.monotonic() > end:
                break
            if (key := f"{options.seed}_{number}") in done:
                continue
            ending, mutation = PLAN[number % len(PLAN)]
            excite = MOTION_PLAN[number // len(PLAN) % len(MOTION_PLAN)]
            sound = originals[excite]
            mutant = place / f"mutant{ending}"
            mutant.write_bytes(
                mutation(sound.formats[ending], np.random.default_rng([options.seed, number]))
            )
            outcomes, again = outcomes_of(mutant, sound, options.commands, memory)
            record = {
                "key": key,
                "mutation": mutation.__name__,
                "format": ending,
                "excite": excite,
                "again": again,
                "statuses": {name: outcome.status for name, outcome in outcomes.items()},
                "seconds": round(sum(outcome.seconds for outcome in outcomes.values()), 2),
                "faults": [f"{name}: {o.fault}" for name, o in outcomes.items() if o.fault],
            }
            for name, outcome in outcomes.items():
                if outcome.fault:
                    kept = f"{key}_{name}{ending}"
                    _keep(options.keep, kept, mutant, mutation.__name__, outcome)
            output.write(json.dumps(record) + "\n")
            output.flush()
            os.fsync(output.fileno())


def outcomes_of(
    mutant: Path, sound: Original, names: list[str], memory: int
) -> tuple[dict[str, Outcome], bool]:
    """How commands end for a mutant, and whether it reads as a log that was there before.

    A command that gets bit by bit the same recording gives the same answer; so the first one reads
    every mutant, and the others those that are new.

    Args:
        mutant: the log.
        sound: what it was made of.
        names: of the commands.
        memory: bytes that they may take.
    """
    urdf = mutant.with_name("robot.urdf")
    commands = [
        Command(words_of(name, mutant, urdf), PATIENCE * sound.seconds[name] + GRACE)
        for name in names
    ]
    urdf.unlink(missing_ok=True)
    found, heard = perform_in_turn(commands, memory, sound.answers)
    known = sound.answers.get(heard)
    if known is not None and not any(outcome.fault for outcome in found):
        first = dict(zip(names, found, strict=False))
        return {**known, **first}, True
    if any(outcome.fault for outcome in found):
        found = [perform(*command, memory) for command in commands]
    outcomes = dict(zip(names, found, strict=True))
    last = outcomes.get("calibrate")
    if last is not None and not last.fault and urdf.exists():
        silent = wrong_in_silence(urdf, sound.truth, sound.said)
        outcomes["calibrate"] = last._replace(fault=silent)
    if heard:
        sound.answers[heard] = outcomes
    return outcomes, False


def _keep(folder: Path, name: str, mutant: Path, how: str, outcome: Outcome) -> None:
    """Keep a mutant that failed, and say why it did."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / name
    kept.write_bytes(mutant.read_bytes())
    last = outcome.output.strip().splitlines()[-3:]
    print(f"{kept}: {how}: {outcome.fault}", *last, sep="\n    ", flush=True)


if __name__ == "__main__":
    main()
