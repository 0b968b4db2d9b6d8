#!/usr/bin/env bash
# Every test in three runs: whole cells in real processes first, each alone on the machine; then what
# else lives in real time, mostly waiting, and what does not, both on all cores. All runs happen,
# whatever the others find. What is marked long is left to `make test-long`, which calls this with
# LONG=1.
set -uo pipefail
python=${PYTHON:-.venv/bin/python}
readonly REAL="realtime or processes" NONE_SELECTED=5
length="not long"
[ -z "${LONG:-}" ] || length="long and not browser" # `make test-browser` runs those
unset PYTHONDONTWRITEBYTECODE # hundreds of processes: none compiles what another one has compiled
failed=0

run() {
  "$python" -m pytest "$@"
  local code=$?
  [ $code = 0 ] || [ $code = $NONE_SELECTED ] || failed=$code
  [ $code = $NONE_SELECTED ] || ran=1
}

ran=0
run -m "alone and $length" "$@"
run -m "($REAL) and not alone and $length" -n auto "$@"
run -m "not ($REAL) and $length" -n auto "$@"
if [ $ran = 0 ]; then
  echo "no test fits: $*" >&2
  exit $NONE_SELECTED
fi
exit $failed
