"""Read a table (CSV or Parquet) and hand out its rows as messages, block by block.

Each row has a time; a cell that is empty is a sample that was not taken. The rows of a joint or an
SU become messages as a robot would have sent them, so that all that is done with messages, from
repeated stamps to spikes, is done with tables.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.errors import UnreadableInputError
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import UNWANTED, Block, Channel, Channels
from skin2urdf.recording.encode import imu_payloads, joint_state_payloads
from skin2urdf.recording.gather import U8, grouped
from skin2urdf.recording.inputs import LogFile
from skin2urdf.recording.messages import IMU, JOINT_STATE
from skin2urdf.recording.naming import printable
from skin2urdf.recording.table_columns import BadColumnsError, Columns, columns_of

LATEST_STAMP = (2**31 - 1) * 10**9
# Rows that are made messages at a time.
ROWS = 4096
# Cells that are in memory at a time, and a line of a file: many a row of the widest tables.
MOST_CELLS = 1 << 22
LONGEST_LINE = 1 << 22
# Characters of a cell that may be a number; an array of cells has room for the longest in each.
LONGEST_NUMBER = 256
# What a row group of a Parquet file may unpack to [byte]; writers aim at 128 MiB.
LARGEST_GROUP = 1 << 30
_NO_NUMBER = "too long"
REMEDY = (
    "the first line names the columns with their units: `time [s]`, a joint as `elbow [rad]` "
    "([deg], [m], [mm]), its torque as `elbow [Nm]`, an SU as `hand.x [m/s^2]`, "
    "`hand.y [m/s^2]`, `hand.z [m/s^2]` ([g], [mg])"
)


@dataclass(eq=False)
class Table:
    """One table; what is known about it grows as its blocks are handed out.

    Attributes:
        file: the file.
        channels: the channels of the whole log, which this file's are added to.
        profile: "ros2", as its messages are made so.
        compressions: "csv" or "parquet".
        notes: what was damaged or missing.
        position: how far the file has been read, about [byte].
    """

    file: LogFile
    channels: Channels
    profile: str = "ros2"
    compressions: set[str] = field(default_factory=set)
    notes: list[ReadingNote] = field(default_factory=list)
    position: int = 0
    _bad_cells: int = 0
    _bad_rows: int = 0
    _heard: set[str] = field(default_factory=set)
    _last: int = 0

    def blocks(self) -> Iterator[Block]:
        """Hand out the rows as messages.

        Yields:
            Blocks in the order of the rows.

        Raises:
            UnreadableInputError: the columns are not what they should be.
        """
        parquet = self.file.kind == "parquet"
        self.compressions.add(self.file.kind)
        columns: Columns | None = None
        for headers, cells in self._parquet() if parquet else self._csv():
            if columns is None:
                columns = self._columns(headers)
            yield from self._messages(columns, cells)
        if columns is None:
            raise UnreadableInputError(
                str(self.file.path), "the table has no rows", REMEDY, "no rows"
            )
        yield from self._unheard(columns)
        if self._bad_cells:
            words = f"{self._bad_cells} cells are no numbers; taken as empty"
            self.notes.append(ReadingNote("bad cells", words, number=self._bad_cells))
        if self._bad_rows:
            words = (
                f"{self._bad_rows} rows have no time between 1970 and 2038, or are longer or "
                "shorter than the first; left out"
            )
            self.notes.append(ReadingNote("bad rows", words, number=self._bad_rows))

    def _columns(self, headers: Sequence[str]) -> Columns:
        try:
            found = columns_of(headers)
        except BadColumnsError as bad:
            what = f"as a table: {bad}"
            raise UnreadableInputError(str(self.file.path), what, REMEDY, bad.why) from bad
        if found.unused:
            some = ", ".join(printable(name)[:60] or "(no name)" for name in found.unused[:8])
            more = f" and {len(found.unused) - 8} more" if len(found.unused) > 8 else ""
            words = f"columns that are not used: {some}{more}"
            self.notes.append(ReadingNote("unused columns", words, tuple(found.unused)))
        return found

    def _csv(self) -> Iterator[tuple[list[str], F64]]:
        """Headers and (N, C) cells of a text file, NaN where they are empty."""
        lines = self._lines()
        first = next(lines, "")
        delimiter = max(",;\t", key=first.count)
        try:
            reader = csv.reader(_chained(first, lines), delimiter=delimiter)
            headers = next(reader, [])
            rows: list[list[str]] = []
            most = max(1, min(ROWS, MOST_CELLS // max(1, len(headers))))
            for row in reader:
                if len(row) == len(headers):
                    rows.append(row)
                elif row:
                    self._bad_rows += 1
                if len(rows) == most:
                    yield headers, self._numbers(rows, delimiter)
                    rows = []
            if headers:
                yield headers, self._numbers(rows, delimiter)
        except csv.Error as error:
            raise UnreadableInputError(
                str(self.file.path), f"as a table: {error}", REMEDY
            ) from error

    def _lines(self) -> Iterator[str]:
        """The lines of the file, none of them endless."""
        self.file.stream.seek(0)
        with io.BufferedReader(_Kept(self.file), 1 << 20) as stream:
            while line := stream.readline(LONGEST_LINE):
                if len(line) == LONGEST_LINE:
                    raise UnreadableInputError(
                        str(self.file.path),
                        f"as a table: a line is longer than {LONGEST_LINE >> 20} MiB",
                        REMEDY,
                        "long line",
                    )
                encoding = "utf-8-sig" if self.position == 0 else "utf-8"
                self.position += len(line)
                yield line.decode(encoding, errors="replace")

    def _numbers(self, rows: list[list[str]], delimiter: str) -> F64:
        """Cells as numbers; what is none is NaN and counted."""
        if not rows:
            return np.zeros((0, 1))
        if max(len(cell) for row in rows for cell in row) > LONGEST_NUMBER:
            rows = [[c if len(c) <= LONGEST_NUMBER else _NO_NUMBER for c in row] for row in rows]
        text = np.array(rows, dtype=np.str_)
        if delimiter == ";":
            text = np.char.replace(text, ",", ".")
        text = np.char.strip(text)
        text[text == ""] = "nan"
        try:
            return text.astype(np.float64)
        except ValueError:
            numbers = np.array([_number(cell) for cell in text.reshape(-1)]).reshape(text.shape)
            self._bad_cells += int(np.count_nonzero(np.isnan(numbers) & (text != "nan")))
            return numbers

    def _parquet(self) -> Iterator[tuple[list[str], F64]]:
        """Headers and (N, C) cells of a Parquet file, NaN where they are empty."""
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ImportError as error:
            raise UnreadableInputError(
                str(self.file.path),
                "reading Parquet needs the package pyarrow",
                "install it with `pip install 'skin2urdf[parquet]'`, or write the table as CSV",
            ) from error
        try:
            with pq.ParquetFile(self.file.path, memory_map=False, pre_buffer=False) as table:
                headers = [
                    f"{column.name} [ns]" if pa.types.is_timestamp(column.type) else column.name
                    for column in table.schema_arrow
                ]
                for k in range(table.num_row_groups):
                    if table.metadata.row_group(k).total_byte_size > LARGEST_GROUP:
                        words = (
                            f"row group {k} claims more than {LARGEST_GROUP >> 20} MiB; left out"
                        )
                        self.notes.append(ReadingNote("too large", words))
                        continue
                    most = max(1, min(ROWS, MOST_CELLS // max(1, len(headers))))
                    for batch in table.iter_batches(most, row_groups=[k], use_threads=False):
                        cells = np.full((batch.num_rows, len(headers)), np.nan)
                        for c, column in enumerate(batch.columns):
                            cells[:, c] = self._column(pa, column)
                        yield headers, cells
                    self.position = self.file.size * (k + 1) // table.num_row_groups
        except (pa.ArrowException, OSError, MemoryError, ValueError) as error:
            raise UnreadableInputError(
                str(self.file.path),
                f"the Parquet file can not be read: {printable(str(error))[:300]}",
                "write it again, or write the table as CSV",
            ) from error

    def _column(self, pa: Any, column: Any) -> F64:
        """The numbers of one column; times as nanoseconds, NaN for all that is no number."""
        kind = column.type
        if pa.types.is_timestamp(kind):
            column = column.cast(pa.timestamp("ns")).cast(pa.int64())
        elif not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
            return np.full(len(column), np.nan)
        return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))

    def _messages(self, columns: Columns, cells: F64) -> Iterator[Block]:
        """Rows as messages, a block for each joint message and SU."""
        if not len(cells):
            return
        with np.errstate(invalid="ignore", over="ignore"):
            time = cells[:, columns.time] * columns.time_unit
            sound = (time >= 0) & (time <= LATEST_STAMP)
        self._bad_rows += int(np.count_nonzero(~sound))
        cells, stamp = cells[sound], np.rint(time[sound]).astype(np.int64)
        if not stamp.size:
            return
        self._last = int(stamp[-1])
        stem = _topic(self.file.path)
        if columns.joints:
            names = [name for name, _, _ in columns.joints]
            place = [k for _, k, _ in columns.joints]
            position = cells[:, place] * np.array([factor for _, _, factor in columns.joints])
            effort = np.full(position.shape, np.nan)
            for column, name in enumerate(names):
                if name in columns.efforts:
                    effort[:, column] = cells[:, columns.efforts[name]]
            for rows, there in _alike(np.isfinite(position)):
                payload = joint_state_payloads(
                    stamp[rows],
                    [name for name, is_there in zip(names, there, strict=True) if is_there],
                    position[np.ix_(rows, there)],
                    effort[np.ix_(rows, there)] if columns.efforts else None,
                )
                yield from self._block(f"/{stem}", JOINT_STATE, stamp[rows], payload)
        for name, places, factors in columns.sus:
            force = cells[:, list(places)] * np.array(factors)
            rows = np.flatnonzero(np.isfinite(force).all(axis=1))
            if rows.size:
                self._heard.add(name)
                payload = imu_payloads(stamp[rows], name, force[rows])
                yield from self._block(f"/{stem}/{name}", IMU, stamp[rows], payload)

    def _unheard(self, columns: Columns) -> Iterator[Block]:
        """SUs without a single reading, as messages that hold none: that they are there is told."""
        stem, stamp = _topic(self.file.path), np.array([self._last, self._last], dtype=np.int64)
        for name in [name for name, _, _ in columns.sus if name not in self._heard]:
            payload = imu_payloads(stamp, name, np.full((2, 3), np.nan))
            yield from self._block(f"/{stem}/{name}", IMU, stamp, payload)

    def _block(self, topic: str, ros_type: str, stamp: Int, payload: U8) -> Iterator[Block]:
        number = self.channels.number(Channel(printable(topic), ros_type, "cdr"))
        if number == UNWANTED:
            return
        count, length = payload.shape
        start = length * np.arange(count)
        yield Block(
            ros_type, "cdr", np.full(count, number), payload.reshape(-1), start, start + length,
            stamp,
        )  # fmt: skip


class _Kept(io.RawIOBase):
    """A file that stays open when its reader is closed."""

    def __init__(self, file: LogFile) -> None:
        self._file = file

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        return self._file.stream.readinto(buffer) or 0


def _chained(first: str, lines: Iterator[str]) -> Iterator[str]:
    yield first
    yield from lines


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _alike(there: Bool) -> Iterator[tuple[Int, Bool]]:
    """Rows in which the same cells are there, and which these are; without rows of none."""
    kinds, which = np.unique(there, axis=0, return_inverse=True)
    for rows in grouped(which.reshape(-1).astype(np.int64)):
        kind = np.asarray(kinds[which.reshape(-1)[rows[0]]])
        if kind.any():
            yield rows, kind


def _topic(path: Path) -> str:
    """A topic after a file's name."""
    return "".join(c if c.isalnum() or c == "_" else "_" for c in path.name.split(".")[0]) or "log"
