r"""Python for agents: a pool of warm sandboxes, and the tool ``python`` on top of it.

The pool is there for other plugins too::

    from gem_tools.python import Limits, shared_pool

    outcome = shared_pool().run("print(int(input()) + 1)", stdin="41", limits=Limits(wall_s=2))
    outcome.status, outcome.stdout  # ("ok", "42\n")
"""

import lazy_loader

from gem_core.errors import refuse_windows

refuse_windows("the tool 'python'")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
