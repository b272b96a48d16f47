"""Imports point one way: every module of the package may import only from lower floors (DESIGN.md, The house)."""

import ast
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "probupdate"

# room -> floor; a module may import rooms of a lower floor, and its own
FLOOR = {
    "errors": 0, "runtime": 0.1, "io": 0.2, "model": 0.3, "evidence": 0.35, "modal": 0.4,
    "structure": 1, "campaign": 1, "virtual": 1,
    "effects": 2, "identification": 2, "updating": 3,
    "diagnosis": 6, "lifetime": 6, "reporting": 7, "verbs": 8, "demonstration": 8.5, "farms": 8.9, "cli": 9,
    "__main__": 9.5,
}
APART = {("identification", "structure"), ("identification", "virtual"), ("updating", "virtual"),
         ("updating", "campaign"), ("updating", "identification")}
MODULES = sorted(PACKAGE.rglob("*.py"))


def room(path: Path) -> str:
    relative = path.relative_to(PACKAGE)
    return relative.parts[0].removesuffix(".py")


class Function(NamedTuple):
    """One of a module; lines without the docstring, lines and branches of those within another counted with it."""

    name: str
    lines: int
    branches: int
    arguments: int


class Source(NamedTuple):
    """What the tests ask of a module, which is parsed once. imports: (module, names imported from it or none)."""

    imports: tuple[tuple[str, tuple[str, ...]], ...]
    functions: tuple[Function, ...]
    writes: tuple[str, ...]


@cache
def source(path: Path) -> Source:
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    return Source(tuple(imports(nodes)), tuple(functions(nodes)), tuple(writes(nodes)))


