"""Read a rosbag2 database (sqlite3 storage, ``.db3``) and hand out its messages, block by block."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import numpy as np

from skin2urdf.errors import UnreadableInputError
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import UNWANTED, Block, Channel, Channels
from skin2urdf.recording.chunks import LARGEST_JOINED, LARGEST_UNPACKED
from skin2urdf.recording.framing import BATCH
from skin2urdf.recording.gather import grouped
from skin2urdf.recording.inputs import LogFile
from skin2urdf.recording.messages import canonical_type
from skin2urdf.recording.naming import printable

# What a table has to be made of: columns that are stored, not worked out.
COLUMNS = {"topics": ("id", "name", "type"), "messages": ("topic_id", "timestamp", "data")}
# Rows that are fetched at a time.
ROWS = 1024
# Pages that follow in a circle hand out rows without end; true ones are in the file once.
MOST_READ = 2
WHAT_TO_DO = "try `sqlite3 {path} .recover`, or record again, best with `ros2 bag record -s mcap`"


@dataclass(eq=False)
class Database:
    """One rosbag2 database; what is known about it grows as its blocks are handed out.

    A database runs what it holds: views, triggers and computed columns are not used, and its
    schema is not trusted.

    Attributes:
        file: the file.
        channels: the channels of the whole log, which this file's are added to.
        profile: "ros2".
        compressions: "sqlite3", which compresses nothing.
        notes: what was damaged or missing.
        position: how far the file has been read, about [byte].
    """

    file: LogFile
    channels: Channels
    profile: str = "ros2"
    compressions: set[str] = field(default_factory=lambda: {"sqlite3"})
    notes: list[ReadingNote] = field(default_factory=list)
    position: int = 0

    def blocks(self) -> Iterator[Block]:
        """Hand out the messages of all wanted channels.

        Yields:
            Blocks in the order in which the messages were written.

        Raises:
            UnreadableInputError: the file is no database, or not one of rosbag2.
        """
        try:
            with contextlib.closing(_opened(self.file.path)) as database:
                numbers = self._topics(database)
                yield from self._messages(database, numbers)
        # Python makes no words of what SQLite says about a schema that is no text.
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            unspoken = isinstance(error, UnicodeDecodeError)
            what = "its schema is no text" if unspoken else printable(str(error))
            if self.position:
                words = (
                    f"the database is damaged ({what}); the messages before the damage were read"
                )
                self.notes.append(ReadingNote("damaged", words))
                return
            raise UnreadableInputError(
                str(self.file.path),
                f"the database can not be read: {what}",
                WHAT_TO_DO.format(path=self.file.path),
            ) from error

    def _topics(self, database: sqlite3.Connection) -> dict[int, int]:
        """The number of each topic among the channels."""
        for table, columns in COLUMNS.items():
            if not _is_plain(database, table, columns):
                raise UnreadableInputError(
                    str(self.file.path),
                    f"this is not a rosbag2 database: it has no table {table} with "
                    f"{', '.join(columns)}",
                    "give the .db3 file of a bag; `ros2 bag record` writes one",
                    "another format",
                )
        stored = _is_plain(database, "topics", ("serialization_format",))
        encoding = "serialization_format" if stored else "'cdr'"
        numbers: dict[int, int] = {}
        query = f"SELECT id, name, type, {encoding} FROM topics"  # noqa: S608  (one of two words)
        for key, *words in database.execute(query):
            if isinstance(key, int) and all(isinstance(word, str) for word in words):
                topic, ros_type, encoded = map(printable, words)
                channel = Channel(topic, canonical_type(ros_type), encoded)
                numbers[key] = self.channels.number(channel)
            else:
                what = "a topic is damaged; its messages were left out"
                self.notes.append(ReadingNote("damaged", what))
        return numbers

    def _messages(self, database: sqlite3.Connection, numbers: dict[int, int]) -> Iterator[Block]:
        """Hand out the messages in blocks."""
        wanted = {key: number for key, number in numbers.items() if number != UNWANTED}
        if not wanted:
            return
        # SQLite reads a row's first columns without its payload, and skips what is not wanted.
        query = "SELECT topic_id, timestamp, data FROM messages"
        rows = database.execute(query)
        taken: list[tuple[int, int, bytes]] = []
        size = read = unknown = 0
        while some := rows.fetchmany(ROWS):
            for key, time, data in some:
                number = numbers.get(key) if isinstance(key, int) else None
                if number is None or not isinstance(time, int) or not isinstance(data, bytes):
                    unknown += 1
                    continue
                read += len(data) + 16
                if number != UNWANTED:
                    taken.append((number, time, data))
                    size += len(data)
            self.position = min(read, self.file.size)
            if len(taken) >= BATCH or size >= LARGEST_JOINED:
                yield from self._blocks(taken)
                taken, size = [], 0
            if read > MOST_READ * self.file.size or unknown > self.file.size:
                words = "the database hands out more than it can hold: it is damaged"
                self.notes.append(ReadingNote("damaged", words))
                break
        if taken:
            yield from self._blocks(taken)
        if unknown:
            words = f"{unknown} messages are damaged or of no topic; left out"
            self.notes.append(ReadingNote("damaged", words, number=unknown))

    def _blocks(self, taken: list[tuple[int, int, bytes]]) -> Iterator[Block]:
        """Messages sorted by what they hold."""
        number = np.array([row[0] for row in taken], np.int64)
        time = np.array([row[1] for row in taken], np.int64)
        length = np.array([len(row[2]) for row in taken], np.int64)
        buffer = np.frombuffer(b"".join(row[2] for row in taken), np.uint8)
        end = np.cumsum(length)
        kinds = np.array(self.channels.kind)[number]
        for rows in grouped(kinds):
            ros_type, encoding = self.channels.kinds[int(kinds[rows[0]])]
            yield Block(
                ros_type,
                encoding,
                channel=number[rows],
                buffer=buffer,
                start=end[rows] - length[rows],
                end=end[rows],
                log_time=time[rows],
            )


def _opened(path: Path) -> sqlite3.Connection:
    """Open a database for reading only."""
    # What was not yet moved from a write-ahead log into the database counts as well. Without one
    # nothing is locked, so that a bag on a medium that can not be written to opens too.
    waiting = path.with_name(f"{path.name}-wal").exists()
    how = "mode=ro" if waiting else "mode=ro&immutable=1"
    database = sqlite3.connect(f"file:{quote(str(path.absolute()))}?{how}", uri=True)
    database.text_factory = lambda raw: raw.decode(errors="replace")
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_UNPACKED)
    for setting in ("trusted_schema=OFF", "query_only=ON", "cell_size_check=ON"):
        database.execute(f"PRAGMA {setting}")
    return database


def _is_plain(database: sqlite3.Connection, table: str, columns: tuple[str, ...]) -> bool:
    """Whether there is a table, no view and no virtual one, that stores these columns."""
    kinds = database.execute(
        "SELECT type, rootpage FROM sqlite_master WHERE name = ?", (table,)
    ).fetchall()
    if not any(kind == "table" and isinstance(root, int) and root > 0 for kind, root in kinds):
        return False
    stored = {row[1] for row in database.execute(f"PRAGMA table_xinfo({table})") if row[6] == 0}
    return stored.issuperset(columns)
