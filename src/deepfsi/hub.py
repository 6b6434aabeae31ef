"""Designs in folders and repositories of a model hub, by the mixin of `huggingface_hub`."""

from pathlib import Path
from typing import Any, Self

from huggingface_hub import ModelHubMixin, hf_hub_download

from deepfsi.design.design import Design, load_design

FILE = "design.safetensors"
"""Name of the design file in a folder or a repository."""


class HubDesign(
    ModelHubMixin,
    library_name="deepfsi",
    tags=["single-pixel-camera"],
    paper_url="https://doi.org/10.48550/arXiv.2508.01981",
):
    """A design for a model hub: `save_pretrained`, `from_pretrained` and `push_to_hub`.

    Parameters
    ----------
    design : Design

    Examples
    --------
    >>> from deepfsi.hub import HubDesign
    >>> HubDesign(design).save_pretrained("folder")  # doctest: +SKIP
    >>> design = HubDesign.from_pretrained("folder").design  # doctest: +SKIP
    """

    def __init__(self, design: Design) -> None:
        self.design = design
        self._hub_mixin_config = {"classes": design.classes}  # of config.json; the file has all

    def _save_pretrained(self, save_directory: Path) -> None:
        self.design.save(save_directory / FILE)

    @classmethod
    def _from_pretrained(cls, *, model_id: str, **download: Any) -> Self:
        file = Path(model_id) / FILE
        if not file.parent.is_dir():
            file = Path(hf_hub_download(model_id, FILE, **download))
        return cls(load_design(file))
