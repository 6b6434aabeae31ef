"""PTU files: every type of tag, bad headers, and what is written, read back by us and ptufile."""

import struct
import tracemalloc

import numpy as np
import ptufile
import pytest
from ptu_samples import END, T2, every_source, tags_of
from ptufile.ptufile import encode_tag

from deepfsi.base.errors import InputError
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.reader import read_markers, summarise
from shared.disks import nearly_full


@every_source
def test_all_types_of_tags_may_stand_before_the_records(tmp_path, opened):
    array = struct.pack("<32siIq3d", b"Array", -1, 0x2001FFFF, 24, 1.5, -2, 3)
    colour = struct.pack("<32siIq", b"Colour", -1, 0x12000008, 0xFF8000)
    bits = struct.pack("<32siIq", b"Bits", -1, 0x11000008, 5)
    date = struct.pack("<32siId", b"Date", -1, 0x21000008, 45000.25)
    more = {"Yes": True, "Ansi": "µs", "Wide": "λ = 3", "Blob": b"\1\2", "None": None}
    path = tmp_path / "tags.ptu"
    curve = encode_tag("TTResult_NumberOfRecords", 5, 0)  # of a curve, not of the file
    head = tags_of(T2, 1, **more) + array + colour + bits + date + curve + END
    path.write_bytes(head + struct.pack("<I", 5))
    assert (opened(path).header.offset, opened(path).header.records) == (len(head), 1)


def long_tag(size: int) -> bytes:
    return struct.pack("<32siIq", b"Long", -1, 0x4001FFFF, size)


HEADER = tags_of(T2, 1)
WORD = struct.pack("<I", 5)
BAD_HEADERS = {
    "empty": (b"", "not a PTU file"),
    "cut in a tag": ((HEADER + END)[:-20], "has no end"),
    "endless": (HEADER + encode_tag("More", 1) * (2**22 // 48) + END, "has no end"),
    "cut in a text": (HEADER + long_tag(5000) + END + WORD, "has no end"),
    **{
        f"{size} bytes": (HEADER + long_tag(size) + END + WORD, f"is of {size} bytes")
        for size in (-1, 2**40)
    },
}
for name, changes, message in [
    ("no type", {"TTResultFormat_TTTRRecType": "absent"}, "unknown type None"),
    ("unknown type", {"TTResultFormat_TTTRRecType": 0x00010208}, "unknown type 66056"),
    *(
        (f"tick of {tick}", {"MeasDesc_GlobalResolution": tick}, "time resolution")
        for tick in ("absent", float("nan"))
    ),
]:
    BAD_HEADERS[name] = (tags_of(T2, 1, **changes) + END + WORD, message)


@every_source
@pytest.mark.parametrize(("content", "message"), BAD_HEADERS.values(), ids=BAD_HEADERS)
def test_bad_headers_give_one_line_and_take_no_memory(tmp_path, content, message, opened):
    path = tmp_path / "bad.ptu"
    path.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(InputError, match=message) as error:
        opened(path)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 30e6


# Writing ----------------------------------------------------------------------------------------


def test_what_is_written_is_read_back_by_us_and_by_ptufile(tmp_path):
    rng, n = np.random.default_rng(4), 5000
    steps = rng.integers(0, 10**6, n)
    steps[[10, 11, 400]] = 2**25, 2**35, 3 * 2**48  # pauses of one overflow and of many
    times = np.cumsum(steps)
    codes = rng.integers(-15, 64, n).astype(np.int16)
    path = tmp_path / "new" / "a.ptu"
    with PtuWriter(path, tick_s=5e-12) as writer:
        for part in np.array_split(np.arange(n), [0, 1, 11, 12, 3000]):
            writer.write(times[part], codes[part])
    assert list(path.parent.iterdir()) == [path]

    contents = summarise(path)
    photons, markers = codes >= 0, codes < 0
    inputs = np.unique(codes[photons] + 1, return_counts=True)
    assert contents.photons == dict(zip(*inputs, strict=True))
    assert (contents.span_s, contents.tick_s) == (times[-1] * 5e-12, 5e-12)
    assert contents.problems == ()
    found = read_markers(path)
    assert np.array_equal(found[0], times[markers])
    assert np.array_equal(found[1], -codes[markers])
    with ptufile.PtuFile(path) as theirs:
        events = theirs.decode_records()
        assert theirs.number_records == contents.records == len(events)
        assert theirs.global_resolution == 5e-12
        assert theirs.tags["CreatorSW_Name"] == "deepfsi"
    kept = (events["channel"] >= 0) | (events["marker"] > 0)
    assert np.array_equal(events["time"][kept], times)
    assert np.array_equal(np.where(photons, codes, -1), events["channel"][kept])


def test_a_growing_file_loses_no_record_in_silence(tmp_path):
    """A disk that fills up within a write: an error, and before it whole records alone."""
    path, times, codes = tmp_path / "a.ptu", np.arange(1000) * 1000, np.zeros(1000, int)
    with PtuWriter(path, growing=True) as writer:
        writer.write(times, codes)
        full = nearly_full(path.stat().st_size + 2002)
        with full, pytest.raises(InputError, match=r"cannot write .*a.ptu: File too large"):
            writer.write(times + 10**6, codes)
    contents = summarise(path)
    assert contents.photons == {1: 1000}
    assert contents.problems == ()


def test_a_stopped_writer_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.ptu"
    path.write_text("before")

    def stop() -> None:
        with PtuWriter(path) as writer:
            writer.write(np.array([5]), np.array([0]))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop()
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_text() == "before"


@pytest.mark.parametrize(
    ("times", "codes", "message"),
    [
        ([5, 4], [0, 0], "run back"),
        ([2], [0], "run back"),
        ([2**55 + 1], [0], "2.55 ticks"),
        ([5], [64], "0 to 63"),
    ],
)
def test_events_that_cannot_be_are_refused(tmp_path, times, codes, message):
    def write() -> None:
        with PtuWriter(tmp_path / "a.ptu") as writer:
            writer.write(np.array([3]), np.array([1]))
            writer.write(np.array([], int), np.array([], int))
            writer.write(np.array(times), np.array(codes))

    with pytest.raises(InputError, match=message):
        write()
    assert not list(tmp_path.iterdir())
