"""Whether this machine has bubblewrap, as ``gem doctor`` and ``make`` ask."""

from __future__ import annotations

import shutil
import subprocess

from gem_core import RequirementStatus

_PROBE_S = 2.0


def bubblewrap(_: str, *, closely: bool = False) -> RequirementStatus:
    """Tell whether bubblewrap is installed; looked at closely, whether a sandbox starts."""
    if shutil.which("bwrap") is None:
        advice = "it needs bubblewrap: install the package 'bubblewrap' of your system"
        return RequirementStatus("unmet", "the command 'bwrap' is not on the PATH", advice)
    if not closely:
        return RequirementStatus("met", "is on the PATH")
    command = ["bwrap", "--unshare-all", "--ro-bind", "/", "/", "true"]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_PROBE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return RequirementStatus("unmet", f"it does not start ({type(error).__name__})", "reinstall bubblewrap")
    if done.returncode:
        reason = " ".join(done.stderr.decode(errors="replace").split())[:120]
        return RequirementStatus("unmet", f"it fails: {reason}", "allow unprivileged user namespaces on this system")
    return RequirementStatus("met", "a sandbox starts")
