"""Start an MCP server on the database of the present episode: ``python -m gem_mcpmark.serve FILE``.

The file says which program that is and where the database is; it is written anew at each reset, before the tool ``mcp``
starts the episode's server. ``-`` and JSON in place of a file start one that is only asked for its tools.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path


def main() -> None:
    """Become the server."""
    said = json.loads(sys.argv[2] if sys.argv[1] == "-" else Path(sys.argv[1]).read_text(encoding="utf-8"))
    os.environ.update(said["env"])
    os.execvp(said["command"], [said["command"], *said["args"]])


if __name__ == "__main__":
    main()
