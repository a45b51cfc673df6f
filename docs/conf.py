"""Sphinx's settings; docs/build.py starts it."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))

import figures  # noqa: E402

(HERE / "_static/made").mkdir(parents=True, exist_ok=True)

project = "tofrender"
author = "The tofrender authors"
copyright = author
release = re.search(
    r'__version__ = "(.*)"', (HERE.parents[2] / "tofrender/__init__.py").read_text()
)[1]

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "drawings",
    "formulas",
    "names",
]
exclude_patterns = ["_ext", "gallery/*.ipynb", "gallery/*.py", "gallery/*.zip", "gallery/*.json"]
default_role = "py:obj"
smartquotes = False  # They turn -- of options into a dash

myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_block", "attrs_inline"]
myst_heading_anchors = 4
suppress_warnings = [
    "config.cache",  # The gallery's scraper is a function
    "misc.highlighting_failure",  # Cells with shell commands are not Python
]

run_only = os.environ.get("DOCS_ONLY")  # Names of notebooks and examples; unset: all
nb_execution_excludepatterns = [
    f"*{path.name}"
    for path in (HERE / "notebooks").glob("*.ipynb")
    if run_only is not None and path.name not in run_only.split()
]
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE.parent / "notebooks")
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_ipywidgets_js = {}  # They would be loaded from the network
nb_number_source_lines = False

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autosummary_generate = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_custom_sections = ["Warns"]
add_module_names = False

sphinx_gallery_conf = {
    "examples_dirs": str(HERE.parent / "examples"),
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$"
    if run_only is None
    else "|".join(map(re.escape, run_only.split())) or "(?!)",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": (figures.scrape,),
    "reset_modules": ("matplotlib", figures.prepare),
    "reset_modules_order": "both",
    "parallel": True,  # As many processes as Sphinx has
    "capture_repr": ("_repr_html_",),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "show_memory": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "remove_config_comments": True,
    "copyfile_regex": "",
    "default_thumb_file": str(HERE / "_static/logo.svg"),
}

html_theme = "pydata_sphinx_theme"
html_title = "tofrender"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_search_scorer = str(HERE / "scorer.js")
html_favicon = "_static/logo.svg"
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_show_sphinx = False
html_sidebars = {
    "index": [],
    "explore": [],
    "conventions": [],
    "faq": [],
    "glossary": [],
    "install": [],
    "notebooks": [],
    "gallery/index": [],
}
html_context = {"default_mode": "auto"}
html_theme_options = {
    "logo": {
        "image_light": "_static/logo.svg",
        "image_dark": "_static/logo.svg",
        "text": "tofrender",
    },
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "header_links_before_dropdown": 7,
    "show_prev_next": True,
    "show_toc_level": 2,
    "secondary_sidebar_items": {"**": ["page-toc"], "index": [], "explore": [], "tofbench": []},
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
    "back_to_top_button": False,
}
