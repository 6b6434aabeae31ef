"""CIFAR-10 of twenty images a batch, in its two forms."""

from __future__ import annotations

import numpy as np

from deepfsi.datasets import cifar

BATCH = 20

RECORDS = np.random.default_rng(8).integers(0, 256, (6, BATCH, 3073), dtype=np.uint8)

RECORDS[..., 0] = np.arange(BATCH) % 10

RECORDS[0, :, 0] = RECORDS[0, ::-1, 0]

BINARY = {
    f"{name}.bin": records.tobytes() for name, records in zip(cifar.BATCHES, RECORDS, strict=True)
}


def python_2_pickle(records):
    """A batch as the official archive has it: protocol 2, with Python 2's strings."""

    def string(content):
        return b"T" + len(content).to_bytes(4, "little") + content

    def number(value):
        return b"J" + value.to_bytes(4, "little", signed=True)

    n = len(records)
    dtype = b"cnumpy\ndtype\n(" + string(b"u1") + number(0) + number(1) + b"tR("
    dtype += number(3) + string(b"|") + b"NNN" + number(-1) + number(-1) + number(0) + b"tb"
    array = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(" + number(0) + b"t"
    array += string(b"b") + b"tR(" + number(1) + b"(" + number(n) + number(3072) + b"t" + dtype
    array += b"I00\n" + string(records[:, 1:].tobytes()) + b"tb"
    labels = b"](" + b"".join(number(int(label)) for label in records[:, 0]) + b"e"
    return (
        b"\x80\x02}("
        + (string(b"batch_label") + string(b"training batch 1 of 5"))
        + (string(b"labels") + labels)
        + (string(b"data") + array)
        + (string(b"filenames") + b"]" + b"u.")
    )


PYTHON = {
    name: python_2_pickle(records) for name, records in zip(cifar.BATCHES, RECORDS, strict=True)
}
