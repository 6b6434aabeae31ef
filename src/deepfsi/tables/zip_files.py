"""Zip files from anywhere: what their entries unpack to is checked before memory is spent."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deepfsi.errors import InputError
from deepfsi.files import check_unpacked, content_of, open_regular

LARGEST = 2**36
"""Bytes of a zip file at most."""

METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Ways of compression that are unpacked."""


@contextmanager
def open_zip(path: Path, advice: str) -> Iterator[zipfile.ZipFile]:
    """Open a zip file, or raise `InputError` if it is none or a bomb."""
    with open_regular(path, LARGEST, advice) as file:
        try:
            archive = zipfile.ZipFile(file)
        except Exception as error:  # zipfile raises almost anything on a damaged directory
            kind = content_of(path)
            held = "it is cut or damaged" if "a zip file" in kind else f"it holds {kind}"
            raise InputError(
                f"cannot read {path} as a zip file ({error}); {held}; {advice}"
            ) from None
        with archive:
            size = sum(info.file_size for info in archive.infolist())
            check_unpacked(size, path.stat().st_size, str(path), advice)
            yield archive


def read_entry(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, where: str, largest: int, advice: str
) -> bytes:
    """Content of an entry of so many bytes at most."""
    if info.flag_bits & 1:
        raise InputError(f"{where} is encrypted; pack it again without a password")
    if info.compress_type not in METHODS:
        raise InputError(f"{where} is compressed in an unusual way; pack it with deflate or none")
    if info.file_size > largest:
        raise InputError(
            f"{where} unpacks to {info.file_size / 1e6:.0f} MB, and {largest / 1e6:.0f} MB are "
            f"allowed; {advice}"
        )
    try:
        with archive.open(info) as entry:
            # asked for no more than is declared, zipfile unpacks no more
            return entry.read(info.file_size + 1)
    except Exception as error:  # zipfile and zlib raise almost anything on damaged data
        raise InputError(f"cannot read {where} ({error}); {advice}") from None
