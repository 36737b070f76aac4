"""The sources of this project as syntax trees, parsed once for all tests that look through them."""

import ast
from functools import cache

from rig.realtime.source_files import source_files


@cache
def nodes() -> dict[str, list[ast.AST]]:
    """All that stands in each module."""
    return {module: list(ast.walk(ast.parse(path.read_text()))) for module, path in source_files().items()}
