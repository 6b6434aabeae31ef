"""The site: `make docs` builds it with warnings as errors.

Everything made by a build lies in `docs/generated` (pages) and `docs/_build` (the site).
"""

import sys
import warnings
from importlib.metadata import version as version_of
from pathlib import Path

from matplotlib import get_data_path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

import lessons  # noqa: E402

# joblib says so when it replaces a process that holds much memory, which is no fault of a script
warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)

project = "DeepFSI"
author = "The DeepFSI developers"
copyright = author
version = release = version_of("deepfsi")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "mathml",
    "commands",
    "devices",
    "formats",
    "lessons",
    "links",
    "modules",
    "playable",
]
exclude_patterns = [
    "_build",
    "gallery",
    "tutorial",
    "generated/**/*.ipynb",
    "generated/**/*.py",
    "generated/**/*.json",
]
suppress_warnings = ["config.cache"]
default_role = "py:obj"
smartquotes = False
highlight_language = "text"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4

autodoc_typehints = "none"
autosummary_generate = True
autodoc_member_order = "bysource"
numpydoc_show_class_members = False

SCRIPTS = [each.parent.name for each in sorted(HERE.glob("*/GALLERY_HEADER.rst"))]
PREPARED = {"tutorial": lessons.prepared(HERE / "tutorial", HERE / "_build" / "tutorial")}
sphinx_gallery_conf = {
    "examples_dirs": [str(PREPARED.get(name, name)) for name in SCRIPTS],
    "gallery_dirs": [f"generated/{name}" for name in SCRIPTS],
    "subsection_order": [f"gallery/{name}" for name in ("light", "designs", "camera", "packages")],
    "filename_pattern": "/plot_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "ignore_repr_types": r"<class 'int'>",
    "reset_modules": ("matplotlib", "quiet.silence", "figures.style", "lessons.begin"),
    "parallel": True,
    "show_memory": False,
    "download_all_examples": False,
    "write_computation_times": False,
    "min_reported_time": float("inf"),
    "show_signature": False,
}

html_theme = "pydata_sphinx_theme"
html_title = "DeepFSI"
html_logo = "static/logo.svg"
html_favicon = "static/favicon.svg"
html_context = {"default_mode": "auto"}
html_static_path = ["static", f"{get_data_path()}/fonts/ttf/STIXGeneral.ttf"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_sidebars = {"notebook/**": []}  # in no navigation, but in the search
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "DeepFSI", "alt_text": ""},
    "navbar_align": "left",
    "show_nav_level": 1,
    "show_prev_next": True,
    "secondary_sidebar_items": {"**": ["page-toc"], "index": []},
    "footer_start": ["copyright"],
    "footer_end": [],
}


def setup(app):
    """Add the setting of a quick build: modules are not listed, and no page to play is made.

    The notebook is in no list of pages.
    """
    app.add_config_value("quick", False, "env")
    app.connect("env-updated", lambda app, env: env.metadata["notebook/index"].update(orphan=True))
