"""Rules of the repository: its lock, its commands, its texts."""

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tools.tree import production_files

ROOT = Path(__file__).resolve().parents[3]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
METADATA = PROJECT["project"]
LOCK = "requirements.lock"
IMAGE_EXTRAS = {  # by kind of image
    "control": ("build", "recorder", "robotiq", "bota"),
    "sim": ("build", "sim"),
    "panel": ("build", "sim", "panel", "recorder", "cli", "robotiq", "bota"),
}
IMAGE_LOCKS = [f"requirements-{kind}.lock" for kind in IMAGE_EXTRAS]
MOST_TARGETS = 16

locks = pytest.mark.parametrize("lock", [LOCK, *IMAGE_LOCKS])


def entries(lock: str) -> list[str]:
    """Return the requirements of a lock with their hashes, one each, without comments."""
    text = (ROOT / lock).read_text(encoding="utf-8").replace("\\\n", " ")
    return [line for line in text.splitlines() if line and not line.lstrip().startswith("#")]


def pins(lock: str) -> list[Requirement]:
    """Return the requirements of a lock without their hashes."""
    return [Requirement(entry.split(" --hash")[0]) for entry in entries(lock)]


def declared(*extras: str) -> list[Requirement]:
    """Return the direct dependencies that pyproject.toml declares."""
    optional = METADATA["optional-dependencies"]
    lists = [METADATA["dependencies"], *(optional[extra] for extra in extras)]
    return [Requirement(line) for lines in lists for line in lines]


