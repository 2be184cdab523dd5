"""What ``gem doctor`` says of the Python tool: the level that is in force here, and why no stronger one is."""

from __future__ import annotations

import warnings


def status() -> dict[str, str]:
    """Start a sandbox as the tool would, and say which it is; takes some tenths of a second.

    Returns:
        ``sandbox``, ``filter`` of system calls, ``files`` where there are no namespaces, and for each stronger level
        that was passed over the reason.
    """
    from gem_core.errors import GemError
    from gem_tools.python.pool import Pool

    pool = Pool(num_workers=1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is returned says the same
            level = pool.start()
    except GemError as error:
        return {"sandbox": f"none: {error}"}
    finally:
        pool.close()
    if (chosen := pool.chosen) is None:
        return {"sandbox": level}
    note = chosen.launch.note
    facts = {"sandbox": f"{level} ({note})" if note else level}
    facts["filter"] = "system calls are filtered" if chosen.ready["filtered"] else "none"
    if level != "bubblewrap":
        walled, open_ = "code is kept to its folder (Landlock)", "this kernel has no Landlock: code opens what you may"
        facts["files"] = walled if chosen.ready["walled"] else open_
    return {**facts, **{f"not {name}": reason for name, reason in pool.passed_over.items()}}
