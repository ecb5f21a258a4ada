"""docs/architecture.md is true: every module is on its map, imports run one way, files are small."""

from __future__ import annotations

import ast
import itertools
import re
import statistics
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "tnst_mi"
PAGE = ROOT / "docs" / "architecture.md"

#: From the ground up; what stands in one line may not import each other.
FLOORS = (
    "errors",
    "choices resources",
    "machine",
    "geometry",
    "frame",
    "io fields network",
    "losses recipe",
    "rendering",
    "regions",
    "optimisation",
    "compare reconstruction atlas realtime",
    "run",
    "cluster notebook training",
    "batch studio",
    "commands",
    "cli",
    "__init__ __main__",
)
FLOOR = {name: number for number, names in enumerate(FLOORS) for name in names.split()}

#: Modules that may import inside functions: what they import late, they do not always need.
LATE = {"__init__.py", "cli.py"}


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def room(module: str) -> str:
    """The folder or file of the package that a module belongs to, such as "io" for `tnst_mi.io.formats`."""
    return module.split(".")[1] if "." in module else "__init__"


def imports(path: Path) -> Iterator[str]:
    """Modules of the package that a file imports, those for type checkers alone included."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == "tnst_mi")
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "tnst_mi":
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_imports_run_from_high_to_low() -> None:
    upwards = []
    for path in modules():
        here = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for name in imports(path):
            there = room(name)
            if there != here and FLOOR[there] >= FLOOR[here] and not (here == "__main__" and there == "cli"):
                upwards.append(f"{path.relative_to(PACKAGE)} imports {name}")
    assert upwards == []


def test_imports_stand_at_the_top() -> None:
    late = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path in modules()
        if str(path.relative_to(PACKAGE)) not in LATE
        for function in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(function, ast.FunctionDef)
        for node in ast.walk(function)
        if isinstance(node, ast.Import | ast.ImportFrom)
    ]
    assert late == []


def test_every_module_is_on_the_map_and_nothing_else() -> None:
    """A line of the map is a folder in bold, and its modules in backticks before what they are."""
    mapped: set[str] = set()
    for line in PAGE.read_text("utf-8").splitlines():
        if row := re.match(r"\| `([^`]+)/` \| (.*) \|$", line):
            folder = "" if row[1] == "tnst_mi" else row[1] + "/"
            mapped |= {f"{folder}{name}.py" for name in re.findall(r"`([\w.]+)`", row[2])}
    existing = {str(path.relative_to(PACKAGE)) for path in modules() if path.name != "__init__.py"}
    assert mapped == existing


def test_the_map_has_the_floors_in_their_order() -> None:
    text = PAGE.read_text("utf-8")
    places = [text.index(f"| `{name}/` |") for names in FLOORS for name in names.split() if (PACKAGE / name).is_dir()]
    assert places == sorted(places)


def test_files_that_the_docs_name_exist() -> None:
    """Python files by their paths in the checkout, such as `tnst_mi/fields/grid.py`."""
    missing = {
        f"{page.name}: {name}"
        for page in [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")]
        for name in re.findall(r"\b((?:tnst_mi|scripts|tests)/[\w/]+\.py)\b", page.read_text("utf-8"))
        if not (ROOT / name).is_file()
    }
    assert missing == set()


def test_files_are_small_and_the_root_is_tidy() -> None:
    lines = {path: len(path.read_text("utf-8").splitlines()) for path in modules()}
    assert statistics.median(count for path, count in lines.items() if path.name != "__init__.py") <= 130
    assert {str(path): count for path, count in lines.items() if count > 320} == {}
    assert len([path for path in PACKAGE.iterdir() if path.is_file()]) <= 8


def test_algorithm_1_fits_a_screen() -> None:
    """Lines of code of `algorithm.py`, without docstrings, comments, blank lines and imports."""
    tree = ast.parse((PACKAGE / "optimisation" / "algorithm.py").read_text("utf-8"))
    documented = ast.FunctionDef | ast.ClassDef | ast.Module
    for node in ast.walk(tree):
        if isinstance(node, documented) and ast.get_docstring(node) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    tree.body = [node for node in tree.body if not isinstance(node, ast.Import | ast.ImportFrom)]
    assert len(ast.unparse(tree).splitlines()) <= 60


def test_no_two_classes_have_one_name() -> None:
    names = sorted(
        (node.name, str(path.relative_to(PACKAGE)))
        for path in modules()
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.ClassDef)
    )
    twice = [(a, b) for a, b in itertools.pairwise(names) if a[0] == b[0]]
    assert twice == []


def test_no_two_modules_of_tests_have_one_name() -> None:
    """pytest imports them by their names alone."""
    names = sorted(path.name for path in (ROOT / "tests").rglob("*.py") if path.name != "__init__.py")
    assert [name for name, other in itertools.pairwise(names) if name == other] == []
