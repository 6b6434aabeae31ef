"""Files are written whole or not at all."""

import os
import subprocess
import sys

import pytest

from deepfsi.files import write_atomically


def test_a_write_onto_a_folder_leaves_nothing(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        write_atomically(tmp_path / "folder", b"content")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_write_makes_parent_folders_and_a_readable_file(tmp_path):
    path = write_atomically(tmp_path / "a" / "b" / "file", b"content")
    assert path.read_bytes() == b"content"
    umask = os.umask(0)
    os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask


def test_writing_files_needs_no_torch():
    code = "import sys; import deepfsi.files; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
