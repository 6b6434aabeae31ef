"""Commands that test a design: under simulated light, and on pictures."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from deepfsi.base.files import write_atomically
from deepfsi.base.quantities import Table
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.datasets.dataset import Dataset
from deepfsi.evaluation.measures import MOST_DRAWS
from deepfsi.evaluation.results import Estimates, Result, results_lines

if TYPE_CHECKING:
    from deepfsi.design.design import Design
    from deepfsi.sweeps.results import Data


class EvaluateDesign(Command):
    """Test scenes and camera are those of the design unless given.

    Example: deepfsi evaluate digits.safetensors --photons 1e2,1e3,1e4
    """

    settings: Annotated[dict[str, Any], fields.camera_options("noise")]
    file: fields.DesignOrPatterns
    photons: fields.NumberList = fields.option("budgets, such as 1e2,1e3,1e4", ...)
    data: fields.TestData = None
    size: fields.Size = None
    draws: Annotated[int, Field(ge=1, le=MOST_DRAWS)] = fields.option("draws of each scene", 3)
    seed: fields.NoiseSeed = 0
    view: fields.View = None
    trust: fields.Trust = False
    device: fields.TorchDevice = "auto"

    def run(self, terminal: Terminal) -> Outcome:
        from deepfsi.evaluation.accuracy import camera_for, evaluate
        from deepfsi.lab.design_data import data_of, open_design
        from deepfsi.physics.surroundings import torch_device

        design = open_design(self.file, trust=self.trust).to(torch_device(self.device))
        camera = camera_for(design, **self.settings)
        scenes, notes = data_of(design, self.data, self.size, self.view)
        how: dict[str, Any] = {"camera": camera, "draws": self.draws, "seed": self.seed}
        with terminal.progress("evaluate") as report:
            results = evaluate(design, scenes, self.photons, report=report, **how)
        return Outcome(
            {
                "design": str(self.file),
                "detectors": design.exposure.detection.count,
                "readout": design.exposure.detection.readout,
                "notes": notes,
                "results": [with_classes(design, result) for result in results],
            },
            [*data_lines(scenes, notes), *evaluation_lines(design, results, camera.noise_name)],
        )


class PredictClasses(Command):
    """They get the preprocessing of the data that the design was trained on.

    Example: deepfsi predict digits.safetensors pictures/ -o classes.csv
    """

    settings: Annotated[dict[str, Any], fields.camera_options("noise")]
    file: fields.DesignOrPatterns
    pictures: fields.ExistingPath = fields.argument(
        "picture, or folder of pictures, with or without a folder for each class"
    )
    photons: float | None = fields.option("budget, such as 1e4; default: that of the training")
    out: fields.CsvFile = fields.option("table with a line for each picture, .csv")
    seed: fields.NoiseSeed = 0
    trust: fields.Trust = False
    device: fields.TorchDevice = "auto"
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        from deepfsi.lab.design_data import open_design
        from deepfsi.lab.prediction import predict
        from deepfsi.physics.surroundings import torch_device

        design = open_design(self.file, trust=self.trust).to(torch_device(self.device))
        with terminal.progress("predict"):
            settings = {"seed": self.seed, **self.settings}
            predictions = predict(design, self.pictures, self.photons, **settings)
        content = predictions.as_dict()
        if self.out is not None:
            import polars
            from polars import selectors

            # A spreadsheet would take a name such as =1+1 for a formula
            plain = selectors.string().str.replace(r"^[=+@-]", "'$0")
            table = polars.DataFrame(content["pictures"], infer_schema_length=None)
            table = table.with_columns(plain)
            write_atomically(self.out, table.write_csv().encode())
        written = None if self.out is None else str(self.out)
        return Outcome(
            {"design": str(self.file), "table": written, **content},
            [f"pictures: {predictions.preprocessing}.", *predictions.lines()],
        )


def data_lines(data: "Dataset | Data", notes: Sequence[str] = ()) -> list[str]:
    """Lines on the preprocessing of a data set, and notes on it."""
    return [f"data: {data.name}. {data.preprocessing}", *(f"note: {note}" for note in notes)]


def with_classes(design: "Design", result: Result | Estimates) -> dict[str, Any]:
    """A test as JSON types, with the classes that its lists follow."""
    return {"classes": design.classes, **result.as_dict()}


def evaluation_lines(
    design: "Design", results: Sequence[Result | Estimates], noise: str
) -> Iterator[str | Table]:
    """Lines and tables on the tests of a design."""
    title = f"{design.name}, {design.exposure.title}, {noise} noise"
    return results_lines(results, title=title, classes=design.classes)
