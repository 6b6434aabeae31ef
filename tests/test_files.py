"""Files are written whole or not at all."""

import os
import subprocess
import sys

import pytest

from deepfsi.errors import InputError
from deepfsi.files import remove_drafts, write_atomically


def test_a_write_onto_a_folder_leaves_nothing(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*folder: Is a directory"):
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


WRITES = """
import pathlib, sys, time
from deepfsi.files import new_folder, open_atomically
home = pathlib.Path(sys.argv[1])
with open_atomically(home / "file.json") as file, new_folder(home / "folder") as folder:
    file.write(b"a part")
    (folder / "a file").touch()
    print("writing", flush=True)
    time.sleep(600)
"""


def drafts(folder):
    return list(folder.glob(".*.draft"))


def test_a_killed_process_leaves_drafts_that_the_next_one_removes(tmp_path):
    """Those of a process that runs stay."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITES, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "writing\n"
    remove_drafts(tmp_path)
    assert len(drafts(tmp_path)) == 2
    process.kill()
    process.communicate()
    assert len(drafts(tmp_path)) == 2
    write_atomically(tmp_path / "other", b"content")
    assert os.listdir(tmp_path) == ["other"]


def test_a_draft_of_another_host_goes_after_a_day(tmp_path):
    draft = tmp_path / ".file.0123456789ab-1-1-00000000.draft"
    others = [tmp_path / name for name in (".file.draft", ".file.abc.draft", "file.json")]
    for path in (draft, *others):
        path.touch()
        os.utime(path, (1, 1))
    os.utime(draft)
    remove_drafts(tmp_path)
    assert draft.exists()
    os.utime(draft, (1, 1))
    remove_drafts(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(others)
