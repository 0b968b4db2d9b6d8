#!/usr/bin/env bash
# Make .venv from requirements.lock: with uv when it is on the path, else with plain venv and pip.
# usage: tools/setup.sh PYTHON
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1

fail() { echo "forcemesh: $1" >&2; exit 1; }

apt="on Debian or Ubuntu: sudo apt-get install -y python3 python3-venv"
apt_egl="to have them, on Debian or Ubuntu: sudo apt-get install -y libegl1"
version=$("$python" -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null) ||
  fail "no '$python' here, and Python 3.11 or newer is needed; $apt"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  fail "'$python' is Python $version, and 3.11 or newer is needed: name one with make PYTHON=python3.12 ..., or $apt"

same_python() { [ "$(.venv/bin/python -V 2>/dev/null)" = "Python $version" ]; }

echo "Setting up .venv with Python $version: about a minute the first time."
if uv=$(command -v uv); then
  export UV_PYTHON_DOWNLOADS=never
  same_python || "$uv" venv -q --clear --python "$python" .venv
  "$uv" pip sync -q --python .venv/bin/python --require-hashes --only-binary :all: requirements.lock
  "$uv" pip install -q --python .venv/bin/python --no-deps --no-build-isolation -e .
else
  "$python" -c 'import venv, ensurepip' 2>/dev/null ||
    fail "'$python' lacks the venv module; $apt${python:+ (or the ${python##*/}-venv that belongs to it)}"
  same_python && .venv/bin/python -m pip -V >/dev/null 2>&1 || "$python" -m venv --clear .venv
  pip=(.venv/bin/python -m pip install -q --disable-pip-version-check --no-input)
  "${pip[@]}" --require-hashes --only-binary :all: -r requirements.lock
  "${pip[@]}" --no-deps --no-build-isolation -e .
fi

.venv/bin/python -c 'import ctypes; ctypes.CDLL("libEGL.so.1")' 2>/dev/null ||
  echo "Without libEGL there are no rendered pictures, all else works; $apt_egl"
