"""The layers, read from the source: who may import whom, and one name for each stage everywhere.

render, library, plan, certify, report, batch, cli -> domain packages -> gpu -> wgpu; reference/
stands apart, so that it can judge. An import inside a function counts like one at the top; one for
type checkers alone, which never runs, counts where packages are told apart, not in cycles.
"""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pytest
from harness import shader_names

from gpusim.gpu.wgsl import load

PROJECT = Path(__file__).resolve().parents[1]
PACKAGE = PROJECT / "gpusim"
DOMAIN = ("camera", "scene", "lens", "psf", "formats", "optics", "sensor", "isp", "metrics")
TOP = (
    "render",
    "library",
    "calibrate",
    "plan",
    "certify",
    "pareto",
    "stress",
    "validate",
    "report",
    "batch",
    "tolerance",
    "preview",
    "web",
    "cli",
)
HEAVY = ("wgpu", "colour", "matplotlib", "scipy", "xarray")
STAGES = shader_names()
# Stages whose float64 twin is not in reference/: the tracer of gpusim/lens also prepares the lens
# (chief rays, stop, clear apertures, focus), so the product needs it beside the stages.
TWINS = {"aim": "gpusim.lens.aim", "trace": "gpusim.lens.trace"}


def modules() -> dict[str, Path]:
    """Return every module of the package by its dotted name."""
    found = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        parts = file.relative_to(PROJECT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


MODULES = modules()


def running(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a module without what stands under ``if TYPE_CHECKING``."""
    yield tree
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            for node in child.orelse:
                yield from running(node)
        else:
            yield from running(child)


def imports(module: str, text: str, is_package: bool, typing: bool = True) -> Iterator[str]:
    """Yield the dotted names that a module's text imports; ``from a import b`` yields ``a.b``.

    ``typing``: with those for type checkers alone.
    """
    package = module.split(".") if is_package else module.split(".")[:-1]
    tree = ast.parse(text)
    for node in ast.walk(tree) if typing else running(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


IMPORTS = {
    name: sorted(set(imports(name, file.read_text(), file.name == "__init__.py")))
    for name, file in MODULES.items()
}


def home(name: str, modules: Mapping[str, Path]) -> str:
    """Return the module of a dotted name; empty for one of another project."""
    while name and name not in modules:
        name = name.rpartition(".")[0]
    return name


def runs(text: Mapping[str, str], packages: Collection[str] = ()) -> dict[str, set[str]]:
    """Return which modules each module imports when it runs, by the texts of all of them."""
    return {
        name: {
            found
            for one in imports(name, content, name in packages, typing=False)
            if (found := home(one, text)) and found != name
        }
        for name, content in text.items()
    }


def cycle(graph: Mapping[str, Collection[str]]) -> list[str]:
    """Return one cycle of a graph, its first member again at the end; empty where there is none."""
    done: set[str] = set()
    for start in graph:
        path, left = [start], [iter(sorted(graph[start]))]
        while path and start not in done:
            following = next(left[-1], None)
            if following is None:
                done.add(path.pop())
                left.pop()
            elif following in path:
                return [*path[path.index(following) :], following]
            elif following not in done:
                path.append(following)
                left.append(iter(sorted(graph.get(following, ()))))
    return []


RUNS = runs(
    {name: file.read_text() for name, file in MODULES.items()},
    {name for name, file in MODULES.items() if file.name == "__init__.py"},
)


def package_of(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def inside(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


def offences(importers: str | tuple[str, ...], forbidden: tuple[str, ...]) -> list[str]:
    """List the imports of ``forbidden`` names by modules inside ``importers``."""
    importers = (importers,) if isinstance(importers, str) else importers
    return [
        f"{module} imports {name}"
        for module, names in IMPORTS.items()
        if any(inside(module, f"gpusim.{importer}") for importer in importers)
        for name in names
        if any(inside(name, one) for one in forbidden)
    ]


def test_the_reader_resolves_every_form_of_import():
    text = "import a.b\nfrom . import c\nfrom .d import e\ndef f():\n    from ..g import h as i\n"
    assert list(imports("gpusim.x.y", text, False)) == [
        "a.b",
        "gpusim.x.c",
        "gpusim.x.d.e",
        "gpusim.g.h",
    ]
    assert "gpusim.x.y.c" in imports("gpusim.x.y", text, True)


def test_the_reader_finds_what_is_there():
    assert {"gpusim", "gpusim.errors", "gpusim.gpu", "gpusim.gpu.kernel"} <= MODULES.keys()
    assert "wgpu" in IMPORTS["gpusim.gpu.device"]
    assert "gpusim.gpu.packing.ShaderError" in IMPORTS["gpusim.gpu.kernel"]
    assert offences("gpu", ("wgpu",))


def test_no_module_imports_itself_by_way_of_others():
    assert cycle(RUNS) == []


def test_no_package_imports_itself_by_way_of_others():
    """What type checkers alone see is free; the top, `gpusim` itself, holds the version."""
    graph: dict[str, set[str]] = {}
    for name, found in RUNS.items():
        if package := package_of(name):
            others = {package_of(one) for one in found} - {"", package}
            graph.setdefault(package, set()).update(others)
    assert cycle(graph) == []


def test_a_cycle_is_found_also_inside_a_function():
    text = {
        "a.x": "import a.y\n",
        "a.y": "if TYPE_CHECKING:\n    import a.x\ndef f():\n    from a import z\n",
        "a.z": "",
    }
    assert cycle(runs(text)) == []
    assert cycle(runs(text | {"a.z": "from a.x import g\n"})) == ["a.x", "a.y", "a.z", "a.x"]


def test_lenses_know_nothing_of_point_spread_functions_and_files_of_others():
    assert offences("lens", ("gpusim.psf", "gpusim.formats")) == []


def test_only_the_gpu_layer_knows_wgpu():
    others = tuple({name.split(".")[1] for name in MODULES if "." in name} - {"gpu"})
    assert offences(others, ("wgpu",)) == []


def test_a_plan_is_made_without_a_device():
    """What it may know of the layer below are sizes: how much one binding and one buffer hold."""
    names = {
        name for module in MODULES if inside(module, "gpusim.plan") for name in IMPORTS[module]
    }
    assert [n for n in names if inside(n, "gpusim.gpu") and not inside(n, "gpusim.gpu.pool")] == []


def test_a_plan_is_made_where_no_device_can_be_opened():
    """A process whose wgpu cannot be imported: the planner, as any import or call would tell."""
    code = """
import sys
import gpusim.plan
assert "wgpu" not in sys.modules
sys.modules["wgpu"] = None
from optics.made import FLAT, bank, scene, sensor
given = bank(), sensor(), scene((), FLAT[None])
print(gpusim.plan.plan_optics(*given, gpusim.plan.Accuracy(0.03)).text())
"""
    paths = {"PYTHONPATH": os.pathsep.join([str(PROJECT), str(PROJECT / "tests")])}
    asked = {"capture_output": True, "text": True, "check": True, "env": os.environ | paths}
    done = subprocess.run([sys.executable, "-c", code], **asked)
    assert "skip warp" in done.stdout


def test_the_gpu_layer_knows_no_domain():
    names = [name for module in MODULES if inside(module, "gpusim.gpu") for name in IMPORTS[module]]
    ours = {name for name in names if inside(name, "gpusim")}
    allowed = ("gpusim.gpu", "gpusim.errors")
    assert [name for name in ours if not any(inside(name, one) for one in allowed)] == []


def test_the_domain_does_not_know_what_is_built_on_it():
    assert offences(DOMAIN, tuple(f"gpusim.{name}" for name in TOP)) == []


def test_the_reference_shares_nothing_with_what_it_judges():
    hosts = tuple(f"gpusim.{stage.replace('/', '.')}" for stage in STAGES)
    forbidden = ("gpusim.gpu", *hosts, *(f"gpusim.{name}" for name in TOP))
    assert offences("reference", forbidden) == []


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_has_its_name_everywhere(stage: str):
    name = stage.rpartition("/")[2]
    twin = TWINS.get(name, f"gpusim.reference.{name}")
    assert twin in MODULES
    assert name in TWINS or callable(getattr(importlib.import_module(twin), name))
    assert list((PROJECT / "tests").rglob(f"test_{name}.py"))


@pytest.mark.parametrize("include", shader_names(includes=True))
def test_an_include_is_used_by_a_stage(include: str):
    users = [stage for stage in STAGES if f"{include}.wgsl" in dict(load(stage).origins)]
    assert users


def test_the_command_line_starts_without_the_heavy_libraries():
    code = "import sys, gpusim.cli; print(*sorted(m.partition('.')[0] for m in sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    loaded = set(done.stdout.split())
    assert "gpusim" in loaded
    assert loaded & set(HEAVY) == set()


def test_a_render_starts_without_what_few_scenes_need():
    """Importing scipy.stats takes a fifth of a start; photographs' halos and Sobol draws use it."""
    code = "import sys, gpusim.batch.work, gpusim.batch.run; print('scipy.stats' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
