"""How Sphinx builds the site: `make docs`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # for _site

import stochens_rs as se

project = "stochens_rs"
author = "the stochens_rs contributors"
copyright = author
version = release = se.__version__
# Where the files of the repository can be fetched, as for the packages: https://.../raw/HEAD
ADDRESS = os.environ.get("ADDRESS", "")

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_gallery.gen_gallery",
    "_site.llms",
    "_site.mathematics",
    "_site.notebooks",
    "_site.pages",
]
exclude_patterns = ["build", "data", "gallery", "_site"]
nitpicky = False
default_role = "py:obj"
templates_path = ["_templates"]

# -- Markdown
myst_enable_extensions = ["attrs_block", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

# -- API: one page for each name
autosummary_generate = True
autosummary_ignore_module_all = False
# File systems that do not tell Study.html from study.html exist.
CLASSES = ("Study", "Stream", "Model")
autosummary_filename_map = {f"stochens_rs.{name}": f"stochens_rs.{name}-class" for name in CLASSES}
autodoc_typehints = "none"  # the types are in the sections of the docstring
toc_object_entries_show_parents = "hide"
autodoc_default_options = {"member-order": "bysource"}
numpydoc_show_class_members = False

# -- gallery
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "doc_module": ("stochens_rs",),
    "backreferences_dir": "api/examples",
    "reference_url": {"stochens_rs": None},
    "abort_on_example_error": True,
    "min_reported_time": 5,
    "show_memory": False,
    "write_computation_times": False,
    "remove_config_comments": True,
}

# -- HTML
html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = project
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_search_scorer = str(Path(__file__).with_name("_site") / "scorer.js")
html_show_sourcelink = False
html_context = {"default_mode": "auto"}
html_show_search_summary = False  # it would be fetched, which a browser refuses for files
html_theme_options: dict[str, Any] = {
    "article_header_end": ["notebook"],
    "footer_end": [],
    "footer_start": ["copyright"],
    "header_links_before_dropdown": 6,
    "logo": {"text": f"{project} {release}"},
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": False,
}
if ADDRESS:
    repository = {
        "name": "Repository",
        "url": ADDRESS.partition("/raw/")[0],
        "icon": "fa-solid fa-code",
    }
    html_theme_options["icon_links"] = [repository]
html_sidebars: dict[str, list[str]] = {
    name: [] for name in ("index", "benchmarks", "changelog", "contributing")
}


ROOMS = ("", "controls.", "fusion.", "identification.", "streams.", "studies.", "theory.")


def find_public(_app: Any, env: Any, node: Any, content: Any) -> Any:
    """Link `control` or `Certificate` in any docstring to the page of that name."""
    if node.get("refdomain") != "py":
        return None
    domain, builder = env.get_domain("py"), env.app.builder
    for room in ROOMS:
        name = f"stochens_rs.{room}{node['reftarget'].removeprefix('se.')}"
        if name in domain.objects:
            return domain.resolve_xref(env, node["refdoc"], builder, "obj", name, node, content)
    return None


def setup(app: Any) -> None:
    """Connect to the build."""
    app.connect("missing-reference", find_public)
