"""A vision transformer on the features of image patches."""

from typing import Any, Self

import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.design.networks import Classifier
from deepfsi.jobs.training import Training


class Vit(Classifier):
    """A vision transformer on the features of image patches: torch's own encoder, before a mean.

    Each patch's features are embedded by one linear layer and get a learned position; `depth`
    layers of attention over the patches follow (normalised first, as deep ones train best), then
    the mean over patches and a linear layer. There is no dropout.
    """

    def __init__(
        self,
        inputs: int,
        patches: int,
        classes: int,
        width: int = 64,
        depth: int = 2,
        heads: int = 4,
        hidden: int = 128,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        if width % heads:
            raise InputError(f"{heads} heads cannot share a width of {width}: give a multiple")
        self.sizes = {"patches": patches, "width": width, "depth": depth}
        self.sizes |= {"heads": heads, "hidden": hidden}
        with torch.device("meta"):  # torch would draw weights from its global generator
            layer = nn.TransformerEncoderLayer(
                width, heads, hidden, 0.0, "gelu", batch_first=True, norm_first=True
            )
            self.embedding = nn.Linear(inputs, width)
            self.position = nn.Parameter(torch.empty(patches, width))
            self.encoder = nn.TransformerEncoder(
                layer, depth, nn.LayerNorm(width), enable_nested_tensor=False
            )
            self.head = nn.Linear(width, classes)
        self.to_empty(device=torch.get_default_device() if generator is None else generator.device)
        for name, parameter in self.named_parameters():
            if name == "position":
                nn.init.normal_(parameter, std=0.02, generator=generator)
            elif parameter.ndim == 2:
                nn.init.xavier_uniform_(parameter, generator=generator)
            else:
                nn.init.constant_(parameter, float("norm" in name and "weight" in name))

    @classmethod
    def of_settings(
        cls, settings: Training, inputs: int, classes: int, parts: int, generator: torch.Generator
    ) -> Self:
        """Untrained classifier of a training, as `Mlp.of_settings` says."""
        chosen = {"patches": parts, **settings.classifier_arguments}
        return cls(inputs, classes=classes, **chosen, generator=generator)

    @property
    def header(self) -> dict[str, Any]:
        """Entry of a design file's header: kind, and parameters but inputs and classes."""
        return {"kind": "vit", **self.sizes}

    @property
    def title(self) -> str:
        """Name."""
        return "vision transformer"

    def forward(self, features: Tensor) -> Tensor:
        """Logits (B, C) of standardised features (B, P, m)."""
        tokens = self.encoder(self.embedding(features) + self.position)
        return self.head(tokens.mean(dim=-2))
