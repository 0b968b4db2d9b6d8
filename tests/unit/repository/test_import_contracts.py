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


PLANTED = [
    ("forcemesh/zenoh_session.py", "services.one.law", "Imports point one way"),
    ("services/two/x.py", "sim.robot.plate", "Imports point one way"),
    ("forcemesh/codec.py", "common.motion.frames", "Imports point one way"),
    ("identification/x.py", "services.one.law", "Imports point one way"),
    ("control/x.py", "tuning.x", "Imports point one way"),
    ("launch/x.py", "cli.x", "Imports point one way"),
    ("sim/robot/plate.py", "services.two.x", "Imports point one way"),
    ("sim/as_language/x.py", "sim.controller.x", "The language AS knows no robot"),
    ("services/two/x.py", "services.one.law", "Services meet on the bus only"),
    ("services/two/x.py", "zenoh", "Only one file knows Zenoh"),
    ("cli/x.py", "msgpack", "Only forcemesh.codec knows MessagePack"),
    ("control/x.py", "forcemesh.zenoh_session", "Pure modules"),
    ("common/motion/frames.py", "socket", "Pure modules"),
    ("controller/packet.py", "time", "Pure modules"),
]


@pytest.fixture
def skeleton(tmp_path: Path) -> Path:
    """Return a tree of empty modules under the project's own import contracts."""
    root = tmp_path
    shutil.copy(ROOT / "pyproject.toml", root)
    named = [module for contract in CONTRACTS for module in contract.get("source_modules", [])]
    fixed = [module for module in named if "*" not in module]
    others = [
        "forcemesh.zenoh_session",
        "forcemesh.clock",
        "forcemesh.codec",
        "control.x",
        "services.one.law",
        "services.two.x",
        "sim.robot.plate",
        "sim.controller.x",
        "sim.as_language.x",
        "identification.x",
        "tuning.x",
        "launch.x",
        "cli.x",
    ]
    for module in [*fixed, *others]:
        path = root.joinpath(*module.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        for package in path.relative_to(root).parents[:-1]:
            (root / package / "__init__.py").touch()
    for module, library in LIBRARIES.items():
        (root / module).write_text(f"import {library}\n", encoding="utf-8")
    return root


def broken_contracts(root: Path) -> dict[str, str]:
    """Return the contracts that a tree breaks, each with the imports that break it."""
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
    listed, _, details = found.stdout.partition("\nBroken contracts\n")
    names = re.findall(r"^(.+) BROKEN$", listed, re.MULTILINE)
    parts = re.split(r"^(.+)\n-+\n", details, flags=re.MULTILINE)
    return {name: parts[parts.index(name) + 1] for name in names}


def test_each_contract_finds_the_imports_that_it_forbids(skeleton: Path) -> None:
    """Empty modules break none; each planted import is in the report of its contract."""
    assert broken_contracts(skeleton) == {}
    for module, imported, _ in PLANTED:
        with (skeleton / module).open("a", encoding="utf-8") as stream:
            stream.write(f"import {imported}\n")
    broken = broken_contracts(skeleton)
    assert set(broken) == {contract["name"] for contract in CONTRACTS}
    for module, imported, contract in PLANTED:
        (report,) = (text for name, text in broken.items() if name.startswith(contract))
        line = f"{module.removesuffix('.py').replace('/', '.')} -> {imported} (l."
        assert line in report, line


def test_contracts_have_no_exceptions() -> None:
    """An import that needs an exception needs another place instead."""
    assert not any(key.startswith("ignore") for contract in CONTRACTS for key in contract)
