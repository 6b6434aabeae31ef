"""Mutations of valid files, each drawn from a generator: the same seed gives the same bytes."""

import io
import json
import random
import struct
import zipfile
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
from safetensors.numpy import load, save

Mutation = Callable[[random.Random, bytes], bytes]

VALUES: list[Any] = [
    *(-1, 0, 1, 2, 3, 63, 65, 255, 2**31, 10**9, 2**63, 2**64, 10**30, -(10**30), 0.5),
    *(1e-300, 1e-30, 1e30, 1e308, -1e308, float("nan"), float("inf"), -float("inf")),
    *(None, True, False, "", "x", "\0", "1", "nan", "../../x", "é" * 300, "x" * 100_000),
    *([], {}, [[]], [None], [0], [1] * 1000, [10**9] * 2, {"x": 1}, [[1.0] * 3] * 3),
]
"""What a field is replaced by."""

EXTREMES = [
    *(struct.pack(f"<{kind}", value) for kind in "iqd" for value in (0, 1, -1, 10**9)),
    *(b"\xff" * 8, b"\x7f" + b"\xff" * 7, b"\0" * 16, struct.pack("<d", float("nan"))),
]
"""Bytes that stand for numbers at the ends of their ranges."""


def mangled(rng: random.Random, content: bytes) -> bytes:
    """Bytes flipped, set, cut, repeated or left out, at a few places."""
    out = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        place, length = rng.randrange(len(out) + 1), rng.choice((1, 2, 4, 8, 64, 1024))
        kind = rng.randrange(7)
        if kind == 0 and place < len(out):
            out[place] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[place : place + length] = rng.randbytes(min(length, 64))
        elif kind == 2:
            new = rng.choice(EXTREMES)
            out[place : place + len(new)] = new
        elif kind == 3:
            del out[place : place + length]
        elif kind == 4:
            out[place:place] = out[place : place + length]
        elif kind == 5:  # headers are at the beginning
            near = rng.randrange(min(len(out), 400) + 1)
            new = rng.choice(EXTREMES)
            out[near : near + len(new)] = new
        elif rng.random() < 0.3:
            del out[place:]
    return bytes(out)


def _changed(rng: random.Random, held: Any) -> None:
    """Replace a field of JSON, leave it out, or add one."""
    keys = list(held) if isinstance(held, dict) else list(range(len(held)))
    deep = [key for key in keys if isinstance(held[key], dict | list) and held[key]]
    if deep and rng.random() < 0.75:
        return _changed(rng, held[rng.choice(deep)])
    kind, key, value = rng.randrange(8), rng.choice(keys), deepcopy(rng.choice(VALUES))
    if kind == 0:
        del held[key]
    elif kind > 1:
        held[key] = value
    elif isinstance(held, dict):
        held["unknown"] = value
    else:
        held.append(value)


def changed_json(rng: random.Random, content: bytes) -> bytes:
    """A JSON table of which a field or two are others, or which is nested without an end."""
    held = json.loads(content)
    for _ in range(rng.choice((1, 1, 2))):
        if held:
            _changed(rng, held)
    text = json.dumps(held)
    if rng.random() < 0.02:
        text = text.replace(":", ":" + rng.choice(("[", '{"a":')) * 100_000, 1)
    return text.encode()


def changed_lines(rng: random.Random, content: bytes) -> bytes:
    """JSON line by line, one of them changed."""
    lines = content.splitlines()
    place = rng.randrange(len(lines))
    lines[place] = changed_json(rng, lines[place])
    return b"\n".join(lines) + b"\n"


LITERALS = [
    *("-1", "0", "1e9", "1000000000", "1e-300", "1e308", "nan", "inf", '""', '"x"', "true", "[]"),
    *("{}", "[[]]", "9" * 5000, "[1, 2]", '"1e400s"', '"10ms"', '"../x.npy"', "1979-05-27"),
    *("[" * 2000, "{a = " * 500, '"\\u0000"', "[1e9, 1e9]", '"mlp"', "[" + "1," * 5000 + "1]"),
    *("'999999999999x9'", '"9999x9999"', "[" * 100 + "1" + "]" * 100),
]
"""What a value of TOML is replaced by."""


