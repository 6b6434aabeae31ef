"""Equations as MathML, which browsers draw themselves: no script and no font from elsewhere."""

from docutils.nodes import SkipNode
from latex2mathml.converter import convert

BAR = '<mo stretchy="false">&#x0007C;'
CLOSE = '<mo stretchy="false" lspace="0" rspace="0">&#x0007C;'


def setup(app):
    """Add the renderer `mathml` to Sphinx."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def formula(node, display):
    """MathML of a formula; bars of a magnitude stand close to what they hold."""
    return convert(node.astext(), display=display).replace(BAR, CLOSE)


def visit_inline(writer, node):
    """Write a formula within a line."""
    writer.body.append(formula(node, "inline"))
    raise SkipNode


def visit_block(writer, node):
    """Write a formula on a line of its own."""
    writer.body.append(f'<div class="math">{formula(node, "block")}</div>')
    raise SkipNode
