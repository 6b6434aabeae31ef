"""Lists of scenes: names and labels as they stand, or one line that says which is wrong."""

import pytest

from deepfsi.base.errors import InputError
from deepfsi.lab.design_data import listed_scenes


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("a\nb\n", [("a", None), ("b", None)]),
        ("name,label\r\na , 1\r\n\r\nb,\r\n", [("a", "1"), ("b", None)]),
        ('Scene,class\n"one, two",x\n', [("one, two", "x")]),
        ("\ufeffä/ß.png,größe\n", [("ä/ß.png", "größe")]),
        ("a,1\na,1\n", [("a", "1"), ("a", "1")]),  # shown twice
        ("file;class\ra;1\rb;2\r", [("a", "1"), ("b", "2")]),  # Excel of old Macs in Europe
        ("a,cafe\u0301\n", [("a", "caf\u00e9")]),
        ("image,cat\nb,dog\n", [("image", "cat"), ("b", "dog")]),  # a name, no heading
    ],
)
def test_scenes_are_read_in_their_order(tmp_path, text, wanted):
    path = tmp_path / "scenes.csv"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        path.write_bytes(text.removeprefix("\ufeff").encode(encoding))
        assert [(scene.name, scene.label) for scene in listed_scenes(path, None)] == wanted


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "has no scenes"),
        (b"a,1\nb,2,3\n", "cannot read .* as a table"),
        (b"\xff\xfe\x00", "no text in UTF-8"),
        (b"a" * 2000, "cannot be used at name"),
        (None, "is missing"),
    ],
)
def test_other_lists_are_refused_in_one_line(tmp_path, content, match):
    path = tmp_path / "scenes.txt"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=match) as error:
        listed_scenes(path, None)
    assert "\n" not in str(error)
