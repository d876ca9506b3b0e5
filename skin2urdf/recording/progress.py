"""How much of a log has been read: a share that knows the bytes behind it."""

from __future__ import annotations


class Share(float):
    """A share of the work in [0, 1], which can be used as any number.

    Rate and time left follow from the bytes and the time between two of them.

    Attributes:
        done: bytes of the log that have been read.
        total: bytes that it has.
    """

    done: int
    total: int

    def __new__(cls, share: float, done: int, total: int) -> Share:
        """Make one of a share and of the bytes of the log that is being read."""
        new = super().__new__(cls, share)
        new.done, new.total = done, total
        return new

    def among(self, number: int, logs: int) -> Share:
        """The same as a share of several logs, of which this one has that number."""
        return Share((number + self) / logs, self.done, self.total)
