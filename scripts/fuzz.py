"""Mutate a small log and see that every command ends in time, in words, and never wrong in silence.

A sound log of a robot with two joints is simulated and calibrated once. Mutants of its bytes
(flipped, cut, repeated), of its MCAP records (left out, doubled, exchanged, with other lengths), of
its messages (stamps, values, order, payloads) and of the bytes of the same log in other formats
(database, ROS 1 bag, table, packed) then go through `info`, `explore` and `calibrate`, each in a
process of its own with a limit of time and memory. A mutant fails where a command is killed by a
limit or a signal, prints a traceback or an internal error, ends with an unknown status, or writes a
URDF that is wrong by more than twice what it states without a word that the sound log's result does
not have.
Mutants that fail are kept. Each mutant is a line of the output as soon as it is finished, and one
that is there is not done again.

    python scripts/fuzz.py --mutants 20000 --seconds 36000 --output fuzz.jsonl
    python scripts/fuzz.py --summary-only --output fuzz.jsonl
"""

from __future__ import annotations

import argparse
import contextlib
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
from fuzzing.performing import GRACE, PATIENCE, Outcome, perform
from fuzzing.sound import formats, sound_log

from skin2urdf.cli.main import main as skin2urdf

COMMANDS = ("info", "explore", "calibrate")


class Usual(NamedTuple):
    """What the commands make of the sound log.

    Attributes:
        seconds: processor time of each.
        said: all that its result says in words.
    """

    seconds: Mapping[str, float]
    said: set[str]


def words_of(name: str, log: Path, urdf: Path) -> list[str]:
    """A command on a log."""
    return [name, str(log), *(["-o", str(urdf)] if name == "calibrate" else [])]


def usual(commands: list[str], log: Path, urdf: Path, memory: int) -> Usual:
    """See what the commands make of the sound log.

    Raises:
        SystemExit: one does not succeed.
    """
    # What a command loads, its mutants need not load again: they are forks of this process.
    for name in commands:
        skin2urdf([*words_of(name, log, urdf), "--quiet"])
    seconds = {}
    for name in commands:
        outcome = perform(words_of(name, log, urdf), 600.0, memory)
        print(f"sound log, {name}: status {outcome.status}, {outcome.seconds:.1f} s", flush=True)
        if outcome.status:
            raise SystemExit(f"{name} ends so for the sound log: {outcome.output.strip()}")
        seconds[name] = outcome.seconds
    beside = urdf.with_suffix(".json")
    return Usual(seconds, spoken(json.loads(beside.read_text())) if beside.exists() else set())


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
    lines = [f"{len(records)} mutants, {len(failures)} failures", *failures]
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
    log, truth = sound_log(place)
    urdf = place / "robot.urdf"
    normal = usual(options.commands, log, urdf, memory)
    whole = formats(log)
    done = {record["key"] for record in finished(options.output)}
    with options.output.open("a") as output:
        for number in range(options.mutants):
            if time.monotonic() > end:
                break
            if (key := f"{options.seed}_{number}") in done:
                continue
            ending, mutation = PLAN[number % len(PLAN)]
            mutant = place / f"mutant{ending}"
            mutant.write_bytes(
                mutation(whole[ending], np.random.default_rng([options.seed, number]))
            )
            statuses, seconds, faults = {}, 0.0, []
            for name in options.commands:
                urdf.unlink(missing_ok=True)
                limit = PATIENCE * normal.seconds[name] + GRACE
                outcome = perform(words_of(name, mutant, urdf), limit, memory)
                fault = outcome.fault
                if not fault and name == "calibrate" and urdf.exists():
                    fault = wrong_in_silence(urdf, truth, normal.said)
                statuses[name] = outcome.status
                seconds += outcome.seconds
                if fault:
                    faults.append(f"{name}: {fault}")
                    _keep(
                        options.keep,
                        f"{key}_{name}{ending}",
                        mutant,
                        mutation.__name__,
                        fault,
                        outcome,
                    )
            record = {
                "key": key,
                "mutation": mutation.__name__,
                "format": ending,
                "statuses": statuses,
                "seconds": round(seconds, 2),
                "faults": faults,
            }
            output.write(json.dumps(record) + "\n")
            output.flush()
            os.fsync(output.fileno())


def _keep(folder: Path, name: str, mutant: Path, how: str, fault: str, outcome: Outcome) -> None:
    """Keep a mutant that failed, and say why it did."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / name
    kept.write_bytes(mutant.read_bytes())
    last = outcome.output.strip().splitlines()[-3:]
    print(f"{kept}: {how}: {fault}", *last, sep="\n    ", flush=True)


if __name__ == "__main__":
    main()
