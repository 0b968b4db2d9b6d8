"""The import contracts of pyproject.toml: each one finds the import that it forbids."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONTRACTS: list[dict[str, Any]] = PROJECT["tool"]["importlinter"]["contracts"]
LIBRARIES = {"forcemesh/zenoh_session.py": "zenoh", "forcemesh/codec.py": "msgpack"}


@pytest.fixture(scope="module")
def skeleton(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a tree of empty modules under the project's own import contracts."""
    root = tmp_path_factory.mktemp("skeleton")
    shutil.copy(ROOT / "pyproject.toml", root)
    named = [module for contract in CONTRACTS for module in contract.get("source_modules", [])]
    fixed = [module for module in named if "*" not in module]
    others = [
        "forcemesh.zenoh_session",
        "forcemesh.clock",
        "forcemesh.codec",
        "services.one.law",
        "services.two.x",
    ]
    for module in [
        *fixed,
        *others,
        "sim.robot.plate",
        "sim.controller.x",
        "sim.as_language.x",
        "identification.x",
        "tuning.x",
        "launch.x",
        "cli.x",
    ]:
        path = root.joinpath(*module.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        for package in path.relative_to(root).parents[:-1]:
            (root / package / "__init__.py").touch()
    for module, library in LIBRARIES.items():
        (root / module).write_text(f"import {library}\n", encoding="utf-8")
    return root


def broken_contracts(root: Path) -> set[str]:
    """Return the names of the contracts that a tree breaks."""
    program = "from importlinter.cli import lint_imports_command as main; main()"
    found = subprocess.run(
        [sys.executable, "-c", program, "--no-cache"],
        cwd=root,
        env=os.environ | {"COLUMNS": "300"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Contracts:" in found.stdout, found.stdout + found.stderr
    return set(re.findall(r"^(.+) BROKEN$", found.stdout, re.MULTILINE))


def test_empty_modules_break_no_contract(skeleton: Path) -> None:
    """The tree that the next test plants imports into is itself clean."""
    assert broken_contracts(skeleton) == set()


@pytest.mark.parametrize(
    ("module", "imported", "contract"),
    [
        ("forcemesh/zenoh_session.py", "services.one.law", "Imports point one way"),
        ("services/two/x.py", "sim.robot.plate", "Imports point one way"),
        ("forcemesh/codec.py", "common.motion.frames", "Imports point one way"),
        ("identification/x.py", "services.one.law", "Imports point one way"),
        ("launch/x.py", "cli.x", "Imports point one way"),
        ("sim/robot/plate.py", "services.two.x", "Imports point one way"),
        ("sim/as_language/x.py", "sim.controller.x", "The language AS knows no robot"),
        ("services/two/x.py", "services.one.law", "Services meet on the bus only"),
        ("services/two/x.py", "zenoh", "Only one file knows Zenoh"),
        ("cli/x.py", "msgpack", "Only forcemesh.codec knows MessagePack"),
        ("services/one/law.py", "forcemesh.zenoh_session", "Pure modules"),
        ("common/motion/frames.py", "socket", "Pure modules"),
        ("controller/packet.py", "time", "Pure modules"),
    ],
)
def test_forbidden_import_is_found(
    skeleton: Path, module: str, imported: str, contract: str
) -> None:
    """Each contract has teeth: one planted import breaks it."""
    path = skeleton / module
    before = path.read_text(encoding="utf-8")
    path.write_text(f"{before}import {imported}\n", encoding="utf-8")
    try:
        assert any(name.startswith(contract) for name in broken_contracts(skeleton))
    finally:
        path.write_text(before, encoding="utf-8")


def test_contracts_have_no_exceptions() -> None:
    """An import that needs an exception needs another place instead."""
    assert not any(key.startswith("ignore") for contract in CONTRACTS for key in contract)
