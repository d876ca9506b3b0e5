"""Every error a user can meet, under one root, each carrying its evidence and an exit status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

Lack = Literal[
    "logs", "joints", "SUs", "positions", "samples", "overlap", "rests", "radians", "gravity",
    "poses", "patterns", "starts", "measurements", "observable SUs", "",
]  # fmt: skip
"""What logs may not hold of all that a calibration needs."""
Unreadable = Literal[
    "empty", "no regular file", "no log", "another format", "shortened", "too large", "long line",
    "no messages", "nothing usable", "no joints", "no SUs", "no times", "several times", "no unit",
    "same column", "missing axis", "no rows", "no XML", "no links", "same name", "missing link",
    "two parents", "several trees", "circle", "refused", "a log", "a text", "",
]  # fmt: skip
"""Why an input is not what it should be."""


class Skin2UrdfError(Exception):
    """Root of all errors of this package.

    Attributes:
        exit_status: what the command line exits with: 1 where no trustworthy result can be
            written, 2 for bad usage or an unreadable input.
        remedy: what the user can record, fix or type to get further; may be empty.
    """

    exit_status = 1

    def __init__(self, what: str, remedy: str = "") -> None:
        super().__init__(what)
        self.remedy = remedy


class UsageError(Skin2UrdfError):
    """An argument that can not be used as given.

    Attributes:
        argument: its name, or its value where that says more; empty where the words say all.
    """

    exit_status = 2

    def __init__(self, what: str, remedy: str = "", argument: str = "") -> None:
        super().__init__(what, remedy)
        self.argument = argument


class SettingError(UsageError):
    """A field of a record of settings that is out of its range.

    Attributes:
        argument: the field's name; the command line names its option instead.
        rule: what goes for it, as words that follow its name.
    """

    def __init__(self, argument: str, rule: str) -> None:
        super().__init__(f"{argument} {rule}", "give another value, or leave it out", argument)
        self.rule = rule


def check_setting(argument: str, rule: str, holds: bool) -> None:
    """Refuse settings of which a rule does not hold.

    Args:
        argument: the field's name.
        rule: what goes for it, as words that follow its name.
        holds: whether that is so.

    Raises:
        SettingError: it is not.
    """
    if not holds:
        raise SettingError(argument, rule)


def check_ranges(settings: object, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Refuse settings with a number out of its range.

    Args:
        settings: a record, of which a field that is None is not looked at.
        ranges: smallest and largest values, by fields' names.

    Raises:
        SettingError: a field is out of its range, or NaN.
    """
    for argument, (least, most) in ranges.items():
        value = getattr(settings, argument)
        words = f"to {most:g}" if most < float("inf") else "or more"
        holds = value is None or (least <= value <= most and value < float("inf"))
        check_setting(argument, f"must be {least:g} {words}", holds)


class UnreadableInputError(Skin2UrdfError):
    """A file that can not be read as what it should be.

    Attributes:
        path: the file.
        why: what is wrong with it; empty where that has no short name.
    """

    exit_status = 2

    def __init__(self, path: str, what: str, remedy: str = "", why: Unreadable = "") -> None:
        super().__init__(f"{path}: {what}", remedy)
        self.path = path
        self.why = why


class PlanError(Skin2UrdfError):
    """A motion that can not be: limits, obstacles or the time leave no room for it.

    Attributes:
        minutes: how long it would have to take [min]; NaN where more time does not help.
    """

    exit_status = 2

    def __init__(self, what: str, remedy: str = "", minutes: float = float("nan")) -> None:
        super().__init__(what, remedy)
        self.minutes = minutes


class InsufficientDataError(Skin2UrdfError):
    """A readable log that does not hold what a calibration needs (poses, motion, sensors).

    Attributes:
        lacks: what is missing; empty where it has no short name.
        names: the SUs or joints it is missing of, where it is not missing of all.
    """

    def __init__(
        self, what: str, remedy: str = "", lacks: Lack = "", names: Sequence[str] = ()
    ) -> None:
        super().__init__(what, remedy)
        self.lacks = lacks
        self.names = tuple(names)


class StructureError(Skin2UrdfError):
    """An activity matrix that no kinematic tree can have produced.

    Attributes:
        sus: names of the SUs that contradict a tree.
        dofs: names of the DoFs that contradict a tree.
    """

    def __init__(
        self, what: str, remedy: str = "", sus: Sequence[str] = (), dofs: Sequence[str] = ()
    ) -> None:
        super().__init__(what, remedy)
        self.sus = tuple(sus)
        self.dofs = tuple(dofs)


class BadFitError(Skin2UrdfError):
    """No model was found that explains the features.

    Attributes:
        cost_per_dof: chi-squared per degree of freedom of the best model found.
    """

    def __init__(self, what: str, remedy: str = "", cost_per_dof: float = float("nan")) -> None:
        super().__init__(what, remedy)
        self.cost_per_dof = cost_per_dof


class ModelMismatchError(BadFitError):
    """A given model that is not the robot in the log.

    Attributes:
        joints: names of the model's joints that contradict the log; all of them where it is
            another robot.
        sus: names of the SUs that show it.
    """

    def __init__(
        self,
        what: str,
        remedy: str = "",
        joints: Sequence[str] = (),
        sus: Sequence[str] = (),
        cost_per_dof: float = float("nan"),
    ) -> None:
        super().__init__(what, remedy, cost_per_dof)
        self.joints = tuple(joints)
        self.sus = tuple(sus)
