"""Commands that make a design, and that draw it or write it for others."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import DESIGN_ENDINGS, write_atomically
from deepfsi.base.models import Count
from deepfsi.base.progress import SILENT
from deepfsi.base.registry import check_report
from deepfsi.camera.camera import Camera
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.evaluate import data_lines, evaluation_lines, with_classes
from deepfsi.cli.fields import JOB_OPTIONS
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.evaluation.results import Result, lit_text
from deepfsi.jobs.job import FEW_SCENES, Job, job_of
from deepfsi.jobs.training import Training

if TYPE_CHECKING:
    from deepfsi.design.design import Design


class LearnDesign(Command):
    """A training that was stopped goes on when it is run again, from a .checkpoint beside --out.

    Example: deepfsi design --data mnist --photons 1e4 --masks 10 -o digits.safetensors
    """

    settings: Annotated[dict[str, Any], fields.job_options(leave=("counts",))]
    out: Annotated[Path, fields.Output(DESIGN_ENDINGS)] = fields.option(
        "design file, .safetensors", ...
    )
    data: fields.TrainingData = "digits"
    size: fields.Size = None
    matrix: fields.Matrix = None
    counts: float | None = fields.option(str(Training.model_fields["counts"].description))
    view: fields.View = None
    device: fields.TorchDevice = "auto"
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        scenes = load_dataset(self.data, size=self.size)
        if self.view is not None:
            from deepfsi.counting.acquisition import Calibration
            from deepfsi.lab.design_data import view_dataset

            scenes = view_dataset(scenes, Calibration.load(self.view), self.view)
        settings = _job_settings(self.settings)
        job = job_of(settings, scenes, counts=self.counts, matrix=self.matrix)
        from deepfsi.evaluation.accuracy import evaluate
        from deepfsi.physics.noise import noise_of
        from deepfsi.training.learning import learn_job

        noise_of(job.camera)  # refuses a noise of the test before the training
        checkpoint = self.out.with_name(f"{self.out.name}.checkpoint")
        # --force trains anew
        if self.force:
            checkpoint.unlink(missing_ok=True)
        with terminal.progress(f"{job.design}, {job.masks} masks") as report:
            design = learn_job(
                job,
                scenes,
                matrix=self.matrix,
                device=self.device,
                report=report,
                checkpoint=checkpoint,
            )
        lowest = design.info["job"]["photons"]
        design.save(self.out)
        # Both ends of a range, or the one budget
        budgets = list(dict.fromkeys((lowest, job.exposure.highest(lowest))))
        draws = 1 if job.facts.adaptive else 3  # a look at one scene takes a millisecond
        with terminal.progress("test") as report:
            results = evaluate(design, scenes, budgets, draws=draws, report=report)
        lit = min(sum(light > 0 for light in test.photons_per_mask) for test in results)
        return Outcome(
            {
                "design": str(self.out),
                "info": design.info,
                "tests": [with_classes(design, result) for result in results],
                "lit_masks": lit,
            },
            [
                *data_lines(scenes),
                f"{len(scenes.x_train)} training scenes, {len(scenes.x_test)} test scenes",
                job.exposure.describe(job.optics),
                *evaluation_lines(design, results, job.camera.noise_name),
                *_remarks(design, results, lit),
                *_advice_on_pictures(job, design, scenes, results[0]),
                f"saved: {self.out}",
            ],
        )


def _job_settings(options: Mapping[str, str]) -> dict[str, Any]:
    """Fields of a job from its options; LOW:HIGH is a range of budgets."""
    tables: dict[str, dict[str, Any]] = {heading: {} for heading, _, _ in JOB_OPTIONS.values()}
    for option, text in options.items():
        heading, name, _ = JOB_OPTIONS[option]
        tables[heading][name] = text
    job = tables["Options"]
    low, colon, high = options.get("photons", "").partition(":")
    if colon:
        try:
            tables["Exposure"]["span"] = float(high) / float(low)
        except (ValueError, ZeroDivisionError):
            raise InputError("--photons is a number, or LOW:HIGH such as 1e3:1e6") from None
        job["photons"] = low
    job["camera"] = Camera.load(job.get("camera"), **tables["Camera"])
    return {**job, "exposure": tables["Exposure"], "training": tables["Training"]}


def _remarks(design: "Design", results: list[Result], lit: int) -> Iterator[str]:
    """Advice on a new design; `lit` of its masks have light."""
    masks = len(results[0].photons_per_mask)
    # Adaptive exposures may end before their last mask
    if lit < masks and not design.exposure.makes_masks:
        yield f"masks: {lit_text(masks, lit)}; give a longer --exposure, or --masks {lit}"
    left_out = design.info.get("left_out")
    if left_out and left_out["guesses"]:
        other = "--clusters" if design.name == "adaptive" else "fewer --masks"
        yield (
            f"note: on {left_out['scenes']} scenes that the training left out the probabilities "
            f"cannot be told from guessing (log loss {left_out['log_loss']:.2f} ± "
            f"{2 * left_out['error']:.2f} nats, guessing {left_out['guessing']:.2f}): give more "
            f"scenes, more --photons, {other}, or another --design"
        )


def _advice_on_pictures(job: Job, design: "Design", data: Dataset, tested: Result) -> Iterator[str]:
    """Advice on the training scenes: on classes of unequal size, and on more of few scenes."""
    from deepfsi.evaluation.accuracy import evaluate

    if not data.classes:
        return
    sizes = np.bincount(data.y_train)
    usual = job.training.loss is None and not job.training.balance and not job.facts.adaptive
    if usual and sizes.max() >= 2 * sizes.min():
        yield (
            f"note: classes have {sizes.min()} to {sizes.max()} training scenes, and rare ones are "
            "answered less: `Training(balance=True)`, `training.balance` of a recipe, weighs all "
            "alike"
        )
    if len(data.x_train) >= FEW_SCENES or tested.high > 0.95:
        return
    own = replace(data, x_test=data.x_train, y_test=data.y_train)
    [learned] = evaluate(design, own, tested.photons, draws=1, report=SILENT)
    [lit] = evaluate(design, data, 10 * tested.photons, draws=1, report=SILENT)
    if learned.low > tested.high and lit.accuracy <= tested.high:
        yield (
            f"note: {learned.accuracy:.3f} of the training scenes are right and "
            f"{tested.accuracy:.3f} of the test scenes, {lit.accuracy:.3f} in ten times the light: "
            "give more pictures, not more light"
        )


class ShowDesign(Command):
    """Adaptive masks are made for each scene: see them on a page of `deepfsi page`.

    Example: deepfsi show digits.safetensors -o masks.png
    """

    file: fields.DesignPath = fields.argument("design file")
    out: Path | None = fields.option("picture: .png, .svg, .pdf; default: the design's name, .png")
    count: Count = fields.option("at most this many masks", 24)
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        out = self.out or Path(f"{self.file.stem}.png")
        fields.Output((".png", ".svg", ".pdf")).check(out, self.force)
        check_report()
        from deepfsi.lab.design_data import open_design
        from deepfsi.report.masks import design_figure
        from deepfsi.report.style import write_figure

        design = open_design(self.file, static=True)
        write_figure(design_figure(design, self.count), out)
        return Outcome({"picture": str(out)})


class WritePage(Command):
    """One HTML file without a server: draw a scene, set the light, start an exposure.

    Its accuracy is measured on the test scenes of the data that the design remembers.

    Example: deepfsi page digits.safetensors -o digits.html
    """

    file: fields.DesignOrPatterns
    out: Annotated[Path, fields.Output((".html",))] = fields.option("the page, .html", ...)
    data: fields.TestData = None
    size: fields.Size = None
    seed: fields.NoiseSeed = 0
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        from deepfsi.evaluation.page_data import playable
        from deepfsi.lab.design_data import data_of, open_design
        from deepfsi.report.demo import write_page

        design = open_design(self.file)
        scenes, notes = data_of(design, self.data, self.size)
        with terminal.progress("page") as report:
            payload = playable(design, scenes, seed=self.seed, report=report)
        write_page(self.out, payload)
        measured = {name: payload[name] for name in ("curve", "test", "rules")}
        return Outcome(
            {"design": str(self.file), "page": str(self.out), "notes": notes, **measured},
            [*data_lines(scenes, notes), f"page: {self.out}"],
        )


class ExportClassifier(Command):
    """Counts and budget in, class probabilities out; `dmd export` writes the masks.

    Example: deepfsi export digits.safetensors -o digits.onnx
    """

    file: fields.DesignOrPatterns
    out: Path | None = fields.option("graph, .onnx; default: the design's name")
    trust: fields.Trust = False
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        out = self.out or Path(f"{self.file.stem}.onnx")
        fields.Output((".onnx",)).check(out, self.force)
        from deepfsi.design.onnx import to_onnx
        from deepfsi.lab.design_data import open_design

        design = open_design(self.file, trust=self.trust, static=True)
        write_atomically(out, to_onnx(design))
        return Outcome(
            {
                "graph": str(out),
                "rails": design.rails.count,
                "masks": design.masks,
                "detectors": design.exposure.detection.count,
                "classes": design.classes,
            }
        )
