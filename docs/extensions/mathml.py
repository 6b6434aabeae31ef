"""Equations as MathML, which browsers draw themselves: no script and no font from elsewhere."""

from latex2mathml.converter import convert


def setup(app):
    """Add the renderer `mathml` to Sphinx."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def visit_inline(writer, node):
    """Write a formula within a line."""
    from docutils.nodes import SkipNode

    writer.body.append(convert(node.astext()))
    raise SkipNode


def visit_block(writer, node):
    """Write a formula on a line of its own."""
    from docutils.nodes import SkipNode

    writer.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise SkipNode
