"""For maintainers of gem-math, after an upgrade of reasoning-gym: print ``gem_math/reasoning/tasks.py`` anew."""

from __future__ import annotations

import sys
from importlib.metadata import version


def main() -> None:
    """Print the module."""
    import reasoning_gym  # fills the table
    from reasoning_gym.factory import DATASETS

    lines = [
        f'"""The tasks of reasoning-gym {version(reasoning_gym.__name__)}; made by scripts/list_reasoning_tasks.py."""',
        "",
        "TASKS = {",
        *(
            f'    "{name}": "{dataset.__module__.split(".")[1]}",'
            for name, (dataset, _) in sorted(DATASETS.items())
            if name != "composite"
        ),
        "}",
        '"""The category of each task, by its name."""',
    ]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
