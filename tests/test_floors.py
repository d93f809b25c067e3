"""The house of the design: who may import whom, read from the sources themselves."""

from __future__ import annotations

import ast
import graphlib
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial

PACKAGE = Path(__file__).parents[1] / "fracflow"
LONGEST = 450

# layers from the ground up; packages of one layer do not import each other, but for the second of a pair in BESIDE
LAYERS = (
    {"errors", "remarks", "storage", "_petsc", "_version"},
    {"laws", "elements", "integrators"},
    {"scene", "mesh"},
    {"model"},
    {"solve", "diagnostics", "output"},
    {"advance", "run_report"},
    {"reduction"},
    {"simulation"},
    {"cli", "api", "__main__"},
)
MOST_AT_ROOT, MOST_IN_PACKAGE = 9, 25  # files
ROOT = "fracflow"  # the package's face: it may import all, none may import it
PLAIN = {"laws", "elements", "integrators"}  # NumPy only
SHARED_LAWS = {
    "__init__", "base", "closure", "compiled", "cubic_flow", "elastic", "friction", "leak_off", "roughness", "terms",
}  # fmt: skip
BESIDE = {("storage", "errors"), ("_petsc", "errors"), ("__main__", "cli")}


@dataclass(frozen=True)
class Module:
    name: str  # "laws.base"; a package is "laws"; the root is ""
    tree: ast.Module
    lines: int

    @property
    def top(self) -> str:
        return self.name.split(".")[0]


def read_modules(package: Path) -> dict[str, Module]:
    found = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        text = path.read_text(encoding="utf-8")
        found[name] = Module(name, ast.parse(text), len(text.splitlines()))
    return found


def imports(module: Module, known: dict[str, Module]) -> set[str]:
    """Full dotted names of what a module imports; of fracflow, always the module and never a name in it."""
    found = set()
    is_package = any(name.startswith(module.name + ".") for name in known) or module.name == ""
    here = [ROOT, *filter(None, module.name.split("."))]
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            up = here[: len(here) - node.level + is_package] if node.level else []
            base = ".".join([*up, *filter(None, [node.module])])
            for alias in node.names:
                is_module = f"{base}.{alias.name}".removeprefix(ROOT + ".") in known
                is_ours = base == ROOT or base.startswith(ROOT + ".")
                found.add(f"{base}.{alias.name}" if is_ours and is_module else base)
    return found


LAYER = {name: number for number, names in enumerate(LAYERS) for name in names}


def ours(name: str) -> str | None:
    """Name inside the package, or None for another package's module."""
    return "" if name == ROOT else name.removeprefix(ROOT + ".") if name.startswith(ROOT + ".") else None


def check_layers(modules: dict[str, Module]) -> list[str]:
    """Imports go down, those under TYPE_CHECKING too."""
    faults = []
    for module in modules.values():
        if module.name == "":
            continue
        if module.top not in LAYER:
            faults.append(f"{module.name}: has no layer; give it one in LAYERS")
            continue
        targets = map(ours, imports(module, modules))
        for target in sorted(target for target in targets if target is not None):
            top = target.split(".")[0]
            if target == "":
                faults.append(f"{module.name}: imports the root package; import the module that is meant")
            elif top != module.top and (module.top, top) not in BESIDE and LAYER.get(top, 99) >= LAYER[module.top]:
                faults.append(f"{module.name}: imports {target}, which is not in a layer below")
    return faults


def check_outside(modules: dict[str, Module]) -> list[str]:
    faults, meshers = [], []
    for module in modules.values():
        foreign = {name.split(".")[0] for name in imports(module, modules) if ours(name) is None}
        ground = {name.split(".")[0] for name in map(ours, imports(module, modules)) if name} - {"errors", module.top}
        if module.top in PLAIN and ground:
            faults.append(f"{module.name}: imports {', '.join(sorted(ground))}; of ours, only errors is allowed there")
        if module.top in PLAIN and (more := foreign - {"numpy"} - set(sys.stdlib_module_names)):
            faults.append(f"{module.name}: imports {sorted(more)}; only NumPy is allowed there")
        if "petsc4py" in foreign and module.name != "_petsc":
            faults.append(f"{module.name}: imports petsc4py; take PETSc from fracflow._petsc")
        meshers += [module.name] if "gmsh" in foreign else []
    if len(meshers) > 1:
        faults.append(f"gmsh is imported by {meshers}; one file is enough")
    return faults


def check_laws(modules: dict[str, Module]) -> list[str]:
    """Nothing outside laws/ names a joint law; the scene's modules may name their default."""
    laws = [module for module in modules.values() if module.top == "laws" and "." in module.name]
    laws = [module for module in laws if module.name.split(".")[-1] not in SHARED_LAWS]
    classes = {
        node.name for law in laws for node in law.tree.body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    }  # fmt: skip
    stems = {law.name.split(".")[-1] for law in laws}
    # A single word ("linear") means other things elsewhere.
    keys = {word for stem in stems if "_" in stem for word in (stem, stem.replace("_", "-"))}
    faults = []
    for module in modules.values():
        if module.top == "laws":
            continue
        for target in imports(module, modules) & {f"{ROOT}.{law.name}" for law in laws}:
            faults.append(f"{module.name}: imports {target}; ask the registry JOINT_LAWS")
        for node in ast.walk(module.tree):
            named = getattr(node, "id", None) or getattr(node, "attr", None) or getattr(node, "name", None)
            said = node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None
            if named in classes or (said in keys and module.top != "scene"):
                faults.append(f"{module.name}: names the joint law {named or said}; only laws/ may")
    return faults


