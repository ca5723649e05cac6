"""How the sources are laid out: imports point one way, files are short."""

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = {"pathfold": ROOT / "python", "pathfold_training": ROOT / "training"}
BUILT = {"pathfold._core", "pathfold_training._taps"}
# Optional, or slow to import: a module that imports one at its top may be imported where it is used.
HEAVY = {"distributed", "drjit", "lightning", "mitsuba", "onnx", "torch"}
WANTS_A_VARIANT = "pathfold.mitsuba"  # of Mitsuba, set before it is imported
MOST_LINES = 400
SOURCES = {".py", ".pyi", ".c", ".cpp", ".h", ".hpp"}
PARTS = ("sdk", "python", "training", "tests", "tools", "benchmarks")


class Import(NamedTuple):
    module: str  # whose file it stands in
    target: str
    line: int
    inside: bool  # a function


@cache
def modules() -> dict[str, Path]:
    """Every module of both packages."""
    found = {}
    for package, folder in PACKAGES.items():
        for path in sorted((folder / package).rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports() -> list[Import]:
    """Every import of every module, of its own package and of others."""
    return [
        Import(module, target, node.lineno, inside)
        for module, path in modules().items()
        for node, inside in nodes(ast.parse(path.read_text(encoding="utf-8")))
        for target in targets(module, node)
    ]


def nodes(tree: ast.AST, inside: bool = False) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node, inside
        yield from nodes(node, inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def targets(module: str, node: ast.Import | ast.ImportFrom) -> list[str]:
    """The modules that a statement names: a submodule where there is one of that name, else the module itself."""
    if isinstance(node, ast.Import):
        return [name.name for name in node.names]
    base = node.module or ""
    if node.level:
        package = module if modules()[module].name == "__init__.py" else module.rpartition(".")[0]
        ancestors = package.split(".")
        base = ".".join([*ancestors[: len(ancestors) - node.level + 1], *([base] if base else [])])
    named = [f"{base}.{name.name}" for name in node.names]
    return [full if full in modules() or full in BUILT else base for full in named]


def room(module: str) -> str:
    """A file or folder right below a package."""
    return ".".join(module.split(".")[:2])


@pytest.mark.parametrize("named", [str, room], ids=["modules", "rooms"])
def test_imports_form_no_cycle(named) -> None:
    graph: dict[str, set[str]] = {}
    for one in imports():
        if one.target in modules() and named(one.module) != named(one.target):
            graph.setdefault(named(one.module), set()).add(named(one.target))
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_a_package_asks_itself_where_a_thing_is_and_not_its_face() -> None:
    """Names of `pathfold` itself are for others: it looks them up when they are used."""
    assert not [one for one in imports() if one.target in PACKAGES and one.target == one.module.split(".")[0]]


def test_what_python_ships_to_everybody_knows_no_training() -> None:
    barred = ("torch", "lightning", "pathfold_training")
    assert not [one for one in imports() if room(one.module).split(".")[0] == "pathfold" and top(one) in barred]


@pytest.mark.parametrize("package", PACKAGES)
def test_own_modules_are_imported_at_the_top_unless_they_bring_something_heavy(package: str) -> None:
    inside = [
        one for one in imports() if one.inside and one.target in modules() and room(one.target) != WANTS_A_VARIANT
    ]
    own = [one for one in inside if one.module.split(".")[0] == package]
    assert not [one for one in own if not brought(one.target) - brought(one.module)]


@cache
def brought(module: str) -> frozenset[str]:
    """What heavy packages are imported with a module."""
    own = [one for one in imports() if one.module == module and not one.inside]
    below = (brought(one.target) for one in own if one.target in modules() and one.target != module)
    return frozenset({top(one) for one in own} & HEAVY).union(*below)


def top(one: Import) -> str:
    return one.target.split(".")[0]


@pytest.mark.parametrize("part", PARTS)
def test_files_are_short(part: str) -> None:
    long = {}
    for path in sorted((ROOT / part).rglob("*")):
        if path.suffix in SOURCES and (lines := len(path.read_text(encoding="utf-8").splitlines())) > MOST_LINES:
            long[str(path.relative_to(ROOT))] = lines
    assert not long
