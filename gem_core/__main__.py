"""``python -m gem_core``: the same as the command ``gem``, whose name another program may have."""

from __future__ import annotations

import signal
import sys
from typing import NoReturn


def main() -> NoReturn:
    """Run the command ``gem``; Ctrl-C while it is still being imported is answered as later on.

    SIGTERM, by which schedulers end a job, is answered as Ctrl-C is: what was played is kept.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        from gem_core import cli

        cli.main()
    except KeyboardInterrupt:
        sys.stderr.write("\ngem: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