def imports(nodes: Iterable[ast.AST]) -> Iterator[tuple[str, tuple[str, ...]]]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((alias.name, ()) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import of {node.module} in line {node.lineno}"
            yield node.module or "", tuple(alias.name for alias in node.names)


def imported_rooms(path: Path) -> set[str]:
    names = [f"probupdate.{name}" for module, inner in source(path).imports if module == "probupdate" for name in inner]
    names += [module for module, _ in source(path).imports]
    found = {name.split(".")[1] for name in names if name.startswith("probupdate.")}
    return found & (set(FLOOR) | {room(p) for p in MODULES})


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_one_way(path):
    here = room(path)
    if here == "__init__":
        return
    assert here in FLOOR, f"{here} has no floor: give it one here and in DESIGN.md"
    for other in imported_rooms(path) - {here}:
        assert FLOOR[other] < FLOOR[here], f"{here} imports {other}, which is not below it"
        assert (here, other) not in APART, f"{here} must not know {other}"


def test_floor_one_rooms_do_not_know_each_other():
    rooms = {"structure", "campaign", "virtual"}
    for path in MODULES:
        if room(path) in rooms:
            assert not imported_rooms(path) & (rooms - {room(path)})


def module_name(path: Path) -> str:
    """The dotted name within the package; of a room's `__init__` the room's."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")


def imported_names(path: Path, modules: set[str]) -> set[tuple[str, str]]:
    """(module of the package, name imported from it or "") for every import, those inside functions included."""
    found = set()
    for imported, names in source(path).imports:
        if imported.split(".")[0] != "probupdate":
            continue
        module = imported.removeprefix("probupdate").removeprefix(".")
        if not names and module:
            found.add((module, ""))
        for name in names:
            inner = f"{module}.{name}".removeprefix(".")
            found.add((inner, "") if inner in modules else (module, name))
    return found


@cache
def public_names(room: str) -> list[str]:
    """`__all__` of a room, as it is written."""
    for node in ast.parse((PACKAGE / room / "__init__.py").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return ast.literal_eval(node.value)
    return []


ROOMS = sorted(p.parent.name for p in PACKAGE.glob("*/__init__.py"))
NAMES = {module_name(path) for path in MODULES}


def circles(graph: dict[str, set[str]]) -> list[str]:
    """Names that lie on a circle: each reaches itself."""
    found = []
    for start in graph:
        reached, ahead = set(), [start]
        while ahead:
            new = graph.get(ahead.pop(), set()) - reached
            reached |= new
            ahead += new
        if start in reached:
            found.append(start)
    return found


def test_no_modules_import_one_another_in_a_circle():
    """Type hints included. The package's own `__init__` is left out: it loads steps when they are first used."""
    graph = {module_name(p): {m for m, _ in imported_names(p, NAMES)} - {"", "__init__"} for p in MODULES}
    assert circles(graph) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c"]


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_what_is_public_of_it(room):
    public = public_names(room)
    assert public and public == sorted(public), f"probupdate/{room}/__init__.py needs __all__, in order"
    tree = ast.parse((PACKAGE / room / "__init__.py").read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), f"probupdate/{room} does not say what it is for"
    own = {alias.asname or alias.name for node in tree.body if isinstance(node, ast.ImportFrom)
           for alias in node.names} | {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}
    assert not [name for name in public if name not in own and f"{room}.{name}" not in NAMES]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_rooms_are_entered_through_what_they_show(path):
    for module, name in imported_names(path, NAMES):
        other, _, inner = module.partition(".")
        if other in ROOMS and other != room(path):
            shown = inner or name
            # a room as a whole is its `__init__`, which holds what it shows
            assert not shown or shown in public_names(other), (
                f"{module} is {other}'s own: add it to its __all__ or go another way")
        assert not name.startswith("_") or name == "__version__", f"{name} is {module}'s own"


def test_documents_name_public_modules_only():
    root = PACKAGE.parent
    for page in (root / "README.md", *root.glob("docs/**/*.md")):
        for other, inner in re.findall(r"\bprobupdate\.(\w+)\.(\w+)", page.read_text(encoding="utf-8")):
            if f"{other}.{inner}" in NAMES:
                assert inner in public_names(other), f"{page.name}: probupdate.{other}.{inner} is the room's own"


def test_tests_import_public_names_only():
    """What a test needs of a module has a name that others may use, or is tested through one."""
    private = []
    for path in (PACKAGE.parent / "tests").rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        private += [f"{path.name}: {name}" for module, names in imports(nodes)
                    if module.startswith("probupdate") for name in names if name.startswith("_")]
    assert not private, f"{private}: import a public name, or test through one"


def test_arviz_is_imported_in_one_module_only():
    users = {path.relative_to(PACKAGE).as_posix() for path in MODULES
             if any(module.split(".")[0] == "arviz" for module, _ in source(path).imports)}
    assert users == {"updating/posterior_file.py"}


# what writes or opens a file for writing; `io.files` alone may, so that every file is whole or as it was
WRITING = {"write_text", "write_bytes", "to_csv", "savez", "savez_compressed", "save", "savefig", "to_netcdf",
           "to_parquet", "copyfile", "copy", "move", "symlink_to", "touch", "savetxt", "tofile", "dump"}


def writes(nodes: list[ast.AST]) -> list[str]:
    """"line call" of what writes a file in its own place rather than under a name of `io.files.written_whole`."""
    found = []
    parts = {item.optional_vars.id for node in nodes if isinstance(node, ast.With) for item in node.items
             if isinstance(item.context_expr, ast.Call)
             and getattr(item.context_expr.func, "id", "") == "written_whole"}
    for node in nodes:
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        modes = [a.value for a in (*node.args, *(k.value for k in node.keywords if k.arg == "mode"))
                 if isinstance(a, ast.Constant) and isinstance(a.value, str)]
        inside = {n.id for a in node.args for n in ast.walk(a) if isinstance(n, ast.Name)} & (parts | {"stream"})
        method = isinstance(node.func, ast.Attribute)
        opens = name in ("open", "File") and any(set(m) & set("wax+") and len(m) <= 3 for m in modes)
        of_array = name in ("copy", "save", "dump") and getattr(getattr(node.func, "value", None), "id", "") not in (
            "shutil", "np", "json", "pickle")
        in_memory = any(k.arg == "backing_store" for k in node.keywords) or (name == "to_netcdf" and not node.args)
        if not in_memory and (opens or (method and name in WRITING and not of_array)) and not inside:
            found.append(f"{node.lineno} {name}")
    return found


def test_every_file_is_written_whole():
    found = [f"{path.relative_to(PACKAGE)}:{text}" for path in MODULES if path != PACKAGE / "io" / "files.py"
             for text in source(path).writes]
    assert not found, f"write through probupdate.io.files, whole or not at all: {found}"


def test_a_write_in_place_is_found(tmp_path):
    (tmp_path / "a.py").write_text(
        "path.write_text('x')\nopen(p, 'w')\nframe.to_csv(out)\nnp.savez(out, a=1)\nh5py.File(out, 'w')\n"
        "with written_whole(path) as part, h5py.File(part, 'w') as file:\n    pass\n"
        "open(p)\nh5py.File(p, 'r')\na.copy()\n")
    found = source(tmp_path / "a.py").writes
    assert [text.split()[1] for text in found] == ["write_text", "open", "to_csv", "savez", "File"]


def test_no_line_is_longer_than_120_characters():
    """Code is laid out by hand, and what is too long is found here; no file is left out."""
    root, folders = PACKAGE.parent, ("probupdate", "tests", "studies")
    words = ["git", "ls-files", *(f"{folder}/*.py" for folder in folders)]
    tracked = subprocess.run(words, cwd=root, capture_output=True, text=True).stdout if shutil.which("git") else ""
    # without a repository, as where an archive was unpacked, all files
    paths = [root / name for name in tracked.splitlines() if (root / name).is_file()] or [
        path for folder in folders for path in (root / folder).rglob("*.py")]
    found = [f"{path.relative_to(root)}:{k}" for path in paths
             for k, line in enumerate(path.read_text(encoding="utf-8").split("\n"), 1) if len(line) > 120]
    assert not found, f"longer than 120 characters: {found}"


def test_import_of_the_steps_loads_what_every_step_needs_only():
    """What some steps need is imported where it is used: half a second of every command."""
    heavy = {"matplotlib", "arviz", "emcee", "jinja2", "rich", "distributed", "scipy.signal", "scipy.stats",
             "scipy.optimize", "scipy.interpolate"}
    for names, held in ((public_names("verbs"), heavy), (["models", "estimating"], heavy | {"pandas"})):
        code = (f"import sys; from probupdate.verbs import {', '.join(names)}\n"
                f"print(sorted({held!r} & set(sys.modules)))")
        answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert answer.stdout.strip() == "[]", names


def test_import_of_the_package_stays_light():
    heavy = {"matplotlib", "arviz", "emcee", "pandas", "h5py", "jinja2", "pydantic", "rich", "scipy"}
    code = f"import sys, probupdate; print(sorted({heavy!r} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def functions(nodes: list[ast.AST]) -> Iterator[Function]:
    """Every `Function` among the nodes of a module."""
    branching = (ast.If, ast.For, ast.While, ast.ExceptHandler, ast.comprehension, ast.match_case)
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0]
            documented = first.end_lineno - first.lineno + 1 if ast.get_docstring(node) is not None else 0
            yield Function(node.name, node.end_lineno - node.lineno + 1 - documented,
                           1 + sum(isinstance(inner, branching) for inner in ast.walk(node)),
                           len([*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]))


def test_functions_are_short_enough_to_be_read_at_once():
    """60 lines and 20 branches (McCabe's number, comprehensions among them) at most."""
    found = [f"{module_name(path)}.{one.name}: {one.lines} lines, {one.branches} branches" for path in MODULES
             for one in source(path).functions if one.lines > 60 or one.branches > 20]
    assert not found, f"split where a reader gains: {found}"


def test_functions_take_few_arguments():
    """Ten at most of a step, whose options are values that it shares with its command; twelve elsewhere."""
    found = [f"{module_name(path)}.{one.name}: {one.arguments}" for path in MODULES for one in source(path).functions
             if one.arguments > (10 if room(path) == "verbs" else 12)]
    assert not found, found


def test_lines_and_branches_are_counted(tmp_path):
    (tmp_path / "a.py").write_text(
        'def f(x):\n    """Says\n    it."""\n    if x:\n        return [y for y in x]\n    return 1\n')
    assert source(tmp_path / "a.py").functions == (("f", 4, 3, 1),)
