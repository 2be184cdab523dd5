"""Terminal tasks in containers: a plugin of GEM. ``TerminalEnv`` runs any folder of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
