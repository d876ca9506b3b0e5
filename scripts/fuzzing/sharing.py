"""What several commands do alike with the same log, done once.

`info`, `explore` and `calibrate` begin with the same functions of the same arguments: they read
the log, put it on a grid, and take its first features. In one process each of these is worked out
once; the others get the same record, or the same error. Their time counts for every command that
asks for it, so that each takes what it would alone.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import time
from collections.abc import Callable, Hashable, Iterator
from typing import Any
from unittest.mock import patch

from skin2urdf import survey
from skin2urdf.arrays import F64
from skin2urdf.calibration import rounds
from skin2urdf.cli import main as command_line
from skin2urdf.cli.parser import make_parser
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.recording import reading
from skin2urdf.recording.records import Recording
from skin2urdf.signals.sampling import Sampled, sampled_together
from skin2urdf.structure.first_features import first_features


class Ledger:
    """What was worked out, and the time that those save who ask for it again.

    Attributes:
        saved: processor time that was not spent once more [s].
        heard: what was read last, as `digest` tells it; empty where nothing was.
    """

    def __init__(self) -> None:
        self.saved = 0.0
        self.heard = ""
        # Arguments are kept: records are told by identity, and none may take another's.
        self._known: dict[Hashable, tuple[Any, object, float]] = {}

    def once(self, work: Callable[..., Any], key: Callable[..., Hashable]) -> Callable[..., Any]:
        """A function that does the same work once for each key.

        Args:
            work: what to do.
            key: told the arguments; what the result depends on.
        """

        @functools.wraps(work)
        def shared(*words: Any, **named: Any) -> Any:
            name = work.__qualname__, key(*words, **named)
            if name not in self._known:
                begin = time.process_time()
                try:
                    result: object = work(*words, **named)
                except Skin2UrdfError as error:
                    result = error
                self._known[name] = words, result, time.process_time() - begin
            else:
                self.saved += self._known[name][2]
            result = self._known[name][1]
            if isinstance(result, Skin2UrdfError):
                raise result
            return result

        return shared


@contextlib.contextmanager
def sharing() -> Iterator[Ledger]:
    """Commands in this process share what they do alike, as long as this lasts."""
    ledger = Ledger()
    original = reading.read

    @functools.wraps(original)
    def heard(*words: Any, **named: Any) -> Recording:
        recording = original(*words, **named)
        ledger.heard = digest(recording)
        return recording

    read = ledger.once(heard, lambda path, *_, **__: str(path))
    sampled = ledger.once(sampled_together, _recorded)
    features = ledger.once(first_features, _sampled)
    with contextlib.ExitStack() as stack:
        for place, name, shared in (
            (reading, "read", read),
            (survey, "read", read),
            (survey, "sampled_together", sampled),
            (rounds, "sampled_together", sampled),
            (survey, "first_features", features),
            (rounds, "first_features", features),
            (command_line, "make_parser", functools.cache(make_parser)),
        ):
            stack.enter_context(patch.object(place, name, shared))
        yield ledger


def digest(recording: Recording) -> str:
    """What tells recordings apart: every bit of their streams, and which kinds of notes they have.

    All that is made of a recording follows from these alone, but for numbers in notes.
    """
    told = hashlib.sha256(repr((recording.start, [n.kind for n in recording.notes])).encode())
    for joint in recording.joints:
        told.update(repr((joint.name, joint.stamp_noise)).encode())
        _tell(told, joint.time, joint.position, joint.effort)
    for su in recording.sus:
        told.update(repr((su.name, su.topic)).encode())
        _tell(told, su.time, su.specific_force, su.angular_velocity)
    return told.hexdigest()


def _tell(told: hashlib._Hash, *arrays: F64 | None) -> None:
    """Add arrays to a digest, each with its shape."""
    for array in arrays:
        told.update(repr(None if array is None else array.shape).encode())
        told.update(b"" if array is None else array.tobytes())


def _recorded(recordings: list[Recording], *, must_rest: bool = True, **_: object) -> Hashable:
    """What samples on a grid depend on: streams, which are frozen, whoever holds them."""
    return must_rest, tuple(
        (r.source, tuple(map(id, r.joints)), tuple(map(id, r.sus))) for r in recordings
    )


def _sampled(sampled: list[Sampled], su_names: tuple[str, ...], *_: object) -> Hashable:
    """What first features depend on."""
    return tuple(map(id, sampled)), tuple(su_names)
