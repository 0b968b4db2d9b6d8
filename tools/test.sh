#!/usr/bin/env bash
# Every test. Whole cells in real processes first, one after the other; then what else lives in real
# time, mostly waiting, on all cores. Whatever needs only the processor runs beside both at idle
# priority, which takes nothing from them, and at its own when they are done. All runs happen,
# whatever the others find. What is marked long is left to `make nightly ARGS=long`, which calls this
# with LONG=1. With CI=1 and without a selection the run beside also takes the coverage of the modules
# that decide about motion (the list is in pyproject.toml): less than every branch is a failure. It is
# not taken otherwise because Python 3.11 needs two to three times as long for these tests with it.
set -uo pipefail
python=${PYTHON:-.venv/bin/python}
readonly REAL="realtime or processes" NONE_SELECTED=5
length="not long"
[ -z "${LONG:-}" ] || length="long and not (browser or ladder or axes or cargo)" # these are parts of their own
coverage=()
[ $# -gt 0 ] || [ -n "${LONG:-}" ] || [ -z "${CI:-}" ] || coverage=(--cov --cov-report=term)
export OPENBLAS_NUM_THREADS=1 # matrices here are small: a second thread costs more than it takes over
unset PYTHONDONTWRITEBYTECODE # hundreds of processes: none compiles what another one has compiled
failed=0 ran=0

judge() {
  [ "$1" = 0 ] || [ "$1" = $NONE_SELECTED ] || failed=$1
  [ "$1" = $NONE_SELECTED ] || ran=1
}

run() {
  "$python" -m pytest "$@"
  judge $?
}

idle=()
command -v chrt >/dev/null && idle=(chrt --idle 0)
said=$(mktemp)
set -m # gives it a process group, by which it is found
"${idle[@]}" "$python" -m pytest -m "not ($REAL) and $length" -n auto -o timeout=600 \
  "${coverage[@]}" "$@" >"$said" 2>&1 &
beside=$!
set +m
trap 'kill -- -$beside 2>/dev/null; rm -f "$said"' EXIT

run -m "alone and $length" --ignore=tests/unit --ignore=tests/contract "$@"
# Files without such a test are not even read: that takes longer than many a test.
pure=$(grep -rLE "realtime|processes" --include='test_*.py' tests | sed 's/^/--ignore=/')
# shellcheck disable=SC2086 # one word for each file
run -m "($REAL) and not alone and $length" -n auto $pure "$@"

# Only root may take idle priority back; for others it only takes longer where the machine is busy.
[ ${#idle[@]} = 0 ] ||
  for process in $(pgrep -g $beside); do chrt --all-tasks --other --pid 0 "$process" 2>/dev/null; done
tail --pid=$beside -n +1 -f "$said"
wait $beside
judge $?

if [ $ran = 0 ]; then
  echo "no test fits: $*" >&2
  exit $NONE_SELECTED
fi
exit $failed
