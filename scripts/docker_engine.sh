#!/usr/bin/env bash
# A container engine for tests, where there is none: started by hand, apart from any other, with all it has in one folder.
#
#   scripts/docker_engine.sh start [FOLDER]   install what is missing, start it, print its address (for DOCKER_HOST)
#   scripts/docker_engine.sh image [FOLDER]   the same, and see to it that it has the image gem-python:base
#   scripts/docker_engine.sh stop  [FOLDER]   end it and its containers; its images stay in the folder
#
# FOLDER is .venv-docker unless it is named. Needs Debian or Ubuntu, and root. Each command may be given again: what is
# there already is kept. The image is this system's release with nothing but python3, from the places that apt takes its
# packages from: nothing is pulled from a registry of images.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

image=gem-python:base

say() {
    echo "==> $*" >&2
}

fail() {
    echo "error: $*" >&2
    exit 1
}

# quietly COMMAND…: show what it wrote only when it fails.
quietly() {
    local log
    log=$(mktemp)
    if ! "$@" >"$log" 2>&1; then
        tail -n 20 "$log" >&2
        rm -f "$log"
        return 1
    fi
    rm -f "$log"
}

# need COMMAND PACKAGE: install a package of the system that is missing.
need() {
    command -v "$1" >/dev/null && return
    command -v apt-get >/dev/null || fail "'$1' is missing, and there is no apt-get to install it with"
    say "installing $2"
    quietly apt-get update -q
    DEBIAN_FRONTEND=noninteractive quietly apt-get install -q -y --no-install-recommends "$2" ||
        fail "the package '$2' could not be installed"
}

# Is the engine of this folder running? A stale file may name a process that is now another's, or one that has ended and
# that nobody has waited for, which has no program any more.
running() {
    [ -s "$pid_file" ] && [[ $(readlink "/proc/$(cat "$pid_file")/exe") = */dockerd* ]]
}

answers() {
    timeout 10 docker version >/dev/null 2>&1
}

start() {
    [ "$(id -u)" = 0 ] || fail "only root can start an engine; set DOCKER_HOST to one that runs, or leave its tests out"
    mkdir -p "$folder"
    if ! running; then
        # Installing the engine would otherwise start one of the system's own.
        need dockerd docker.io
        need docker docker.io
        say "starting a container engine in $folder"
        # A killed engine leaves these, and its containerd, which dies with it, is waited for where nobody reaps it.
        rm -f "$pid_file" "$socket" "$folder/run/containerd/containerd.pid"
        # No bridge and no rules of a firewall: it changes nothing of this machine's network, and containers have none.
        setsid dockerd --host "$DOCKER_HOST" --data-root "$folder/data" --exec-root "$folder/run" --pidfile "$pid_file" \
            --bridge none --iptables=false --ip6tables=false --ip-forward=false --ip-masq=false \
            </dev/null >"$folder/log" 2>&1 &
    fi
    local end=$((SECONDS + 60))
    until answers; do
        if [ $SECONDS -ge $end ] || { ! running && ! kill -0 "${!:-$$}" 2>/dev/null; }; then
            tail -n 20 "$folder/log" >&2
            fail "the engine does not answer; the end of $folder/log is above"
        fi
        sleep 0.1
    done
}

# Where apt has this release from, as the first line that names it says.
mirror() {
    apt-get indextargets --format '$(RELEASE) $(REPO_URI)' "Created-By: Packages" |
        awk -v release="$1" '$1 == release && !found { print $2; found = 1 }'
}

make_image() {
    docker image inspect "$image" >/dev/null 2>&1 && return
    need debootstrap debootstrap
    local release source
    release=$(. /etc/os-release && echo "$VERSION_CODENAME")
    source=$(mirror "$release")
    [ -n "$source" ] || fail "apt has no source for the release '$release'; run 'apt-get update'"
    say "making the image $image"
    root=$(mktemp -d)
    trap 'umount --recursive "$root" && rmdir "$root"' EXIT
    # In memory: packages are unpacked with a great many waits for the disk, half of the time that this takes.
    mount -t tmpfs -o size=1g,mode=755 tmpfs "$root"
    quietly debootstrap --variant=minbase --include=python3 "$release" "$root" "$source" ||
        fail "debootstrap could not make '$release'"
    tar -C "$root" --exclude './var/cache/apt/*' --exclude './var/lib/apt/lists/*' --exclude './usr/share/doc/*' -c . |
        docker import --change 'CMD ["/bin/bash"]' - "$image" >/dev/null
}

stop() {
    running || return 0
    local pid
    pid=$(cat "$pid_file")
    say "stopping the container engine in $folder"
    docker ps --all --quiet | xargs --no-run-if-empty docker rm --force >/dev/null 2>&1 || true
    kill "$pid"
    for _ in $(seq 200); do
        running || return 0
        sleep 0.1
    done
    fail "the engine, process $pid, does not end; see $folder/log"
}

case "${1:-}" in
start | image | stop) ;;
*) fail "say what to do: scripts/docker_engine.sh start|image|stop [FOLDER]" ;;
esac
folder=$(realpath --canonicalize-missing "${2:-.venv-docker}")
socket=$folder/docker.sock
pid_file=$folder/pid
[ ${#socket} -le 100 ] || fail "the path $socket is too long for a socket (100 characters); name a shorter folder"
export DOCKER_HOST=unix://$socket
unset DOCKER_CONTEXT DOCKER_TLS_VERIFY DOCKER_API_VERSION

case "$1" in
start) start ;;
image) start && make_image ;;
stop) stop ;;
esac
[ "$1" = stop ] || echo "$DOCKER_HOST"
