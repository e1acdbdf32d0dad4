"""Settings of the documentation site, which `make docs` builds."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import amulor

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "amulor"
author = "the amulor developers"
copyright = author
release = version = amulor.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.extlinks",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
    "api_pages",
    "docstrings",
    "repository_links",
    "trust_figure",
]
templates_path = ["_templates"]
exclude_patterns = [
    "_build",
    "_ext",
    "_templates",
    "README.md",
    "gallery/examples/*.py",
    # Parts of other pages.
    "gallery/ricci2010-discussion.md",
    "reference/presets-where.md",
    "trust/benchmark-tables.md",
]
suppress_warnings = [
    "config.cache",
    # Module docstrings list what a whole module rests on.
    "ref.citation",
]
# A name that no page defines is an error; these are bases without a page of their own.
nitpicky = True
nitpick_ignore_regex = [
    ("py:class", r"amulor\..*\.(Description|WaterState|SeaWater|_\w+)"),
    ("py:class", r"enum\.\w+"),
]

# ------------------------------------------------------------------- pages
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

# --------------------------------------------------------------------- API
autosummary_imported_members = True
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

extlinks = {"doi": ("https://doi.org/%s", "doi:%s")}

# ----------------------------------------------------------------- gallery
sphinx_gallery_conf = {
    "examples_dirs": str(HERE.parent / "examples" / "gallery"),
    "gallery_dirs": "gallery/examples",
    "filename_pattern": "plot_",
    "backreferences_dir": "gallery/backreferences",
    "doc_module": ("amulor",),
    "remove_config_comments": True,
    "download_all_examples": False,
    "abort_on_example_error": True,
    "show_memory": False,
    "show_signature": False,
    "within_subsection_order": "FileNameSortKey",
    "reset_modules": ("matplotlib", "gallery_style.apply"),
}
# The canvas of the gallery cannot be shown.
warnings.filterwarnings("ignore", message=".*FigureCanvasAgg is non-interactive.*")

# ------------------------------------------------------------------ theme
html_theme = "pydata_sphinx_theme"
html_title = f"amulor {release}"
html_static_path = ["_static"]
html_search_scorer = str(HERE / "_static" / "scorer.js")
html_css_files = ["site.css"]
html_js_files = ["copy.js", "enlarge.js", "learn/tables.js", "learn/learn.js"]
html_theme_options = {
    # Branches of other packages would be nine tenths of each page of the API.
    "collapse_navigation": True,
    "header_links_before_dropdown": 6,
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "pygments_light_style": "friendly",
}
html_show_sourcelink = False
# Menus take much of the time of a build. One that only looks for faults needs none.
html_sidebars: dict[str, list[str]] = {}
if "bare" in tags:  # type: ignore[name-defined]  # noqa: F821
    html_sidebars["**"] = []
html_context = {"default_mode": "auto"}
