#!/bin/sh
# Health check of a container: the heartbeat of its process (common/runtime/heartbeat.py) is fresh and names
# no fault; otherwise it prints the reason. Starting even a shell costs the container engine 50 ms.
# So `watch`, which compose uses, returns at once the first time and after a failure; otherwise it
# keeps checking for a minute, and ends at once on a failure.
#   sh common/runtime/alive.sh [watch]
limit_s=5
watched_s=60
pause_s=10
was_well=${FORCEMESH_HEARTBEAT:?}.well

judge() {
  read -r up_s _ </proc/uptime
  if ! read -r beat_s fault 2>/dev/null <"$FORCEMESH_HEARTBEAT"; then
    echo "no heartbeat yet"
    return 1
  fi
  age_s=$((${up_s%.*} - beat_s))
  if [ "$age_s" -gt "$limit_s" ]; then
    echo "no heartbeat for $age_s s: the process hangs"
    return 1
  fi
  [ -z "$fault" ] && return
  echo "$fault"
  return 1
}

ill() {
  rm -f "$was_well"
  exit 1
}

judge || ill
[ "$1" = watch ] || exit 0
[ -e "$was_well" ] || { : >"$was_well"; exit 0; } 2>/dev/null
until_s=$((${up_s%.*} + watched_s))
while [ "${up_s%.*}" -lt "$until_s" ]; do
  sleep "$pause_s"
  judge || ill
done
