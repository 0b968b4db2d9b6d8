"""Each process of a cell needs the base dependencies and those of the extra of its name."""

import ast
import sys

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.unit.repository.test_repository import METADATA
from tools.tree import PRODUCTION, Module, modules

MODULES = modules()
# The imported name of a package, where it is not the package's own.
IMPORTED_AS = {
    "eclipse-zenoh": "zenoh",
    "pyyaml": "yaml",
    "pin": "pinocchio",
    "pyserial": "serial",
    "pyarrow": "pyarrow",
    "bota-driver": "bota_driver",
}
EXTRAS = {
    "services.hub": (),
    "services.sensor": ("robotiq", "bota"),
    "services.wrench": (),
    "services.regulator": (),
    "services.arbiter": (),
    "services.gateway": (),
    "services.recorder": ("recorder",),
    "services.panel": ("panel",),
    "sim.robot": ("sim",),
    "sim.netft": (),
    "sim.controller": ("sim",),
    "cli": ("cli", "parquet"),
}
SHIPPED_WITH = {"pydantic_core": "pydantic"}  # imported by name, part of another package


def imported_packages(module: Module) -> set[str]:
    """Return the third-party packages that a module imports, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    tops = {name.partition(".")[0] for name in names}
    found = tops - set(PRODUCTION) - sys.stdlib_module_names
    return {SHIPPED_WITH.get(name, name) for name in found}


def reached(process: str) -> set[str]:
    """Return the modules that a process may import, the packages that hold them included."""
    found: set[str] = set()
    ahead = [f"{process}.__main__"]
    while ahead:
        name = ahead.pop()
        if name in MODULES and name not in found:
            found.add(name)
            ahead += [*MODULES[name].imports(MODULES), name.rpartition(".")[0]]
    return found


def declared(extra: str = "") -> set[str]:
    """Return the names under which the packages of an extra are imported."""
    optional = METADATA["optional-dependencies"]
    names: set[str] = set()
    for line in optional[extra] if extra else METADATA["dependencies"]:
        requirement = Requirement(line)
        if requirement.name == METADATA["name"]:
            names |= {name for inner in requirement.extras for name in declared(inner)}
        else:
            package = canonicalize_name(requirement.name)
            names.add(IMPORTED_AS.get(package, package))
    return names


@pytest.mark.parametrize("process", EXTRAS)
def test_a_process_imports_what_its_extra_installs(process: str) -> None:
    """A package that only another extra brings would be missing in an image of this process."""
    available = declared().union(*(declared(extra) for extra in EXTRAS[process]))
    needed = {name for at in reached(process) for name in imported_packages(MODULES[at])}
    assert needed - available == set()


@pytest.mark.parametrize("extra", ["", "sim", "panel", "recorder", "cli"])
def test_every_declared_package_is_imported(extra: str) -> None:
    """A dependency that nothing imports is only a weight."""
    needed = {name for at in MODULES.values() for name in imported_packages(at)}
    assert declared(extra) - needed == set()


def test_every_process_is_listed() -> None:
    """A new process says what it needs."""
    mains = {name.removesuffix(".__main__") for name in MODULES if "__main__" in name}
    assert mains == set(EXTRAS)
