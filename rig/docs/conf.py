"""Settings of Sphinx for the copy of this directory that `rig.views.site` makes: ``rig serve docs`` uses it."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from sphinx.util.logging import getLogger

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from made import make_pages  # type: ignore[import-not-found]  # noqa: E402  (beside this file)

from rig import __version__  # noqa: E402

make_pages(HERE)
(HERE / "extra").mkdir(exist_ok=True)
if find_spec("ziglang"):
    # The wall of the first page, by a program of its own: `rig` does not import the simulation.
    subprocess.run([sys.executable, "-P", "-m", "sim_backend.browser", HERE / "extra" / "wall"], check=True)
else:  # a strict build fails for the warning
    first = (HERE / "index.md").read_text(encoding="utf-8")
    first = re.sub(r"(?s)## A wall to touch\n.*?(?=## )", "", first)
    (HERE / "index.md").write_text(first, encoding="utf-8")
    getLogger(__name__).warning("the wall of the first page is left out: pip install 'haptic-rig[page]'")

project = "haptic-rig"
author = "haptic-rig"
release = version = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "sphinx_design",
]
# sphinx-gallery makes pages from the scripts there.
exclude_patterns = ["gallery/*", "notebooks/*", "extra", "**/recordings"]
root_doc = "index"
smartquotes = False  # an option begins with two hyphens
default_role = "code"  # docstrings write names between single backticks

myst_enable_extensions = ["colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 4

autodoc_typehints = "none"  # docstrings say what an argument means, and its type stands in the signature
autodoc_member_order = "bysource"
napoleon_use_rtype = False
napoleon_use_ivar = True
nitpick_ignore_regex = [("py:.*", ".*")]  # docstrings are prose: `nothing` in them is a reference

html_theme = "furo"
html_title = f"haptic-rig {release}"
html_static_path = ["style"]
html_extra_path = ["extra"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}

sphinx_gallery_conf = {
    "examples_dirs": ["gallery", "notebooks"],
    "gallery_dirs": ["figures", "worked"],
    "filename_pattern": r"\.py$",
    "image_scrapers": ("matplotlib", "pictures"),
    "abort_on_example_error": True,
    "capture_repr": (),
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "remove_config_comments": True,
}
# Single backticks in docstrings are prose: a word that names several attributes is no link.
suppress_warnings = ["ref.python"]
