"""Links to terms of the glossary say what the term means when one points at them."""

from functools import cache

from docutils import nodes

GLOSSARY = "lookup/glossary"


@cache
def meanings(env):
    """First sentence of each term's meaning, by the term's anchor."""
    found = {}
    for item in env.get_doctree(GLOSSARY).findall(nodes.definition_list_item):
        [meaning] = item.findall(nodes.definition)
        sentence = meaning.astext().split(". ")[0].rstrip(".") + "."
        found |= {name: sentence for term in item.findall(nodes.term) for name in term["ids"]}
    return found


def explain(app, doctree, page):
    """Give each link to a term its meaning as a title."""
    for word in doctree.findall(nodes.inline):
        link = word.parent
        if "std-term" in word["classes"] and isinstance(link, nodes.reference):
            name = (link.get("refuri") or f"#{link.get('refid')}").partition("#")[2]
            link["reftitle"] = meanings(app.env)[name]


def setup(app):
    """Explain as links are resolved."""
    app.connect("doctree-resolved", explain)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
