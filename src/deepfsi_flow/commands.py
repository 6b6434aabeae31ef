"""Commands of scenes that pass a pattern."""

from pathlib import Path
from typing import Annotated

from deepfsi.base.files import write_atomically
from deepfsi.base.models import Count, Positive, Seconds
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal

PassingDesign = Annotated[
    fields.DesignPath, fields.argument("design file of scenes that pass a pattern")
]


class WriteMask(Command):
    """Polygons of an .svg mark what is open, in micrometres.

    Learn the design with two levels, for a binary pattern.

    Example: deepfsi mask passing.safetensors --pixel 5 -o pattern.svg
    """

    file: PassingDesign
    out: Annotated[Path, fields.Output((".svg",))] = fields.option("photomask, .svg", ...)
    pixel: Positive = fields.option(
        "side of a pixel on the mask, micrometres: that of a scene there", ...
    )
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        from deepfsi_flow.photomask import write_photomask

        pattern = write_photomask(self.file, self.out, self.pixel)
        rows, columns = pattern.shape
        return Outcome(
            {
                "design": str(self.file),
                "mask": str(self.out),
                "pixels": [rows, columns],
                "pixel_um": self.pixel,
                "um": [rows * self.pixel, columns * self.pixel],
                "open": float(pattern.mean()),
            }
        )


class FindTransits(Command):
    """A transit is a rise of the rate: its photons exceed a threshold.

    Background alone exceeds it as often as --false-alarms says.

    Example: deepfsi camera transits passing.safetensors photons.ptu --bin 100us
    """

    design: PassingDesign
    file: fields.ExistingPath = fields.argument("photon file, without markers", "PTU")
    bin_s: Seconds = fields.option("length of a time bin, such as 100us", ..., alias="bin")
    photons: float | None = fields.option("budget of a transit; default: that of the training")
    background: float | None = fields.option("counts/s without a scene; default: from the record")
    false_alarms: float = fields.option("expected false alarms in the whole record, at most", 0.01)
    counter_input: Count = fields.option("input of the counter, 1 for the first", 1, alias="input")
    out: fields.CsvFile = fields.option("table of starts, classes and counts of bins, .csv")
    trust: fields.Trust = False
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        from deepfsi.lab.design_data import open_design
        from deepfsi_flow.transits import classify_transits

        design = open_design(self.design, trust=self.trust)
        with terminal.progress("transits") as report:
            record = classify_transits(
                design,
                self.file,
                self.bin_s,
                photons=self.photons,
                background=self.background,
                false_alarms=self.false_alarms,
                counter_input=self.counter_input - 1,
                report=report,
            )
        if self.out is not None:
            write_atomically(self.out, record.as_csv().encode())
        return Outcome(record.as_dict(), record.lines())
