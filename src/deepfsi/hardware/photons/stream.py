"""PTU files read while their bytes arrive: from a pipe, or a file that grows.

The header's parser and the records' decoder are those of whole files, so that a stream is read as
the file that it becomes, whatever its cuts. Memory is that of the bytes given at once.
"""

import os
from collections.abc import Iterator

import numpy as np

from deepfsi.hardware.photons import records
from deepfsi.hardware.photons.header import Header, parse_header
from deepfsi.hardware.photons.records import Decoder, Part


class StreamReader:
    """Reader of a PTU file from bytes that arrive in any cuts."""

    def __init__(self, name: str | os.PathLike[str] = "the stream") -> None:
        self.header: Header | None = None  # until it has arrived
        self._parser = parse_header(name)
        self._needed = next(self._parser)
        self._rest = bytearray()  # bytes of the header, or of a record, that is not whole
        self._left = 0  # records to come
        self._decoder: Decoder | None = None

    def feed(self, data: bytes | bytearray | memoryview) -> Iterator[Part]:
        """Read the next bytes, and give what records they end, in parts."""
        # As of a file, none follows a part with a `fault`, and what follows the records that the
        # header gives is not read. Bytes are read as parts are taken, and a part holds on to them
        view = memoryview(data).cast("B")
        if self._decoder is None:
            view = self._feed_header(view)
        if self._decoder is None or not self._left:
            return
        if self._rest:
            view = memoryview(bytes(self._rest) + view)
        whole = min(len(view) // 4, self._left)
        self._rest = bytearray(view[4 * whole :][:3])
        words = np.frombuffer(view, "<u4", whole)
        for first in range(0, whole, records.RECORDS_IN_MEMORY):
            part = self._decoder.decode(words[first : first + records.RECORDS_IN_MEMORY])
            self._left = 0 if part.fault else self._left - len(part.words)
            yield part
            if part.fault:
                return

    def _feed_header(self, view: memoryview) -> memoryview:
        """Parse bytes as far as the header goes, and give those that follow it."""
        while self._decoder is None:
            taken = self._needed - len(self._rest)
            self._rest += view[:taken]
            view = view[taken:]
            if len(self._rest) < self._needed:
                break
            try:
                self._needed = self._parser.send(bytes(self._rest))
            except StopIteration as end:
                self.header = header = end.value
                self._left = header.records
                self._decoder = Decoder(header.kind, header.tick_s)
            self._rest.clear()
        return view
