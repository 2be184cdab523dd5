"""Whether this machine has bubblewrap, as ``gem doctor`` and ``make`` ask."""

from __future__ import annotations

import shutil

from gem_core import RequirementStatus
from gem_core.errors import GemError


def bubblewrap(_: str, *, closely: bool = False) -> RequirementStatus:
    """Tell whether bubblewrap is installed; looked at closely, whether a sandbox of the Python tool starts."""
    if shutil.which("bwrap") is None:
        advice = "it needs bubblewrap: install the package 'bubblewrap' of your system"
        return RequirementStatus("unmet", "the command 'bwrap' is not on the PATH", advice)
    if not closely:
        return RequirementStatus("met", "is on the PATH")
    from gem_tools.python.pool import Pool

    pool = Pool("bubblewrap", num_workers=1)
    try:
        pool.start()
    except GemError as error:
        return RequirementStatus("unmet", f"no sandbox starts: {error}", "allow unprivileged user namespaces here")
    finally:
        pool.close()
    return RequirementStatus("met", "a sandbox starts")
