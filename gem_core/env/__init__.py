"""The environment interface: ``Env``, ``Wrapper``, the guard around a task, spaces, and seeding."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
