"""Unpack what rosbag2 compresses beside the storage: whole files, and messages one by one."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from skin2urdf.errors import Unreadable, UnreadableInputError
from skin2urdf.magic import ZSTD_MAGIC
from skin2urdf.notes import ReadingNote
from skin2urdf.recording.blocks import Block
from skin2urdf.recording.chunks import LARGEST_JOINED
from skin2urdf.recording.gather import gather
from skin2urdf.recording.inputs import LogFile
from skin2urdf.recording.naming import printable

# Messages of a log differ in their stamps at least, which leaves more than two of some hundred
# bytes; what unpacks to more than this many times its size, and is large, was made to.
LARGEST_RATIO = 256
LEAST_FILE, LEAST_MESSAGE = 1 << 28, 1 << 16
# Room that has to be left on the disk that a file is unpacked to [byte].
ROOM = 1 << 28
PIECE = 1 << 22


@contextlib.contextmanager
def unpacked(file: LogFile) -> Iterator[tuple[Path, str]]:
    """Unpack a file that is compressed as a whole into a temporary one, gone in the end.

    Args:
        file: a zstd file.

    Yields:
        The plain file, and a note on it for the user, empty where all is well.

    Raises:
        UnreadableInputError: nothing can be unpacked, or there is no room for it.
    """
    import zstandard

    limit = max(LARGEST_RATIO * file.size, LEAST_FILE)
    note = ""
    with tempfile.TemporaryDirectory(prefix="skin2urdf_") as folder:
        # Called as the file itself is, without its last suffix, for messages.
        plain = Path(folder) / (file.path.stem[-200:] or "log")
        size = 0
        try:
            with plain.open("wb") as out:
                for piece in _pieces(file):
                    size += len(piece)
                    if size > limit:
                        raise _refused(
                            file, f"it unpacks to more than {limit >> 20} MiB", "too large"
                        )
                    if shutil.disk_usage(folder).free < ROOM + len(piece):
                        raise _refused(file, f"there is no room in {folder} to unpack it")
                    out.write(piece)
        except (zstandard.ZstdError, MemoryError) as error:
            if not size:
                raise _refused(file, f"zstd: {error}") from error
            note = "the file is damaged or cut; what came before the damage was unpacked"
        except OSError as error:
            raise _refused(file, f"it can not be unpacked: {error.strerror}") from error
        if not size:
            raise _refused(file, "nothing is in it, as after a copy that was cut")
        yield plain, note


def _pieces(file: LogFile) -> Iterator[bytes]:
    """The plain bytes of a zstd file of one or more frames, piece by piece."""
    import zstandard

    file.stream.seek(0)
    reader = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(
        file.stream, read_across_frames=True, closefd=False
    )
    while piece := reader.read(PIECE):
        yield piece


def _refused(file: LogFile, what: str, why: Unreadable = "") -> UnreadableInputError:
    remedy = f"unpack it with `zstd -d {printable(str(file.path))}`, and give that"
    return UnreadableInputError(str(file.path), what, remedy, why)


def plain_messages(block: Block, notes: list[ReadingNote]) -> Iterator[Block]:
    """Unpack the messages of a block that are compressed one by one.

    Args:
        block: messages, compressed or not.
        notes: what was left out is added to these.

    Yields:
        The block itself where nothing is compressed, else its messages in blocks of some size.
    """
    long_enough = block.end - block.start >= len(ZSTD_MAGIC)
    head = gather(block.buffer, block.start[long_enough], f"V{len(ZSTD_MAGIC)}")
    packed = np.zeros(block.start.size, np.bool_)
    packed[long_enough] = head.view("u4") == np.frombuffer(ZSTD_MAGIC, "u4")[0]
    if not packed.any():
        yield block
        return
    import zstandard

    unpacker = zstandard.ZstdDecompressor()
    plain: list[bytes] = []
    rows: list[int] = []
    size = damaged = 0
    for row in range(block.start.size):
        data = block.buffer[block.start[row] : block.end[row]]
        if packed[row]:
            most = max(LARGEST_RATIO * data.size, LEAST_MESSAGE)
            try:
                # What a frame claims is allocated, so that the claim is looked at first.
                whole = zstandard.frame_content_size(data.data) <= most
                content = unpacker.decompress(data.data, max_output_size=most) if whole else b""
            except (zstandard.ZstdError, MemoryError):
                content = b""
            if not content:
                damaged += 1
                continue
        else:
            content = data.tobytes()
        plain.append(content)
        rows.append(row)
        size += len(content)
        if size >= LARGEST_JOINED:
            yield _of(block, rows, plain)
            plain, rows, size = [], [], 0
    if rows:
        yield _of(block, rows, plain)
    if damaged:
        words = f"{damaged} compressed messages are damaged or far too large; left out"
        notes.append(ReadingNote("damaged", words, number=damaged))


def _of(block: Block, rows: list[int], plain: list[bytes]) -> Block:
    """Some messages of a block with other bytes."""
    end = np.cumsum([len(content) for content in plain])
    return replace(
        block,
        channel=block.channel[rows],
        buffer=np.frombuffer(b"".join(plain), np.uint8),
        start=np.concatenate([[0], end[:-1]]).astype(np.int64),
        end=end.astype(np.int64),
        log_time=block.log_time[rows],
    )
