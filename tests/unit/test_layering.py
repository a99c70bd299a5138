"""Data flows one way, and so do imports."""

import ast
from pathlib import Path

import pytest

# each may import those before it, and itself
LAYERS = ("core", "records", "acoustics", "corpora", "sim", "effects", "rooms", "draw_rooms", "simulate_rirs", "eq",
          "loop", "kaldi", "augment", "export", "wer", "report", "show", "validate", "compile_kernels", "cli",
          "answers", "__main__")
PACKAGE = Path(__file__).resolve().parents[2] / "pysrc" / "roomeq"
LAYER_OF = {name: n for n, name in enumerate(LAYERS)}


def imported(path):
    """Yield the top-level module of roomeq that each import of a file names."""
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        yield from (name.split(".")[1] for name in names if name.startswith("roomeq."))


def module_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_modules_import_only_leftwards(path):
    if module_of(path) == "__init__":  # the public interface imports when a name is used
        return
    assert module_of(path) in LAYER_OF, f"{path}: say in LAYERS where this module stands"
    for other in imported(path):
        if other in LAYER_OF:
            assert LAYER_OF[other] <= LAYER_OF[module_of(path)], f"{path} imports roomeq.{other}, to its right"
