"""Suites: which tasks are evaluated and how, as YAML files of ours and of users."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
