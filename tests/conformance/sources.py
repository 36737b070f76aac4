"""The sources of this project as syntax trees, parsed once for all tests that look through them."""

import ast
import gc
from functools import cache

from rig.realtime.source_files import source_files


@cache
def nodes() -> dict[str, list[ast.AST]]:
    """All that stands in each module."""
    gc.disable()  # a million objects that stay: to look through them takes a third of the time
    try:
        return {
            module: list(ast.walk(ast.parse(path.read_text()))) for module, path in source_files().items()
        }
    finally:
        gc.enable()
