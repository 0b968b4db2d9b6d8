#!/usr/bin/env bash
# Make .venv from requirements.lock: with uv when it is on the path, else with plain venv and pip.
# usage: tools/setup.sh PYTHON
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1
apt="on Debian or Ubuntu: sudo apt-get install -y"

fail() { echo "forcemesh: $1" >&2; exit 1; }
same_python() { [ "$(.venv/bin/python -V 2>/dev/null)" = "Python $version" ]; }

version=$("$python" -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null) ||
  fail "there is no '$python', and Python 3.11 or newer is needed; $apt python3 python3-venv libgomp1"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  fail "'$python' is Python $version, and 3.11 or newer is needed; name one with make PYTHON=python3.12 setup"

uv=$(command -v uv || true)
missing=()
[ -n "$uv" ] || "$python" -c 'import venv, ensurepip' 2>/dev/null || missing+=("${python##*/}-venv")
[ "$(uname)" != Linux ] || "$python" -c 'import ctypes; ctypes.CDLL("libgomp.so.1")' 2>/dev/null ||
  missing+=(libgomp1)
[ ${#missing[@]} -eq 0 ] || fail "missing: ${missing[*]}; $apt ${missing[*]}"

echo "Setting up .venv with Python $version: about a minute the first time."
if [ -n "$uv" ]; then
  export UV_PYTHON_DOWNLOADS=never UV_SYSTEM_CERTS="${UV_SYSTEM_CERTS:-1}"
  same_python || "$uv" venv -q --clear --python "$python" .venv
  pip=("$uv" pip install -q --python .venv/bin/python)
else
  same_python && .venv/bin/python -m pip -V >/dev/null 2>&1 || "$python" -m venv --clear .venv
  pip=(.venv/bin/python -m pip install -q --disable-pip-version-check --no-input)
fi
# The lock is complete. With dependency resolution pip finds "coverage[toml]", which the lock has without
# its extra, selects a newer release for it, and then refuses that release.
"${pip[@]}" --no-deps --require-hashes --only-binary :all: -r requirements.lock
"${pip[@]}" --no-deps --no-build-isolation -e .

MUJOCO_GL=egl .venv/bin/python -c 'import mujoco; mujoco.GLContext(8, 8).free()' >/dev/null 2>&1 ||
  echo "No off-screen OpenGL here: pictures of the scene are left out, all else works." \
    "To have them, $apt libegl1 libopengl0 libgl1-mesa-dri"
