"""The plugin declares its backend without importing Ray."""

from __future__ import annotations

import subprocess
import sys

from gem_core.testing import check_plugin


def test_the_plugin_keeps_to_the_rules() -> None:
    check_plugin("gem-ray")


def test_declaring_imports_no_ray() -> None:
    code = "import sys, gem_ray._plugin as p; list(p.gem_register_vector_backends()); sys.exit('ray' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