def changed_toml(rng: random.Random, content: bytes) -> bytes:
    """TOML of which values are others."""
    lines = content.decode().splitlines()
    for _ in range(rng.choice((1, 1, 2))):
        place = rng.randrange(len(lines))
        name, found, _ = lines[place].partition("=")
        if found:
            lines[place] = f"{name} = {rng.choice(LITERALS)}"
        else:
            lines.insert(place, rng.choice(("x = 1", "[x]", "[[x]]", "a." * 2000 + "b = 1")))
    return "\n".join(lines).encode()


CELLS = [b"", b"-1", b"nan", b"inf", b"1e400", b'"', b"x", b"\0", b"\xff", b"1,1", b"9" * 400]


def changed_table(rng: random.Random, content: bytes) -> bytes:
    """Lines of a table with another cell, or with many more columns."""
    lines = content.splitlines()
    place = rng.randrange(len(lines))
    cells = lines[place].split(b",")
    if rng.random() < 0.01:
        cells = cells * (20_000 // len(cells))
    cells[rng.randrange(len(cells))] = rng.choice(CELLS)
    lines[place] = b",".join(cells)
    return b"\n".join(lines)


def changed_tensors(rng: random.Random, content: bytes) -> bytes:
    """A safetensors file with another text in its header, or another tensor."""
    metadata = json.loads(content[8 : 8 + struct.unpack("<Q", content[:8])[0]])["__metadata__"]
    tensors = {name: array.copy() for name, array in load(content).items()}
    name, kind = rng.choice(list(tensors)), rng.randrange(10)
    if kind < 5:
        key = next(iter(metadata))
        metadata[key] = changed_json(rng, metadata[key].encode()).decode()
    elif kind == 5:
        tensors[name] = tensors[name].astype(rng.choice(("f8", "i4", "f2", "u1", "?", "i8")))
    elif kind == 6:
        del tensors[name]
    elif kind == 7:
        deeper = not tensors[name].ndim or rng.random() < 0.5
        tensors[name] = tensors[name][..., None] if deeper else tensors[name].T[:1]
    elif tensors[name].size:
        value = rng.choice((np.nan, np.inf, -1.0, 0.0, 1e38, 1e-38, 1e30))
        with np.errstate(all="ignore"):
            where = rng.randrange(tensors[name].size) if kind == 8 else slice(None)
            tensors[name].reshape(-1)[where] = np.asarray(value).astype(tensors[name].dtype)
    return save({key: np.ascontiguousarray(held) for key, held in tensors.items()}, metadata)


METHODS = (
    *(zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED),
    *(zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2),
)
NAMES = ("x.npy", "../x.npy", "/x", "a/b/c.png", "x", "\x01", "train/a/1.png", "__MACOSX/x")


def changed_zip(rng: random.Random, content: bytes) -> bytes:
    """A zip file of other entries, names, ways of compression, and marks."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as held, zipfile.ZipFile(out, "w") as file:
        names = held.namelist()
        chosen = rng.choice(names)
        for name in names:
            inside, kind = held.read(name), rng.randrange(5)
            if name == chosen and kind == 0:
                continue
            if name == chosen and kind < 4:
                inside = mangled(rng, inside)
            called = rng.choice(NAMES) if name == chosen and kind == 4 else name
            file.writestr(called, inside, rng.choice(METHODS) if rng.random() < 0.3 else 0)
    whole = bytearray(out.getvalue())
    if rng.random() < 0.5:  # marks of one entry: encrypted, unknown method, another size
        at = whole.rfind(b"PK\1\2") + rng.choice((8, 10, 20, 24, 42))
        whole[at : at + 2] = rng.choice((b"\1\0", b"\x63\0", b"\xff\xff", b"\0\0"))
    return bytes(whole)