def run(
    *command: str | Path, cwd: Path = ROOT, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run a command as a user would, free of an outer make's settings."""
    outside = {k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS"))}
    return subprocess.run(
        command, cwd=cwd, env=outside | variables, capture_output=True, text=True, check=False
    )


# --- the lock -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lock", "extras"),
    [
        (LOCK, ("build", "sim", "panel", "recorder", "cli", "dev")),
        *zip(IMAGE_LOCKS, IMAGE_EXTRAS.values(), strict=True),
    ],
)
def test_lock_satisfies_every_declared_dependency(lock: str, extras: tuple[str, ...]) -> None:
    """A dependency that was declared but not locked would not be there after `make setup`."""
    for requirement in declared(*extras):
        if requirement.name == METADATA["name"]:  # an extra of ours, which is compared itself
            continue
        name = canonicalize_name(requirement.name)
        versions = [pin.specifier for pin in pins(lock) if canonicalize_name(pin.name) == name]
        assert versions, f"{lock} lacks {requirement.name}: run make lock"
        for version in versions:
            assert requirement.specifier.contains(str(version).removeprefix("=="))


@locks
def test_lock_pins_one_version_with_hashes(lock: str) -> None:
    """Every requirement is exact and carries hashes, so that nothing else can be installed."""
    assert entries(lock)
    for entry, pin in zip(entries(lock), pins(lock), strict=True):
        assert re.fullmatch(r"==[^,*]+", str(pin.specifier)), entry
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", entry), entry


@locks
def test_lock_names_no_place(lock: str) -> None:
    """A lock has names and versions, never a source: no address, no path, no index option."""
    text = (ROOT / lock).read_text(encoding="utf-8")
    assert not re.search(r"://|file:|(^|\s)(/|\.\.?/|--index|--extra-index|--find-links)", text)
    assert all(pin.url is None for pin in pins(lock))


@pytest.mark.parametrize("kind", IMAGE_EXTRAS)
def test_image_gets_the_versions_that_are_tested(kind: str) -> None:
    """Its lock is a part of the whole one, without developers' tools and other kinds' weight."""
    # Not the markers: what the tests need too may be needed in more places there.
    lock = f"requirements-{kind}.lock"
    run, whole = ({f"{pin.name}{pin.specifier}" for pin in pins(each)} for each in (lock, LOCK))
    assert run < whole
    names = {canonicalize_name(pin.name) for pin in pins(lock)}
    assert not names & {"pytest", "hypothesis", "mypy", "ruff", "pre-commit", "import-linter"}
    others = {"control": {"mujoco", "matplotlib", "viser"}, "sim": {"matplotlib", "viser"}}
    assert not names & others.get(kind, set())


# --- the commands ---------------------------------------------------------------------------------


def test_make_lists_its_targets() -> None:
    """`make` alone lists each, at most 16, and each can be made."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"^([a-z-]+):", makefile, re.MULTILINE)
    listed = re.findall(r"^([a-z-]+) +\S", run("make").stdout, re.MULTILINE)
    assert listed == targets
    assert len(targets) <= MOST_TARGETS
    assert run("make", "-n", *targets).returncode == 0


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """Return a folder with nothing in it but the set-up script, in its place."""
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools" / "setup.sh", tmp_path / "tools")
    return tmp_path


def fake_python(folder: Path, *, version: str, lacks: str) -> Path:
    """Write a python that states a version and fails on code that mentions `lacks`."""
    python = folder / "python3"
    python.write_text(
        f'#!/bin/sh\ncase "$2" in *print*) echo {version};; *{lacks}*) exit 1;; esac\n',
        encoding="utf-8",
    )
    python.chmod(0o755)
    return python


@pytest.mark.parametrize(
    ("version", "lacks", "message"),
    [
        ("3.10.12", "(3, 11)", "is Python 3.10.12, and 3.11 or newer is needed"),
        ("3.11.2", "ensurepip", "apt-get install -y python3-venv\n"),
        ("3.11.2", "libgomp", "apt-get install -y libgomp1\n"),
    ],
)
def test_setup_names_the_missing_part(bare: Path, version: str, lacks: str, message: str) -> None:
    """Each missing part of the system is named in one line, with the command that installs it."""
    python = fake_python(bare, version=version, lacks=f'"{lacks}"')
    result = run("tools/setup.sh", python, cwd=bare, PATH="/usr/bin:/bin")
    assert result.returncode == 1
    assert message in result.stderr
    assert result.stderr.startswith("forcemesh: ")
    assert result.stderr.count("\n") == 1
    assert not (bare / ".venv").exists()


def test_setup_without_any_python_reports_that(bare: Path) -> None:
    """No Python at all is the same kind of answer."""
    result = run("tools/setup.sh", "python-that-is-not-there", cwd=bare)
    assert result.returncode == 1
    assert result.stderr.startswith("forcemesh: there is no 'python-that-is-not-there'")
    assert "apt-get install -y python3 python3-venv" in result.stderr


def test_ci_runs_the_commands_that_a_person_runs() -> None:
    """CI has no checks of its own: it calls make and modules, and any failure ends it."""
    script = ROOT / ".ci" / "run"
    text = script.read_text(encoding="utf-8")
    assert os.access(script, os.X_OK)
    assert "set -euo pipefail" in text
    assert re.findall(r"^part (.*)$", text, re.MULTILINE) == [
        "make check",
        "make demo",
        "make test",
        ".venv/bin/python -m tests.chaos --short",
        ".venv/bin/python -m pytest -q -m browser tests/browser",
        'timeout --kill-after=60 600 make compose-test ARGS="--short --optional"',
    ]
    assert run("bash", "-n", script).returncode == 0


def test_pre_commit_downloads_nothing() -> None:
    """The hooks are the project's own tools from .venv, so that they work without a network."""
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    assert [repo["repo"] for repo in config["repos"]] == ["local"]
    for hook in config["repos"][0]["hooks"]:
        assert hook["language"] == "system"
        assert hook["entry"].startswith(".venv/bin/")


# --- texts ---------------------------------------------------------------------------------------


def test_no_tracked_file_names_a_machine_or_a_package_host() -> None:
    """The repository works anywhere: no path of one machine, no address of a package host."""
    listed = run("git", "ls-files", "-z")
    if listed.returncode:
        pytest.skip("not a git checkout: there is no list of the project's own files")
    word = re.compile(
        r"/wor[k]/(main|shared|steering)|/(hom[e]|User[s])/\w|/roo[t]/|/far[m]/"
        r"|py[p]i\.org|pythonhoste[d]\.org|crate[s]\.io|registry\.npm[j]s|prox[y]\.golang"
    )
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        if path.is_file():
            text = path.read_text(encoding="utf-8", errors="replace")
            assert word.findall(text) == [], name


def test_the_wall_clock_is_for_dates_that_people_read_and_for_certificates() -> None:
    """H09: a clock that is set moves no deadline; every loop uses a `Clock`."""
    wall = re.compile(
        r"\btime_ns\b|\btime\.time\b|\bdatetime\b|\blocaltime\b|\bgmtime\b|CLOCK_REALTIME"
    )
    dated = ("cli/", "identification/", "services/panel/", "services/recorder/", "common/security/",
             "common/config/evidence.py", "common/config/probe.py", "launch/run_file.py",
             "sim/controller/machine.py")  # fmt: skip
    paths = [path for path in production_files() if wall.search(path.read_text(encoding="utf-8"))]
    found = {str(path.relative_to(ROOT)) for path in paths}
    assert {name for name in found if not name.startswith(dated)} == set()
    assert len(found) > len(dated)
