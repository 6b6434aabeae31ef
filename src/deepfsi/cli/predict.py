"""Classes of new pictures."""

from pathlib import Path
from typing import Annotated, Any

import typer

from deepfsi.cli import common, options, paths


def predict(
    file: Annotated[
        Path, typer.Argument(help="design file, or a folder of patterns that `dmd export` wrote")
    ],
    pictures: Annotated[
        Path,
        typer.Argument(
            help="picture, or folder of pictures, with or without a folder for each class, or .csv "
            "of file names and labels"
        ),
    ],
    photons: Annotated[
        str | None,
        typer.Option(
            help="budget of an exposure, such as 1e4; the light of the design's camera, which it "
            "was trained for, unless given"
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="table with a line for each picture, .csv")
    ] = None,
    noise: options.Noise = None,
    sigma: options.Sigma = None,
    dark: options.Dark = None,
    skip_bad: options.SkipBad = False,
    seed: options.NoiseSeed = 0,
    trust: options.Trust = False,
    device: options.Device = "auto",
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Classify new pictures in a simulated exposure each, under exact photon noise.

    They get the preprocessing of the data that the design was trained on, which it remembers.

    Example: deepfsi predict digits.safetensors pictures/ -o classes.csv
    """
    file = paths.check_design(file)
    paths.check_there(pictures, "a picture, or a folder of pictures")
    if out is not None:
        paths.check_file(out, (".csv",), force)
    from deepfsi.base import write_atomically
    from deepfsi.evaluation import camera_for
    from deepfsi.lab import predict as run
    from deepfsi.physics import torch_device

    budget = None if photons is None else options.number("photons", photons)
    told: dict[str, Any] = {"noise": noise, "sigma": sigma, "dark": dark}
    told = {name: value for name, value in told.items() if value is not None}
    made = common.open_design(file, trust).to(torch_device(device))
    options.check_sigma(told, [camera_for(made, None, **told).noise_name])
    with common.progress("predict", quiet=as_json):
        found = run(made, pictures, budget, seed=seed, skip_bad=skip_bad, **told)
    if out is not None:
        write_atomically(out, found.as_csv().encode())
    if as_json:
        table = None if out is None else str(out)
        common.print_json("predict", {"design": str(file), "table": table, **found.as_dict()})
        return
    print(f"pictures: {found.preprocessing}.")
    rows = [
        (each.name, each.predicted, f"{each.confidence:.3f}", each.label or "")
        for each in found.pictures
    ]
    light = f"{common.budget(found.photons)} photons"
    title = f"{made.name}, {common.size(made)}, {light}, {found.noise} noise"
    common.print_table(title, ("picture", "class", "confidence", "labelled"), rows)
    labelled = sum(each.label is not None for each in found.pictures)
    if foreign := labelled - found.score.answers:
        print(f"{foreign} pictures have labels that are none of the design's classes: left out")
    for remark in found.remarks:
        print(f"note: {common.as_options(remark)}")
    for line in found.score.lines("picture"):
        print(line)
    if out is not None:
        print(f"table: {out}")