def check_cycles(modules: dict[str, Module]) -> list[str]:
    found = {name: map(ours, imports(module, modules)) for name, module in modules.items()}
    graph = {name: {to for to in targets if to in modules} - {name} for name, targets in found.items()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return [f"imports go round: {' > '.join(error.args[1])}"]
    return []


def check_sizes(modules: dict[str, Module]) -> list[str]:
    """Lines of a file, files of a package and at the root."""
    faults = [
        f"{module.name}: has {module.lines} lines, at most {LONGEST}"
        for module in modules.values()
        if module.lines > LONGEST
    ]
    count = Counter(name.rpartition(".")[0] or "the root" for name in modules if not is_package(name, modules))
    most = dict.fromkeys(count, MOST_IN_PACKAGE) | {"the root": MOST_AT_ROOT}
    return faults + [
        f"{name}: has {found} files, at most {most[name]}" for name, found in count.items() if found > most[name]
    ]


def is_package(name: str, modules: dict[str, Module]) -> bool:
    """Whether other modules are inside one."""
    return any(other.startswith(f"{name}.") for other in modules) if name else True


CHECKS = (check_layers, check_outside, check_laws, check_cycles, check_sizes)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_house_is_in_order(check):
    modules = read_modules(PACKAGE)
    assert {"errors", "_petsc"} <= modules.keys()
    assert check(modules) == []


HOUSE = {
    "__init__.py": "from fracflow.simulation.run import run\n",
    "_petsc.py": "from fracflow.errors import InputError\nimport petsc4py\n",
    "errors.py": "",
    "laws/__init__.py": "from .bent_spring import BentSpring\nfrom fracflow.laws.linear import Linear\n",
    "laws/base.py": "import numpy as np\nfrom fracflow.errors import InputError\n",
    "laws/bent_spring.py": "from fracflow.laws import base\nclass BentSpring: ...\n",
    "laws/linear.py": "class Linear: ...\n",
    "elements/__init__.py": "",
    "mesh/__init__.py": "",
    "mesh/gmsh.py": "import gmsh\n",
    "scene/__init__.py": "",
    "scene/scene.py": "from fracflow.scene import units\nfrom ..laws import JOINT_LAWS\nx = 'bent-spring'\n",
    "_version.py": "",
    "scene/units.py": "import pint\nfrom fracflow._version import __version__\n",
    "simulation/__init__.py": "",
    "simulation/run.py": "from ..mesh import gmsh\nkind = 'linear'\n",
}


def faults_of(tmp_path: Path, changes: dict[str, str]) -> list[str]:
    for name, text in {**HOUSE, **changes}.items():
        path = tmp_path / ROOT / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    modules = read_modules(tmp_path / ROOT)
    return [fault for check in CHECKS for fault in check(modules)]


def test_a_good_house_passes(tmp_path):
    assert faults_of(tmp_path, {}) == []


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("mesh/read.py", "from fracflow import scene", "mesh.read: imports scene"),
        ("mesh/read.py", "def f():\n    import fracflow.simulation.run", "mesh.read: imports simulation.run"),
        ("mesh/read.py", "from ..simulation.run import run", "mesh.read: imports simulation.run"),
        ("mesh/read.py", "import fracflow", "imports the root package"),
        ("laws/base.py", "from fracflow._petsc import PETSc", "laws.base: imports _petsc"),
        ("elements/joint.py", "from fracflow.laws import base", "elements.joint: imports laws.base"),
        ("laws/base.py", "import scipy.sparse", "only NumPy"),
        ("simulation/run.py", "from petsc4py import PETSc", "simulation.run: imports petsc4py"),
        ("mesh/read.py", "import gmsh", "gmsh is imported by"),
        ("simulation/run.py", "law = 'bent-spring'", "names the joint law bent-spring"),
        ("simulation/run.py", "from fracflow.laws.linear import Linear", "imports fracflow.laws.linear"),
        ("simulation/run.py", "from fracflow import laws\nlaws.BentSpring", "names the joint law BentSpring"),
        ("scene/units.py", "from fracflow.scene.scene import x", "imports go round"),
        ("scene/units.py", "if TYPE_CHECKING:\n    from fracflow.scene.scene import x", "imports go round"),
        ("laws/base.py", "from fracflow.laws.bent_spring import BentSpring", "imports go round"),
        ("errors.py", "\n" * (LONGEST + 1), f"errors: has {LONGEST + 1} lines"),
        ("attic.py", "", "attic: has no layer"),
    ],
)
def test_a_planted_fault_is_found(tmp_path, name, text, fault):
    assert any(fault in found for found in faults_of(tmp_path, {name: text}))
