"""A design as a console and as a notebook show it."""

from html import escape
from typing import TYPE_CHECKING

from deepfsi.inline import mask_picture

if TYPE_CHECKING:
    from deepfsi.design.artifact import Design


def design_text(design: "Design") -> str:
    """A design in one line."""
    budget = design.info.get("job", {}).get("photons")
    trained = f", learned at {budget:g} photons" if budget else ""
    shape = "x".join(map(str, design.mask_shape))
    network = getattr(design.classifier, "title", type(design.classifier).__name__)
    return (
        f"<Design {design.name}: {design.masks} masks of {shape}, {design.light}, "
        f"{design.rails.kind} rails, {network}, {len(design.classes)} classes{trained}>"
    )


def design_html(design: "Design") -> str:
    """That line, and a picture of the masks."""
    words = escape(design_text(design))
    return f"<p>{words}</p>{mask_picture(design.matrix, design.mask_shape)}"
