"""A batch script of no use: its cases say how they end. Worker processes import it by name."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from batch import options as batch_options
from batch.records import Record
from batch.run import Batch, main


@dataclass(frozen=True)
class Toy:
    """A case that ends as told: ``fine``, ``raises`` or ``dies``."""

    seed: int
    end: str = "fine"
    diary: str = ""
    seconds: float = 0.0

    @property
    def key(self) -> str:
        """Names it."""
        return f"toy seed{self.seed}"


@dataclass(frozen=True)
class Square:
    """What comes of it, and in which process."""

    value: float
    process: int = 0


def square(case: Toy) -> Square:
    """Note in the diary who does it, and do it."""
    if case.diary:
        with Path(case.diary).open("a") as file:
            file.write(f"{case.seed} {os.getpid()}\n")
    time.sleep(case.seconds)
    if case.end == "raises":
        raise ValueError(f"seed {case.seed}")
    if case.end == "dies":
        os._exit(3)
    return Square(float(case.seed**2), os.getpid())


def cases_of(options: argparse.Namespace) -> list[Toy]:
    return [
        Toy(seed, options.ends.get(seed, "fine"), options.diary, options.seconds)
        for seed in batch_options.seeds(options)
    ]


def report(records: Sequence[Record[Toy, Square]]) -> str:
    values = [str(r.failure.kind if r.failure else r.figures.value) for r in records]
    return " ".join(values) + "\n"


TOYS = Batch(
    case=Toy,
    figures=Square,
    perform=square,
    cases=cases_of,
    report=report,
    shortfalls=lambda record: [str(record.failure)] if record.failure else [],
    passed=lambda records: not any(record.failure for record in records),
)


def parser() -> argparse.ArgumentParser:
    new = batch_options.parser("Square some seeds.", output="toys.jsonl", recordings=3)
    new.add_argument("--diary", default="")
    new.add_argument("--seconds", type=float, default=0.0)
    new.set_defaults(ends={})
    return new


if __name__ == "__main__":
    sys.exit(main(TOYS, parser().parse_args()))
