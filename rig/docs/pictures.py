"""Shows the picture of a result in the gallery: a script calls it ``picture``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sphinx_gallery.scrapers import figure_rst

from rig import Picture


def shown(block: object, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save what a block left under that name, once, and return the text that shows it."""
    picture = block_vars["example_globals"].pop("picture", None)
    if not isinstance(picture, Picture):
        return ""
    path = str(next(block_vars["image_path_iterator"]))
    picture.save(path)
    return str(figure_rst([path], gallery_conf["src_dir"]))


def _get_sg_image_scraper() -> Callable[[object, dict[str, Any], dict[str, Any]], str]:
    return shown
