"""What the files in ``examples/trainers`` share: an agent over token engines, and environments as chats."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
