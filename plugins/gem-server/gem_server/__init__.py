"""Any program that asks a model plays an environment: a plugin of GEM."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
