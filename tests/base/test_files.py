"""Files are written whole or not at all, and text is read as any editor saves it."""

import os

import pytest

from deepfsi.base.errors import InputError
from deepfsi.base.files import GrowingFile, new_folder, read_text, read_toml, write_atomically
from shared.disks import nearly_full


def filled(folder):
    with new_folder(folder) as draft:
        (draft / "a").write_bytes(bytes(200))


def test_nothing_is_left_of_what_cannot_be_written(tmp_path):
    """Onto a folder, or on a full disk."""
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*folder: Is a directory"):
        write_atomically(tmp_path / "folder", b"content")
    for write in (lambda path: write_atomically(path, bytes(200)), filled):
        with nearly_full(100), pytest.raises(InputError, match="too large; nothing of it"):
            write(tmp_path / "new")
    assert os.listdir(tmp_path) == ["folder"]


def test_a_growing_file_takes_all_bytes_however_few_the_disk_takes_at_a_time(tmp_path, monkeypatch):
    usual = os.write
    monkeypatch.setattr(os, "write", lambda file, part: usual(file, part[:7]))
    with GrowingFile(tmp_path / "file") as file:
        assert [file.write(bytes(range(100))), file.write(b"end")] == [100, 3]
    assert (tmp_path / "file").read_bytes() == bytes(range(100)) + b"end"


def test_a_growing_file_on_a_full_disk_keeps_whole_parts_and_says_so(tmp_path, monkeypatch):
    """Where the disk fails, and where `write` takes nothing and says nothing."""
    with GrowingFile(tmp_path / "file") as file:
        file.write(b"12345678" * 10)
        with nearly_full(100), pytest.raises(InputError, match=r"cannot write .*file: File"):
            file.write(b"12345678" * 10)
        assert (tmp_path / "file").stat().st_size == 80
        file.seek(0)
        file.write(b"start")  # as the header of a recording is written again
        file.seek(80)
        monkeypatch.setattr(os, "write", lambda file, part: 0)
        with pytest.raises(InputError, match="No space left on device; its first 80 bytes"):
            file.write(b"more")
    assert (tmp_path / "file").read_bytes() == b"start678" + b"12345678" * 9


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_text_is_the_same_from_every_editor(tmp_path, encoding, end):
    path = tmp_path / "file"
    path.write_bytes(f"a = 'ü'{end}b = 2{end}".encode(encoding))
    assert read_text(path, 100, "") == "a = 'ü'\nb = 2\n"
    assert read_toml(path) == {"a": "ü", "b": 2}


@pytest.mark.parametrize(
    "content", [b"a\0b", b"a\0b\0", b"\xff\xfea", b"\x81\x8d", b"PK\x03\x04\0"]
)
def test_what_is_no_text_is_one_line(tmp_path, content):
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(InputError, match="no text in UTF-8: save it again") as error:
        read_text(tmp_path / "file", 100, "save it again")
    assert "\n" not in str(error.value)
