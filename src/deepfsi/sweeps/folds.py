"""Records of the folds of a data set, put together as if one test had seen all scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from deepfsi.base.numeric import pack_values, unpack_values
from deepfsi.datasets import Dataset

Record = Mapping[str, Any]

PARTS = ("validation", "test")
"""Lists of tests in a record."""


def pooled(data: Dataset, parts: Sequence[Dataset]) -> Dataset:
    """A data set whose test part are those of its folds, one after the other."""
    if len(parts) == 1:
        return parts[0]
    return replace(
        parts[0],
        name=data.name,
        x_test=np.concatenate([part.x_test for part in parts]),
        y_test=np.concatenate([part.y_test for part in parts]),
    )


def together(records: Sequence[Sequence[Record]]) -> list[Record]:
    """Records of the same trials on each fold, in one order, as one record a trial."""
    if len(records) == 1:
        return [*records[0]]
    return [_record(folds) for folds in zip(*records, strict=True)]


def _record(folds: Sequence[Record]) -> Record:
    """Record of one trial on all folds."""
    info = {
        "device": ", ".join(sorted({fold["info"]["device"] for fold in folds})),
        "seconds": sum(fold["info"]["seconds"] for fold in folds),
    }
    return {
        **folds[0],
        "designs": [fold["design"] for fold in folds],
        **{name: [*map(_test, zip(*(f[name] for f in folds), strict=True))] for name in PARTS},
        "info": info,
    }


def _test(tests: Sequence[Record]) -> Record:
    """Tests of one setting on all folds as one: numbers are means over their scenes."""
    images = [test["images"] for test in tests]
    made: dict[str, Any] = {}
    for name, value in tests[0].items():
        values = [test[name] for test in tests]
        if name == "confusion":
            made[name] = np.sum(values, axis=0).tolist()
        elif name == "terms":
            made[name] = {
                measure: pack_values(
                    np.concatenate([unpack_values(each[measure]) for each in values])
                )
                for measure in value
                if all(measure in each for each in values)
            }
        elif name in ("rmse", "bound") and None not in values:
            made[name] = np.sqrt(np.average(np.square(values), axis=0, weights=images)).tolist()
        elif name in ("levels", "photons", "noise", "values", "rates") or None in values:
            made[name] = value
        elif not isinstance(value, str):
            made[name] = np.average(values, axis=0, weights=images).tolist()
    if "confusion" in made:
        counts = np.array(made["confusion"])
        sums = counts.sum(axis=1)
        made["rates"] = [
            float(count / total) if total else None
            for count, total in zip(counts.diagonal(), sums, strict=True)
        ]
        made["balanced"] = float(np.mean([rate for rate in made["rates"] if rate is not None]))
    covers = f"{tests[0]['covers']} of each of {len(tests)} folds"
    return {**made, "images": sum(images), "covers": covers}
