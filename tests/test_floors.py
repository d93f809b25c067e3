"""The house of the design: who may import whom, read from the sources themselves."""

from __future__ import annotations

import ast
import graphlib
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial

PACKAGE = Path(__file__).parents[1] / "fracflow"
LONGEST = 450

# floor -> groups; a group is a package, or modules that stand together and may import each other
FLOORS = (
    (
        {"errors", "files", "files_hdf", "h5_reader", "h5_worker", "sealed"},
        {"_petsc"},
        {"laws"},
        {"elements"},
        {"stepping"},
    ),
    ({"mesh"}, {"scene*", "units", "tables*", "profiles"}),
    ({"state"},),
    ({"assembly"},),
    ({"coupling"},),
    ({"output"},),
    ({"card"},),
    ({"plan"},),
    ({"begin"},),
    ({"steps"},),
    ({"stages"}, {"record"}),
    ({"run"},),
    ({"refinement"},),
    ({"cli*", "__main__", "endings"}, {"api"}),
)
ROOT = "fracflow"  # the package's face: it may import all, none may import it
PLAIN = {"laws", "elements", "stepping"}  # NumPy only
SHARED_LAWS = {"__init__", "base", "closure", "cubic_flow", "elastic", "friction"}
BASE = {("_petsc", "errors")}  # within floor 0


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


def nodes_that_run(tree: ast.AST):
    """All nodes but those behind ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
            yield node
            yield from nodes_that_run(node)


def imports(module: Module, known: dict[str, Module], walk=ast.walk) -> set[str]:
    """Full dotted names of what a module imports; of fracflow, always the module and never a name in it."""
    found = set()
    is_package = any(name.startswith(module.name + ".") for name in known) or module.name == ""
    here = [ROOT, *filter(None, module.name.split("."))]
    for node in walk(module.tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            up = here[: len(here) - node.level + is_package] if node.level else []
            base = ".".join([*up, *filter(None, [node.module])])
            for alias in node.names:
                is_module = f"{base}.{alias.name}".removeprefix(ROOT + ".") in known
                is_ours = base == ROOT or base.startswith(ROOT + ".")
                if alias.name != "__version__" or base != ROOT:
                    found.add(f"{base}.{alias.name}" if is_ours and is_module else base)
    return found


def place(top: str) -> tuple[int, int] | None:
    for floor, groups in enumerate(FLOORS):
        for number, group in enumerate(groups):
            if any(top == name or (name[-1] == "*" and top.startswith(name[:-1])) for name in group):
                return floor, number
    return None


def ours(name: str) -> str | None:
    """Name inside the package, or None for another package's module."""
    return "" if name == ROOT else name.removeprefix(ROOT + ".") if name.startswith(ROOT + ".") else None


def check_floors(modules: dict[str, Module]) -> list[str]:
    faults = []
    for module in modules.values():
        if module.name == "":
            continue
        if (mine := place(module.top)) is None:
            faults.append(f"{module.name}: has no floor; give it one in FLOORS")
            continue
        targets = map(ours, imports(module, modules))
        for target in sorted(target for target in targets if target is not None):
            top = target.split(".")[0]
            theirs = place(top)
            if target == "":
                faults.append(f"{module.name}: imports the root package; import the module that is meant")
            elif theirs is None or not (
                theirs == mine or theirs[0] < mine[0] or (module.name, target) in BASE
                or (module.top in PLAIN and top == "errors")
            ):  # fmt: skip
                faults.append(f"{module.name}: imports {target}, which is not on a floor below")
    return faults


def check_outside(modules: dict[str, Module]) -> list[str]:
    faults, meshers = [], []
    for module in modules.values():
        foreign = {name.split(".")[0] for name in imports(module, modules) if ours(name) is None}
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
            if named in classes or (said in keys and not module.top.startswith("scene")):
                faults.append(f"{module.name}: names the joint law {named or said}; only laws/ may")
    return faults


def check_cycles(modules: dict[str, Module]) -> list[str]:
    found = {name: map(ours, imports(module, modules, nodes_that_run)) for name, module in modules.items()}
    graph = {name: {to for to in targets if to in modules} - {name} for name, targets in found.items()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return [f"imports go round: {' > '.join(error.args[1])}"]
    return []


def check_length(modules: dict[str, Module]) -> list[str]:
    long = [module for module in modules.values() if module.lines > LONGEST]
    return [f"{module.name}: has {module.lines} lines, at most {LONGEST}" for module in long]


CHECKS = (check_floors, check_outside, check_laws, check_cycles, check_length)


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
    "scene.py": "from fracflow import units, __version__\nfrom .laws import JOINT_LAWS\nx = 'bent-spring'\n",
    "units.py": "import pint\nif TYPE_CHECKING:\n    from fracflow.scene.scene import Scene\n",
    "run.py": "from .mesh import gmsh\nkind = 'linear'\n",
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
        ("mesh/read.py", "def f():\n    import fracflow.simulation.run", "mesh.read: imports run"),
        ("mesh/read.py", "from ..run import run", "mesh.read: imports run"),
        ("mesh/read.py", "import fracflow", "imports the root package"),
        ("laws/base.py", "from fracflow._petsc import PETSc", "laws.base: imports _petsc"),
        ("elements/joint.py", "from fracflow.laws import base", "elements.joint: imports laws.base"),
        ("laws/base.py", "import scipy.sparse", "only NumPy"),
        ("run.py", "from petsc4py import PETSc", "run: imports petsc4py"),
        ("mesh/read.py", "import gmsh", "gmsh is imported by"),
        ("run.py", "law = 'bent-spring'", "names the joint law bent-spring"),
        ("run.py", "from fracflow.laws.linear import Linear", "imports fracflow.laws.linear"),
        ("run.py", "from fracflow import laws\nlaws.BentSpring", "names the joint law BentSpring"),
        ("units.py", "from fracflow.scene.scene import x", "imports go round"),
        ("laws/base.py", "from fracflow.laws.bent_spring import BentSpring", "imports go round"),
        ("errors.py", "\n" * (LONGEST + 1), f"errors: has {LONGEST + 1} lines"),
        ("attic.py", "", "attic: has no floor"),
    ],
)
def test_a_planted_fault_is_found(tmp_path, name, text, fault):
    assert any(fault in found for found in faults_of(tmp_path, {name: text}))
