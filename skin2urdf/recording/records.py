"""What a log holds once it is read: streams of joint positions and specific forces."""

from __future__ import annotations

from dataclasses import dataclass, replace

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.shelf import put_away


@dataclass(frozen=True, eq=False)
class JointStream(Record):
    """Positions of one joint (one DoF).

    Attributes:
        name: joint name as in the log.
        time: (N,) strictly increasing times [s] since the recording's start.
        position: (N,) measured positions [rad, or m for a prismatic joint].
        stamp_noise: scatter of the stamps, one by one, that the times were made from [s].
        effort: (N,) measured torques [N m, or N for a prismatic joint], as the log holds them, NaN
            where single ones are missing; None where there are none.
    """

    name: str
    time: F64
    position: F64
    stamp_noise: float = 0.0
    effort: F64 | None = None

    def at(self, rows: Int | Bool | slice) -> JointStream:
        """Some of the samples.

        Args:
            rows: their numbers, or (N,) True for them.
        """
        effort = None if self.effort is None else self.effort[rows]
        return replace(self, time=self.time[rows], position=self.position[rows], effort=effort)


@dataclass(frozen=True, eq=False)
class SuStream(Record):
    """Readings of one skin unit (SU).

    Attributes:
        name: the SU's name (its frame_id where that is unique, else made from the topic).
        time: (N,) strictly increasing times [s] since the recording's start.
        specific_force: (N, 3) readings in the SU's own frame, as the log holds them [m/s^2].
        topic: the topic the readings came on.
        angular_velocity: (N, 3) readings of its gyroscope in its own frame, as the log holds them
            [rad/s], NaN where single ones are missing; None where there is no gyroscope.
    """

    name: str
    time: F64
    specific_force: F64
    topic: str = ""
    angular_velocity: F64 | None = None

    def put_away(self) -> None:
        """Tell the system that the samples are not needed soon, where they are not in memory."""
        put_away(self.time, self.specific_force, self.angular_velocity)

    def at(self, rows: Int | Bool | slice) -> SuStream:
        """The stream with some of its samples.

        Args:
            rows: their numbers, or (N,) True for them.
        """
        rates = self.angular_velocity
        return replace(
            self,
            time=self.time[rows],
            specific_force=self.specific_force[rows],
            angular_velocity=None if rates is None else rates[rows],
        )


@dataclass(frozen=True, eq=False)
class Recording:
    """One log: everything the calibration may know.

    Attributes:
        joints: one stream per joint, sorted by name.
        sus: one stream per SU, sorted by name.
        start: time of the first sample [s since the Unix epoch].
        source: where it came from (a path), for messages.
        digest: SHA-256 of the input bytes (hex), empty for a recording made in memory, of which a
            calibration takes times for stamps (:mod:`~skin2urdf.recording.retiming`).
        notes: what the reader mended or passed over.
    """

    joints: tuple[JointStream, ...]
    sus: tuple[SuStream, ...]
    start: float = 0.0
    source: str = ""
    digest: str = ""
    notes: tuple[ReadingNote, ...] = ()

    @property
    def joints_together(self) -> tuple[tuple[JointStream, ...], ...]:
        """The joints, those with the same times together: they came in the same messages."""
        together: dict[bytes, list[JointStream]] = {}
        for joint in self.joints:
            together.setdefault(joint.time.tobytes(), []).append(joint)
        return tuple(map(tuple, together.values()))

    @property
    def duration(self) -> float:
        """Time from the first to the last sample of any stream [s]."""
        streams: tuple[JointStream | SuStream, ...] = (*self.joints, *self.sus)
        ends = [s.time[-1] for s in streams if s.time.size]
        starts = [s.time[0] for s in streams if s.time.size]
        return float(max(ends) - min(starts)) if ends else 0.0
