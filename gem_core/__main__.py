"""``python -m gem_core``: the same as the command ``gem``, whose name another program may have."""

from __future__ import annotations

from gem_core.cli import main

if __name__ == "__main__":
    main()
