"""What the commands share: their parser, options and checks, and how results are printed."""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from importlib import metadata
from pathlib import Path
from typing import Any, NoReturn

from skin2urdf.cli.terminal import complain
from skin2urdf.errors import SettingError, UsageError, check_ranges
from skin2urdf.files import check_target
from skin2urdf.geometry.units import GRAVITY

A_LOG = "MCAP, rosbag2, ROS 1 bag, CSV or Parquet"
"""Help for an argument that is a log."""


class Filled(argparse.RawDescriptionHelpFormatter):
    """Help whose prose fills the width; what is indented, and lines that end in a colon, stay."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        found: list[str] = []
        prose: list[str] = []
        for line in [*text.splitlines(), ""]:
            stays = not line or line.startswith(" ") or line.endswith(":")
            if stays and prose:
                found += textwrap.wrap(" ".join(prose), width, break_on_hyphens=False)
                prose = []
            if stays:
                found.append(line)
            else:
                prose.append(line)
        return "\n".join(indent + line for line in found).rstrip()


class Parser(argparse.ArgumentParser):
    """A parser whose epilog may be worked out when help is asked for, and that guesses typos.

    Attributes:
        late_epilog: makes the epilog.
        options: those of a command, for guesses; the command line as a whole has none of its own.
    """

    late_epilog: Callable[[], str] | None = None
    options: Collection[str] = ()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        # No option begins with a digit, so "-33.9,20" and "-1e3" are values of one; argparse
        # itself takes nothing but plain numbers for values.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As its base, but a command refuses by itself what it does not know."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown and self.options:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, what may have been meant and where more is told, and exit with 2."""
        found = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message)
        if found:
            message += did_you_mean(found[1], re.findall(r"[\w.-]+", found[2]))
        found = re.match(r"unrecognized arguments: (\S+)", message)
        if found:
            message += did_you_mean(found[1].partition("=")[0], self.options)
        # The usage of a command with many options would hide the one line that tells.
        complain(f"error: {message}")
        self.exit(UsageError.exit_status, f"  -> see {self.prog} --help\n")

    def format_help(self) -> str:
        """The help, with the late epilog where there is one."""
        if self.late_epilog is not None:
            self.epilog = self.late_epilog()
        return super().format_help()


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Words behind an error that name what is spelt most alike; empty where nothing is."""
    near = get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def offer_json(command: Parser) -> None:
    """Add ``--json``."""
    command.add_argument("--json", action="store_true", help="print JSON in place of text")


def add_number(
    command: argparse._ArgumentGroup,
    option: str,
    default: float | None,
    text: str,
    kind: type = float,
) -> None:
    """Add an option that takes a number."""
    command.add_argument(
        option, type=kind, default=default, metavar="N" if kind is int else "X", help=text
    )


def number_or_nan(text: str) -> float:
    """A number, or NaN where a text is none, which no check of a range lets pass."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def check_within(
    options: argparse.Namespace, name: str, least: float, most: float = float("inf")
) -> None:
    """Refuse numbers that mean nothing; NaN is one of them.

    Raises:
        UsageError: the option's value is below the least, above the most, or not finite.
    """
    with settings_of_options():
        check_ranges(options, {name: (least, most)})


def add_threshold(command: Parser) -> None:
    """Add the option that says what counts as activity; see :func:`static_threshold`."""
    add_number(
        command.add_argument_group("structure"),
        "--threshold",
        0.05,
        "change of a static reading that counts as activity [g] (%(default)s)",
    )


def static_threshold(options: argparse.Namespace) -> float:
    """Change of a static reading that counts as activity [m/s^2].

    Raises:
        UsageError: it is out of range: a reading changes by 2 g at most, where an SU is turned
            upside down.
    """
    check_within(options, "threshold", 1e-3, 2.0)
    return float(options.threshold * GRAVITY)


@contextmanager
def settings_of_options(**named: str) -> Iterator[None]:
    """Where settings that are made of options are refused, name the option and not the field.

    Args:
        named: names of options by fields' names, where these differ by more than hyphens.

    Raises:
        UsageError: settings are refused inside.
    """
    try:
        yield
    except SettingError as error:
        option = f"--{named.get(error.argument, error.argument).replace('_', '-')}"
        raise UsageError(f"{option} {error.rule}", error.remedy, option) from error


def refuse_to_overwrite(inputs: Sequence[str | Path], *outputs: str | Path) -> None:
    """Stop before an output replaces what it is made from, or another output.

    Raises:
        UsageError: an output is one of the inputs, or the same file as another one.
    """
    taken = {Path(path).expanduser().resolve() for path in inputs}
    written: set[Path] = set()
    for path in outputs:
        target = Path(path).expanduser().resolve()
        if target in taken:
            raise UsageError(f"{path} is an input and would be overwritten", "give another name")
        if target in written:
            raise UsageError(
                f"two outputs would be the same file, {path}", "give each a name of its own"
            )
        written.add(target)


def check_log_target(path: str | Path) -> Path:
    """Make sure that a log can be written at ``path``, before the work that fills it.

    Returns:
        The absolute path, symbolic links resolved.

    Raises:
        UsageError: the name does not end in .mcap, or nothing can be written there.
    """
    target = check_target(path)
    if target.suffix != ".mcap":
        raise UsageError(f"{path} does not end in .mcap", "give a name that does")
    return target


def present(paths: Iterable[str | Path]) -> frozenset[Path]:
    """Those of some outputs that exist already, as absolute paths; to be asked before writing."""
    resolved = (Path(path).expanduser().resolve() for path in paths)
    return frozenset(path for path in resolved if path.exists())


def wrote(paths: Sequence[Path], replaced: Collection[Path], seconds: float | None = None) -> str:
    """What was written, and what it took the place of.

    Args:
        paths: absolute paths of the outputs.
        replaced: those that existed before, see :func:`present`.
        seconds: how long it took [s].
    """
    text = f"wrote {_listed(list(map(shown, paths)))}"
    if seconds is not None:
        text += f" in {seconds:.1f} s"
    old = [shown(path) for path in paths if path in replaced]
    return f"{text}; replaced the older {_listed(old)}" if old else text


def _listed(names: Sequence[str]) -> str:
    """Names in a sentence."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def shown(path: Path) -> str:
    """A path as short as it can be told from here."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


def print_json(document: Mapping[str, Any]) -> None:
    """Print a document as JSON."""
    from skin2urdf.report.plain import dumps

    print(dumps(document), end="")


def version() -> str:
    """This package's version."""
    try:
        return metadata.version("skin2urdf")
    except metadata.PackageNotFoundError:
        from skin2urdf import __version__

        return __version__
