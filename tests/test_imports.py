"""Imports point one way, and what is heavy is imported where it belongs."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

import hatn_sim
from hatn_sim.evaluation.made_by import NO_PART_IN_DRIVES, NO_PART_IN_RUNS

PACKAGE = Path(hatn_sim.__file__).parent

HIGHWAY = tuple(
    f"simulators.highway{part}"
    for part in ("", "_environment", "_lanes", "_places", "_traffic", "_watched")
)

ONLY_IN = {
    "torch": ("hatn", "learn", "policies.training"),
    "safetensors": ("hatn", "learn", "policies.network"),
    "stable_baselines3": ("policies.training",),
    "libsumo": ("simulators.sumo_worker", "simulators.sumo_replay.worker"),
    "traci": (),
    "sumolib": (),
    "highway_env": HIGHWAY,
    "gymnasium": ("envs", "policies.lawful_env", *HIGHWAY),
    "pettingzoo": ("envs.parallel_env",),
    "pyarrow": ("log", "recordings"),
    "pyproj": ("recordings",),
    "lanelet2": (),
    "matplotlib": ("report",),
    "av": ("report.film_file",),
    "rerun": ("report.rerun_file",),
    "rich": ("report", "commands"),
}
"""Package -> the modules, or packages of modules, that may import it."""

LAYERS = (
    (
        *("", "content", "datatypes", "errors", "geometry", "kept", "plugins", "resources"),
        *("safe_xml", "whole_file"),
    ),
    ("config", "conflict_table", "conflicts", "lane_graph", "lane_index", "road", "simulators"),
    (
        *("candidates", "graph", "habits", "labels", "line_choice", "line_features", "lines"),
        *("perception", "speed_profile", "tracks", "way", "worlds"),
    ),
    ("assist", "hatn", "planning", "predictors"),
    (
        *("conformance", "evaluation", "learn", "log", "loop", "recordings", "report", "score"),
        "traffic",
    ),
    (
        *("bench", "bench_branch", "bench_runtime", "bench_scaling", "cli", "commands", "envs"),
        "policies",
    ),
)
"""A module may import from its own layer and from those above it in this list, never below."""

SIMULATORS_IMPORT = ("config", "datatypes", "errors", "geometry", "road", "safe_xml", "simulators")


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def module_name(path: Path) -> str:
    """Dotted, without the package's own name: "" for the package itself."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


SOURCES = {module_name(path): parse(path) for path in sorted(PACKAGE.rglob("*.py"))}


def imports(node: ast.AST, *, only_top: bool = False) -> Iterator[str]:
    """What a module imports when it runs: imports for type checkers only do not count."""
    inside: Iterable[ast.AST] = ast.iter_child_nodes(node)
    match node:
        case ast.Import(names=names):
            yield from (name.name for name in names)
        case ast.ImportFrom(module=module, names=names, level=level):
            assert level == 0 and module is not None, "relative imports are not used here"
            yield from (f"{module}.{name.name}" for name in names)
        case ast.If(test=ast.Name(id="TYPE_CHECKING"), orelse=otherwise):
            inside = otherwise
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.Lambda() if only_top:
            inside = ()
        case _:
            pass
    for child in inside:
        yield from imports(child, only_top=only_top)


@cache
def imports_of(module: str) -> frozenset[str]:
    """All that a module of this package imports when it runs."""
    return frozenset(imports(SOURCES[module]))


def own_imports(tree: ast.AST, *, only_top: bool = False) -> set[str]:
    """The modules of this package among the imports, without its name."""
    names = (name.partition(".") for name in imports(tree, only_top=only_top))
    own = {name for package, _, name in names if package == "hatn_sim"}
    # What is no module is something in one.
    return {name if name in SOURCES else name.rpartition(".")[0] for name in own}


def layer_of(module: str) -> int:
    first = module.partition(".")[0]
    found = [index for index, names in enumerate(LAYERS) if first in names]
    assert found, f"{module} is in no layer: find its place in LAYERS"
    return found[0]


def is_in(module: str, place: str) -> bool:
    return module == place or module.startswith(f"{place}.")


def test_the_reader_of_imports_sees_what_python_runs() -> None:
    tree = ast.parse(
        "import a.b\nfrom c import d\nif TYPE_CHECKING:\n    import e\nelse:\n    import f\n"
        "def g():\n    import h\nclass I:\n    import j\ntry:\n    import k\nexcept E:\n    pass\n"
    )
    assert list(imports(tree)) == ["a.b", "c.d", "f", "h", "j", "k"]
    assert list(imports(tree, only_top=True)) == ["a.b", "c.d", "f", "j", "k"]
    assert {"cli", "hatn.sgn", "simulators.sumo_worker"} <= SOURCES.keys()


@pytest.mark.parametrize("package", ONLY_IN)
def test_what_is_heavy_is_imported_where_it_belongs(package: str) -> None:
    importing = {
        module for module in SOURCES if any(is_in(name, package) for name in imports_of(module))
    }
    allowed = {
        module for module in SOURCES if any(is_in(module, place) for place in ONLY_IN[package])
    }
    assert importing <= allowed


def test_imports_point_one_way() -> None:
    wrong = [
        f"{module} imports {other}"
        for module, tree in SOURCES.items()
        for other in own_imports(tree)
        if layer_of(other) > layer_of(module)
    ]
    assert wrong == []


def test_simulators_know_nothing_of_what_is_made_of_their_frames() -> None:
    wrong = [
        f"{module} imports {other}"
        for module, tree in SOURCES.items()
        if is_in(module, "simulators")
        for other in own_imports(tree)
        if other.partition(".")[0] not in SIMULATORS_IMPORT
    ]
    assert wrong == []


def all_imports(*modules: str) -> set[str]:
    """The modules, and all that they import, and all that these import."""
    found: set[str] = set()
    wanted = list(modules)
    while wanted:
        module = wanted.pop()
        if module not in found:
            found.add(module)
            wanted += own_imports(SOURCES[module])
    return found


@pytest.mark.parametrize(
    ("module", "no_part"),
    [
        ("evaluation.assessing", NO_PART_IN_RUNS),
        ("evaluation.closed_loop", NO_PART_IN_DRIVES),
    ],
)
def test_the_source_that_a_kept_run_comes_of_is_all_that_it_imports(
    module: str, no_part: tuple[str, ...]
) -> None:
    files = {
        name: path.relative_to(PACKAGE).as_posix()
        for path in sorted(PACKAGE.rglob("*.py"))
        if (name := module_name(path))
    }
    used = all_imports(module, "simulators.sumo_worker") - {""}
    left_out = [name for name in used if files[name].startswith(no_part)]
    assert left_out == []


def test_what_the_predictors_see_is_made_without_a_simulator() -> None:
    wrong = [
        f"{module} imports {other}"
        for module, tree in SOURCES.items()
        if 2 <= layer_of(module) <= 3
        for other in own_imports(tree)
        if is_in(other, "simulators")
    ]
    assert wrong == []


def test_no_module_needs_itself_to_be_imported() -> None:
    needs = {module: own_imports(tree, only_top=True) for module, tree in SOURCES.items()}
    # What is left after taking away, again and again, the modules that need nothing that is left.
    while free := {module for module, others in needs.items() if not others & needs.keys()}:
        needs = {module: others for module, others in needs.items() if module not in free}
    assert needs == {}
