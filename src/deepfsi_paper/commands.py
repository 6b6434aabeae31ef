"""The command that repeats the paper's experiments."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

from deepfsi.base.models import Count
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi_paper import studies


class ReproducePaper(Command):
    """Experiments in one folder share one page, and the trials that several of them need.

    A stopped experiment goes on when it is run again; with more --trials it adds those that are
    missing.

    Example: deepfsi reproduce mnist --quick -o runs/paper
    """

    name: str = fields.argument(
        "mnist, compression, mlgauss, quantization, indian-pines, ovit or hardware"
    )
    out: Annotated[Path, fields.Output()] = fields.option("output folder", Path("runs/paper"))
    quick: bool = fields.option("a coarse grid, in a fraction of the time", False)
    trials: Count | None = fields.option("training seeds for each point, if not the recipe's")
    ratios: fields.Ratios = fields.option("compression ratios, if not the recipe's: 0.01,0.16,1")
    part_name: str | None = fields.option(
        "the only part to run, of a recipe with several parts", alias="part"
    )
    workers: fields.WorkerCount = None
    ray: fields.Ray = None
    device: fields.TorchDevice = "auto"

    def run(self, terminal: Terminal) -> Outcome:
        changes = {} if self.ratios is None else {"ratios": list(self.ratios)}
        experiments = [
            replace(each, changes=changes, part=self.part_name) for each in studies.find(self.name)
        ]
        for experiment in experiments:
            experiment.recipes(self.quick, self.trials)
        for experiment in experiments:
            with terminal.progress(experiment.name) as report:
                experiment.run(
                    self.out,
                    command=terminal.command_line,
                    quick=self.quick,
                    trials=self.trials,
                    device=self.device,
                    workers=self.workers,
                    ray=self.ray,
                    report=report,
                )
        page = studies.page(self.out)
        sections = [section for each in experiments if (section := each.section(self.out))]
        answers = {True: "yes", False: "no", None: "open"}
        return Outcome(
            {
                "report": str(page),
                "claims": {
                    section.name: [
                        {**asdict(claim), "why": claim.reason} for claim in section.claims
                    ]
                    for section in sections
                },
            },
            [
                *(
                    f"{answers[claim.holds]}: {claim.text} ({claim.measured}) {claim.reason}"
                    for section in sections
                    for claim in section.claims
                ),
                f"report: {page}",
            ],
        )
