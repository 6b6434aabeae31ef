"""Headers of PTU files: every type of tag, and bad headers."""

import os
import struct
import tracemalloc

import pytest
from ptu_samples import END, T2, every_reader, tags_of
from ptufile.ptufile import encode_tag

from deepfsi.base.errors import InputError
from deepfsi.hardware.photons.header import read_header


@every_reader
def test_all_types_of_tags_are_read(tmp_path, read):
    array = struct.pack("<32siIq3d", b"Array", -1, 0x2001FFFF, 24, 1.5, -2, 3)
    colour = struct.pack("<32siIq", b"Colour", -1, 0x12000008, 0xFF8000)
    bits = struct.pack("<32siIq", b"Bits", -1, 0x11000008, 5)
    date = struct.pack("<32siId", b"Date", -1, 0x21000008, 45000.25)
    more = {"Yes": True, "No": False, "Ansi": "µs", "Wide": "λ = 3", "Blob": b"\1\2", "None": None}
    path = tmp_path / "tags.ptu"
    path.write_bytes(
        tags_of(T2, 0, **more)
        + array
        + colour
        + bits
        + date
        + encode_tag("Curve", 5, 0)
        + encode_tag("Curve", 7, 1)
        + END
    )
    tags = read.read_header(path).tags
    found = {name: tags[name] for name in more}
    assert found == {**more, "Blob": b"\1\2".ljust(8, b"\0")}
    assert tags["Array"].tolist() == [1.5, -2, 3]
    assert (tags["Colour"], tags["Bits"], tags["Date"]) == (0xFF8000, 5, 45000.25)
    assert (tags["Curve(0)"], tags["Curve(1)"]) == (5, 7)


def long_tag(size: int, code: int = 0x4001FFFF) -> bytes:
    return struct.pack("<32siIq", b"Long", -1, code, size)


HEADER = tags_of(T2, 1)
WORD = struct.pack("<I", 5)
BAD_HEADERS = {
    "empty": (b"", "not a PTU file"),
    "short": (b"PQTT", "not a PTU file"),
    "histogram": (b"PQHISTO\0" + HEADER[8:] + END + WORD, "a histogram, which has no times"),
    "pt3": (b"PicoHarp 300\0\0\0\0" + bytes(700), "older format .* phconvert"),
    "ht2": (b"HydraHarp\0\0\0\0\0\0\0" + bytes(700), "older format .* phconvert"),
    "hdf5": (b"\x89HDF\r\n" + bytes(700), "HDF5 file: .* camera import"),
    "ttbin": (b"SITT" + bytes(700), "Swabian .* FileReader"),
    "text": (b"time,channel\n" * 100, "not a PTU file"),
    "magic only": (HEADER[:16], "without an end"),
    "no end": (HEADER, "without an end"),
    "cut in a tag": ((HEADER + END)[:-20], "without an end"),
    "endless": (HEADER + encode_tag("More", 1) * (2**22 // 48) + END, "without an end"),
    **{
        f"{size} bytes": (HEADER + long_tag(size, code) + END + WORD, f"is of {size} bytes")
        for size in (-1, 2**40, 2**63 - 1, -(2**63), 2**22 + 8, 5000)
        for code in (0x4001FFFF, 0x4002FFFF, 0x2001FFFF, 0xFFFFFFFF)[:: 1 if size == 2**40 else 4]
    },
    "unknown tag": (HEADER + long_tag(5, 0x30000008) + END + WORD, "unknown type 0x30000008"),
}
for name, changes, message in [
    ("no type", {"TTResultFormat_TTTRRecType": "absent"}, "TTTRRecType"),
    ("unknown type", {"TTResultFormat_TTTRRecType": 0x00010208}, "unknown type 0x00010208"),
    ("text for type", {"TTResultFormat_TTTRRecType": "T2"}, "TTTRRecType"),
    ("64 bits", {"TTResultFormat_BitsPerRecord": 64}, "32 bits"),
    ("other mode", {"Measurement_Mode": 3}, "measurement mode"),
    ("text for records", {"TTResult_NumberOfRecords": "many"}, "NumberOfRecords"),
    ("no tick", {"MeasDesc_GlobalResolution": "absent"}, "time resolution"),
    *(
        (f"tick of {tick}", {"MeasDesc_GlobalResolution": tick}, "time resolution")
        for tick in (0.0, -1e-12, float("nan"), float("inf"), 5e-324, 1e300, 1)
    ),
]:
    BAD_HEADERS[name] = (tags_of(T2, 1, **changes) + END + WORD, message)


@every_reader
@pytest.mark.parametrize(("content", "message"), BAD_HEADERS.values(), ids=BAD_HEADERS)
def test_bad_headers_give_one_line_and_take_no_memory(tmp_path, content, message, read):
    path = tmp_path / "bad.ptu"
    path.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(InputError, match=message) as error:
        read.read_header(path)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 30e6


def test_what_is_no_file_is_refused(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for path in (tmp_path, fifo, tmp_path / "absent.ptu"):
        with pytest.raises(InputError, match=r"cannot be read|is missing"):
            read_header(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("a.pt2", "PicoHarp"),
        ("a.HT3", "HydraHarp"),
        ("a.t3r", "TimeHarp"),
        *((f"a.{end}", "histogram, which has no times") for end in ("phu", "phd", "hhd", "thd")),
        ("a.spc", "phconvert"),
        ("a.sdt", "record in FIFO mode"),
        ("a.ttbin", "FileReader"),
        ("tags.csv", "camera import"),
        ("a.bin", "not a PTU file"),
    ],
)
def test_the_name_tells_where_the_first_bytes_do_not(tmp_path, name, said):
    (tmp_path / name).write_bytes(bytes(2000))
    with pytest.raises(InputError, match=said):
        read_header(tmp_path / name)
