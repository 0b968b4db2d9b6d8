#!/usr/bin/env bash
# A separate Docker engine in its own network namespace: this machine's network, and an
# engine that may be running already, are not affected; it has no external access.
# usage (root): tests/compose/engine.sh start FOLDER | stop FOLDER        FOLDER/env then says where it is
set -euo pipefail
verb=$1 folder=$2
namespace=forcemesh-$(basename "$folder")

start() {
  mkdir -p "$folder/config"
  ip netns add "$namespace"
  ip -n "$namespace" link set lo up
  # nsenter, not `ip netns exec`, which would hide the control groups.
  setsid nsenter --net="/run/netns/$namespace" dockerd --data-root "$folder/root" \
    --exec-root "$folder/exec" -H "unix://$folder/docker.sock" -p "$folder/docker.pid" \
    >"$folder/dockerd.log" 2>&1 </dev/null &
  echo $! >"$folder/started.pid"
  for _ in $(seq 1 120); do
    if docker -H "unix://$folder/docker.sock" version >/dev/null 2>&1; then
      printf 'DOCKER_HOST=unix://%s/docker.sock\nDOCKER_CONFIG=%s/config\nNAMESPACE=%s\n' \
        "$folder" "$folder" "$namespace" >"$folder/env"
      return
    fi
    sleep 0.25
  done
  tail -20 "$folder/dockerd.log" >&2
  stop
  exit 1
}

stop() {
  for file in docker.pid started.pid; do
    pid=$(cat "$folder/$file" 2>/dev/null || true)
    [ -z "$pid" ] || ! kill "$pid" 2>/dev/null || while kill -0 "$pid" 2>/dev/null; do sleep 0.1; done
  done
  umount "$folder/exec/netns/default" 2>/dev/null || true
  ip netns del "$namespace" 2>/dev/null || true
  rm -rf "$folder"
}

"$verb"
