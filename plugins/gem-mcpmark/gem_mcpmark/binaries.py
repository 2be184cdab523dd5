"""Where PostgreSQL's programs are, and which server is named."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

from gem_core.docs import page_url
from gem_core.errors import MissingRequirementError

SERVER_VARIABLE = "GEM_MCPMARK_POSTGRES"
"""Environment variable with the address of a server to use, as ``postgresql://postgres:password@localhost:5432``."""

ADVICE = (
    "it needs PostgreSQL 13 or newer: install your system's package 'postgresql' (apt-get install postgresql), or name "
    f"a server of yours with {SERVER_VARIABLE}=postgresql://postgres:password@localhost:5432. "
    f"See {page_url('mcpmark/#the-server')}"
)
_PLACES = ("/usr/lib/postgresql/*/bin", "/usr/pgsql-*/bin", "/opt/homebrew/opt/postgresql@*/bin")


def named_server() -> str | None:
    """Return the address of the server that the user named; None for a private one."""
    return os.environ.get(SERVER_VARIABLE) or None


def server_programs() -> Path | None:
    """Return the folder with ``initdb`` and ``postgres``: the newest that the system has, or that of the PATH."""
    found = [each for place in _PLACES for each in Path("/").glob(place[1:]) if (each / "initdb").exists()]
    if found:
        return max(found, key=lambda folder: [int(number) for number in re.findall(r"\d+", str(folder))])
    on_path = shutil.which("initdb")
    return Path(on_path).resolve().parent if on_path else None


def client_program(name: str) -> str:
    """Return the path of ``psql``, ``pg_dump`` or ``pg_restore``.

    Raises:
        MissingRequirementError: It is not installed.
    """
    folder = server_programs()
    beside = shutil.which(name, path=str(folder)) if folder else None
    found = beside or shutil.which(name)
    if found is None:
        raise MissingRequirementError(
            f"{name} is not installed, which restores databases: install your system's package 'postgresql-client'"
        )
    return found
