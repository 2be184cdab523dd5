"""Wrappers that come with the core: observation views, chat, limits, statistics.

A new one gets a file here and a record in ``gem_core/_plugin.py``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
