"""What ``gem doctor`` says of the tool ``mcp`` on this machine."""

from __future__ import annotations

import importlib.metadata
import shutil


def status() -> dict[str, str]:
    """Return the client's version, and which launchers of servers are there."""
    launchers = [name for name in ("npx", "uvx", "pipx", "docker") if shutil.which(name)]
    return {"client": f"mcp {importlib.metadata.version('mcp')}", "launchers": ", ".join(launchers) or "none"}
