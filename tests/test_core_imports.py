# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What may import what: core stands alone, and importing the package costs nothing."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent
PACKAGE = PROJECT / "HybridVolume"

FREECAD = ("FreeCAD", "FreeCADGui", "Part", "Mesh", "Fem", "PySide", "PySide2", "PySide6", "pivy")
WHEELS = ("netgen", "gmsh", "CGAL", "pytetwild", "pyvista", "vtk", "vtkmodules", "skfem", "pyamg")

IMPORT_ALL_OF_CORE = """
import importlib, pkgutil, sys
blocked = set(sys.argv[1:])

class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in blocked:
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, Block())
import HybridVolume.core
names = [m.name for m in pkgutil.walk_packages(HybridVolume.core.__path__, "HybridVolume.core.")]
for name in names:
    importlib.import_module(name)
print(len(names))
"""


def run(code: str, *arguments: str) -> str:
    """Run code in a fresh interpreter of the same kind and return what it prints."""
    answer = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=PROJECT
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout.strip()


@pytest.mark.parametrize("blocked", [FREECAD, WHEELS], ids=["without FreeCAD", "without wheels"])
def test_all_of_core_imports(blocked):
    files = [p for p in (PACKAGE / "core").rglob("*.py") if p != PACKAGE / "core" / "__init__.py"]
    assert int(run(IMPORT_ALL_OF_CORE, *blocked)) == len(files)


def test_importing_the_package_is_cheap():
    loaded = run("import sys, HybridVolume; print(*sys.modules)").split()
    heavy = {"numpy", "scipy", "matplotlib", *FREECAD, *WHEELS}
    assert heavy.isdisjoint(loaded)


def test_the_environment_needs_the_standard_library_only():
    loaded = run("import sys, HybridVolume.environment; print(*sys.modules)").split()
    allowed = sys.stdlib_module_names | {"__main__", "HybridVolume"}
    started_with = set(run("import sys; print(*sys.modules)").split())
    foreign = {name.split(".")[0] for name in set(loaded) - started_with} - allowed
    assert not foreign


def imported_parts(path: Path, inside_functions: bool = True) -> set[str]:
    """Parts of the package that a file imports, at its top or inside a function too."""
    parts = set()
    package = path.relative_to(PROJECT).with_suffix("").parts[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree) if inside_functions else tree.body:
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            stem = ".".join([*base, *filter(None, [node.module])])
            names = [f"{stem}.{alias.name}" for alias in node.names]
        for name in names:
            words = name.split(".")
            if words[0] == "HybridVolume" and len(words) > 1:
                parts.add(words[1])
    return parts


@pytest.mark.parametrize("part", ["core", "sources", "exports", "objects"])
def test_imports_go_one_way(part):
    forbidden = {
        "core": {"sources", "exports", "objects", "gui"},
        "sources": {"exports", "objects", "gui"},
        "exports": {"sources", "objects", "gui"},
        "objects": {"gui"},
    }[part]
    # Objects fetch their view providers, where FreeCAD has a window, inside a function.
    imported = {
        str(path.relative_to(PROJECT)): imported_parts(path, inside_functions=part != "objects")
        for path in (PACKAGE / part).rglob("*.py")
    }
    wrong = {path: parts & forbidden for path, parts in imported.items() if parts & forbidden}
    assert not wrong


def test_core_never_names_freecad():
    wrong = []
    for path in (PACKAGE / "core").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module or ""]
            wrong += [f"{path.name}: {n}" for n in names if n.split(".")[0] in FREECAD]
    assert not wrong
