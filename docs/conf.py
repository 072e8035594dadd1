"""Sphinx configuration of the site.

    sphinx-build -W docs build/site

Pages of models and of formats are made first, into `docs/made`, which git does not know.
"""

from __future__ import annotations

import sys
from importlib.metadata import version as installed
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

project = "contact-statecharts"
release = installed("contact-statecharts")
version = ".".join(release.split(".")[:2])
copyright = "the authors of contact-statecharts"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "making.extension",
]
exclude_patterns = ["schema", "making"]

# Pages are Markdown that reads on its own, too; notebooks are pages with cells.
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300

autodoc_member_order = "bysource"
autodoc_default_options = {"exclude-members": "model_config, model_post_init, OTHER_WORDS, METHODS"}
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_preprocess_types = False

html_theme = "furo"
html_title = f"contact-statecharts {release}"
html_extra_path = ["made/files"]
html_static_path = ["making/site.css"]
html_css_files = ["site.css"]
