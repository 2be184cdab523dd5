"""A private PostgreSQL server, started from the system's programs, that ends with the process that started it."""

from __future__ import annotations

import contextlib
import os
import pwd
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from urllib.parse import quote

import psycopg

from gem_core.errors import MissingRequirementError
from gem_mcpmark.binaries import ADVICE, SERVER_VARIABLE, server_programs
from gem_mcpmark.errors import PostgresError

ADMIN = "postgres"
_START_S = 60.0
_ATTEMPTS = 3
"""A port that was free may be taken by another program before the server listens on it."""

# The shell lives as long as the server. Its standard input is a pipe from this process: when that ends, however it
# ends, the pipe closes, and the shell stops the server and removes its folder.
_KEEPER = """
folder=$1; shift
"$@" </dev/null >"$folder/log" 2>&1 &
server=$!
read line
kill -INT $server 2>/dev/null
wait $server
rm -rf -- "$folder"
"""
_SETTINGS = {
    "listen_addresses": "127.0.0.1",
    "unix_socket_directories": "",
    "max_connections": "500",
    "fsync": "off",
    "full_page_writes": "off",
    "synchronous_commit": "off",
    "wal_level": "minimal",
    "max_wal_senders": "0",
    "timezone": "UTC",
}


class PrivateServer:
    """A server on loopback, in a temporary folder, whose administrator has a password of its own.

    Raises:
        MissingRequirementError: PostgreSQL is not installed, or there is no user to run it as.
        PostgresError: It does not start; the message has the end of its log.
    """

    def __init__(self) -> None:
        programs = server_programs()
        if programs is None:
            raise MissingRequirementError(f"there is no PostgreSQL: {ADVICE}")
        self._password = secrets.token_hex(16)
        self._user = _user()
        self.folder = Path(tempfile.mkdtemp(prefix="gem-mcpmark-"))
        self._keeper: subprocess.Popen[bytes] | None = None
        try:
            self._initialize(programs)
            for attempt in range(1, _ATTEMPTS + 1):
                if self._start(programs, last=attempt == _ATTEMPTS):
                    break
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """Stop the server and remove its folder."""
        if self._keeper is not None and self._keeper.stdin is not None:
            self._keeper.stdin.close()
            self._keeper.wait()
            self._keeper = None
        shutil.rmtree(self.folder, ignore_errors=True)

    def _initialize(self, programs: Path) -> None:
        secret = self.folder / "password"
        secret.touch(mode=0o600)
        secret.write_text(self._password)
        if self._user is not None:
            for path in (self.folder, secret):
                shutil.chown(path, self._user.pw_uid, self._user.pw_gid)
        locale = "C.UTF-8" if sys.platform == "linux" else "C"
        command = [f"{programs}/initdb", "-D", f"{self.folder}/data", "-U", ADMIN, "-A", "scram-sha-256"]
        command += ["--pwfile", str(secret), "--no-sync", "-E", "UTF8", f"--locale={locale}"]
        done: subprocess.CompletedProcess[bytes] = subprocess.run(
            command, capture_output=True, check=False, **self._process()
        )
        if done.returncode:
            said = " ".join(done.stderr.decode(errors="replace").split())[-500:]
            raise PostgresError(f"initdb failed in {self.folder}: {said}. TMPDIR chooses another place")

    def _start(self, programs: Path, *, last: bool) -> bool:
        """Start the server on a free port; False where it ended at once and may be tried again."""
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        command = [f"{programs}/postgres", "-D", f"{self.folder}/data", "-p", str(port)]
        for name, value in _SETTINGS.items():
            command += ["-c", f"{name}={value}"]
        keeper: subprocess.Popen[bytes] = subprocess.Popen(
            ["/bin/sh", "-c", _KEEPER, "sh", str(self.folder), *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            **self._process(),
        )
        self._keeper = keeper
        self.uri = f"postgresql://{ADMIN}:{quote(self._password)}@127.0.0.1:{port}/postgres"
        deadline = time.monotonic() + _START_S
        while time.monotonic() < deadline:
            with contextlib.suppress(psycopg.OperationalError):
                psycopg.connect(self.uri, connect_timeout=5).close()
                return True
            if not (self.folder / "data" / "postmaster.pid").exists() and "FATAL" in self._log():
                break
            time.sleep(0.05)
        log = self._log()
        if not last and "could not bind" in log:
            # Its folder is needed once more: end the shell before it removes that.
            keeper.kill()
            keeper.wait()
            return False
        raise PostgresError(f"the private PostgreSQL server did not start: {' '.join(log.split())[-500:]}")

    def _log(self) -> str:
        with contextlib.suppress(OSError):
            return (self.folder / "log").read_text(errors="replace")
        return ""

    def _process(self) -> dict[str, Any]:
        """Return how its programs are started: as another user where this is root, with nothing of our environment."""
        env = {"PATH": os.environ.get("PATH", os.defpath), "LANG": "C", "HOME": str(self.folder)}
        options: dict[str, Any] = {"env": env, "cwd": "/"}
        if self._user is not None:
            options |= {"user": self._user.pw_uid, "group": self._user.pw_gid, "extra_groups": []}
        return options


def _user() -> pwd.struct_passwd | None:
    """Return the user as whom PostgreSQL runs; None for the one that this process runs as already."""
    if os.getuid() != 0:
        return None
    try:
        return pwd.getpwnam("postgres")
    except KeyError:
        raise MissingRequirementError(
            "PostgreSQL does not run as root, and there is no user 'postgres' to run it as: run this as an ordinary "
            f"user, make that user, or name a server with {SERVER_VARIABLE}"
        ) from None
