#!/usr/bin/env bash
# Install the MCP servers of scripts/mcp-servers.txt into .venv-mcp (or the folder named first). A second run does nothing.
# Needs python3 and, for two of the servers, npm; what cannot be installed is named, and its tests are skipped.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

folder=${1:-.venv-mcp}
list=scripts/mcp-servers.txt
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
failed=0

# The packages of one environment.
packages() {
    sed -n "s/^$1 //p" "$list"
}

# install NAME COMMAND…: run it with the packages of an environment, unless it has them already.
install() {
    local name=$1 stamp="$folder/.$1"
    shift
    if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$(packages "$name")" ]; then
        return
    fi
    echo "==> installing MCP servers: $(packages "$name" | tr '\n' ' ')"
    local log
    log=$(mktemp)
    # shellcheck disable=SC2046
    if "$@" $(packages "$name") >"$log" 2>&1; then
        packages "$name" >"$stamp"
    else
        tail -n 5 "$log" >&2
        echo "error: these servers could not be installed; their tests will be skipped" >&2
        failed=1
    fi
    rm -f "$log"
}

# A virtual environment of its own for each set of versions that go together.
with_pip() {
    local name=$1
    shift
    "${PYTHON:-python3}" -m venv --clear "$folder/$name" &&
        "$folder/$name/bin/python" -m pip install --quiet --disable-pip-version-check "$@"
}

with_npm() {
    mkdir -p "$folder/npm"
    # It tries again for minutes where the registry is refused.
    timeout 180 npm install --prefix "$folder/npm" --fetch-retries 1 --no-package-lock --no-audit --no-fund --no-save --loglevel=error "$@"
}

install python with_pip python
install sqlite with_pip sqlite
if command -v npm >/dev/null; then
    install npm with_npm
else
    echo "note: there is no npm, so the MCP servers of Node are left out" >&2
fi
exit $failed
