"""Container test: build the images, start the containers, inject faults, attack, take them down.

`make compose-test ARGS="--profile sim"` uses the running Docker engine; without one, and as root,
it starts its own in a separate network namespace, with a substitute for the base image made from
this machine's files. Exit code 0 if all requirements are met, 1 if one is not, 77 if no engine is
available: nothing was tested.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cli.pki import WRITTEN
from tests.chaos.common_net import ROOT
from tests.compose.profiles import check_profiles
from tests.compose.rig import (
    PROJECT,
    Compose,
    RequirementError,
    compose_command,
    environment_of,
    in_namespace,
    run,
)

HERE = Path(__file__).parent
NO_ENGINE = 77
PROFILES = ("sim", "emulated")
OWN_TOOLS = ("dockerd", "docker", "ip", "nsenter", "chroot", "dpkg", "python3.11")
KINDS = ("control", "sim", "panel")
BASE = "python:3.11-slim-bookworm"
SETTINGS = "/usr/local/bin:/usr/local/sbin:/usr/sbin:/usr/bin:/sbin:/bin"
WHEELS = ROOT / "out" / "wheels"
PIP_S, BASE_S, BUILD_S, CHECK_S = 200, 100, 400, 1500


class NoEngineError(Exception):
    """No engine is running, and none can be started."""


def main() -> int:
    """Run the requested profiles; return the exit code."""
    parser = argparse.ArgumentParser(prog="make compose-test ARGS=...", description=__doc__)
    parser.add_argument("--profile", action="append", choices=PROFILES, help="again for more")
    parser.add_argument(
        "--optional", action="store_true", help="exit code 0 if no engine is available"
    )
    parser.add_argument(
        "--short", action="store_true", help="the profile sim alone, one fault of each kind"
    )
    given = parser.parse_args()
    # Take everything down also on termination.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: sys.exit(1))
    os.environ.pop("CELL", None)  # set by the profile
    with tempfile.TemporaryDirectory(prefix="fm-") as scratch:
        if missing := what_is_missing():
            return not_tested(missing, optional=given.optional)
        try:
            with engine(Path(scratch) / "engine") as namespace:
                build()
                make_certificates(Path(scratch))
                if given.short:
                    return check("sim", namespace, "--short")
                codes = [check(profile, namespace) for profile in given.profile or PROFILES]
                return max(*codes, check_profiles(compose_command(), namespace))
        except NoEngineError as error:
            return not_tested(str(error), optional=given.optional)


def not_tested(why: str, *, optional: bool) -> int:
    """Print prominently that nothing was tested; return the corresponding exit code."""
    line = "!" * 80
    print(f"{line}\nNOT TESTED: containers. No engine can be had here: {why}\n{line}", flush=True)
    return 0 if optional else NO_ENGINE


def what_is_missing() -> str:
    """Return why containers cannot be tested here, empty if they can."""
    if not compose_command():
        return "neither `docker compose` nor `docker-compose` is installed"
    if engine_runs():
        return ""
    if os.geteuid() != 0:
        return "none is running, and only root can start one"
    lacking = [tool for tool in OWN_TOOLS if shutil.which(tool) is None]
    return f"none is running, and to start one {', '.join(lacking)} is needed" if lacking else ""


def engine_runs() -> bool:
    """Return whether an engine responds."""
    try:
        run("docker", "info")
    except (RequirementError, OSError):
        return False
    return True


@contextmanager
def engine(folder: Path) -> Iterator[str]:
    """Provide an engine; yield the namespace of its published ports, empty for this one."""
    if engine_runs():
        yield ""
        return
    script = str(HERE / "engine.sh")
    base = folder.with_name("base.tar")
    try:
        subprocess.run([script, "start", str(folder)], check=True)
    except subprocess.CalledProcessError as error:
        raise NoEngineError("the one that was started does not respond") from error
    try:
        os.environ.update(environment_of(folder / "env"))
        fetch_wheels()
        make_base = [str(HERE / "base-image.sh"), str(WHEELS), str(base)]
        subprocess.run(make_base, check=True, timeout=BASE_S)
        settings = f"ENV PIP_NO_INDEX=1 PIP_FIND_LINKS=/opt/wheels PATH={SETTINGS}"
        run("docker", "import", "-c", settings, str(base), BASE)
        base.unlink()
        yield os.environ["NAMESPACE"]
    finally:
        subprocess.run([script, "stop", str(folder)], check=True)


def fetch_wheels() -> None:
    """Download the locked packages for the base image: the engine reaches no package index."""
    command = [sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check"]
    exactly = ["--require-hashes", "--only-binary", ":all:", "-d", str(WHEELS)]
    WHEELS.mkdir(parents=True, exist_ok=True)
    for lock in (f"requirements-{kind}.lock" for kind in KINDS):
        subprocess.run([*command, *exactly, "-r", lock], check=True, cwd=ROOT, timeout=PIP_S)


def build() -> None:
    """Build the images; print build time, and size with and without the base image."""
    # Without buildx only the old builder is available on every engine.
    builder = os.environ.get("DOCKER_BUILDKIT", "0")
    for kind in KINDS:
        began_s, image = time.monotonic(), f"forcemesh-{kind}:local"
        words = ["docker", "build", "-q", "-t", image, "--build-arg", f"KIND={kind}", *revision()]
        run(*words, ".", timeout_s=BUILD_S, DOCKER_BUILDKIT=builder)
        took_s, size_MB = time.monotonic() - began_s, size_of(image)
        own = f"{size_MB:.0f} MB, {size_MB - size_of(BASE):.0f} without the base"
        print(f"image {kind}: built in {took_s:.0f} s, {own}", flush=True)


def size_of(image: str) -> float:
    """Return the size of an image [MB]."""
    return int(run("docker", "image", "inspect", "-f", "{{.Size}}", image)) / 1e6


def revision() -> list[str]:
    """Return the build argument for the revision label of the image."""
    try:
        return ["--build-arg", f"REVISION={run('git', 'describe', '--always', '--dirty')}"]
    except (RequirementError, OSError):
        return []


def make_certificates(scratch: Path) -> None:
    """Make certificates as a user does, and put the settings for compose into the environment."""
    command = [sys.executable, "-m", "cli", "pki", "init", "--cell", "cells/demo.yaml"]
    where = ["--folder", str(scratch / "pki"), "--env", str(scratch / "env")]
    subprocess.run([*command, *where], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    os.environ.update(environment_of(scratch / "env"))
    for name in WRITTEN:  # leaves the user's own recordings untouched
        os.environ[f"FORCEMESH_{name.upper()}"] = str(scratch / name)


def check(profile: str, namespace: str, *options: str) -> int:
    """Start a profile, check it, take it down in any case; return the exit code."""
    compose = Compose(profile, compose_command())
    began_s = time.monotonic()
    try:
        compose("up", "-d", "--no-build")
        environment = {**os.environ, "FORCEMESH_ENDPOINT": "tls/127.0.0.1:7447"}
        words = in_namespace(
            namespace, sys.executable, "-m", "tests.compose.checks", profile, *options
        )
        code = subprocess.run(
            words, cwd=ROOT, env=environment, check=False, timeout=CHECK_S
        ).returncode
    finally:
        compose("down", "-v", "-t", "2")
    took_s = time.monotonic() - began_s
    print(f"{PROJECT}: {profile} took {took_s:.0f} s, the checks ended with {code}", flush=True)
    return int(code != 0)  # that of a signal is negative


if __name__ == "__main__":
    sys.exit(main())
