"""For maintainers of gem-math, after an upgrade of reasoning-gym: print ``gem_math/data/reasoning_tasks.json`` anew."""

from __future__ import annotations

import json
import sys


def main() -> None:
    """Print the tasks with their categories."""
    import reasoning_gym  # noqa: F401  # fills the table
    from reasoning_gym.factory import DATASETS

    tasks = {name: each.__module__.split(".")[1] for name, (each, _) in sorted(DATASETS.items()) if name != "composite"}
    sys.stdout.write(json.dumps(tasks, indent=2) + "\n")


if __name__ == "__main__":
    main()
