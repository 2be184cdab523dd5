"""Checks of the contracts of environments, tools, wrappers, agents, commands, backends and plugins.

::

    from gem_core.testing import check_env

    def test_my_env_keeps_the_contract():
        check_env("mine:MyEnv-v0")

``check_tool``, ``check_wrapper``, ``check_agent``, ``check_command``, ``check_backend`` and ``check_plugin`` do the
same for the things in their names, and
``pytest --gem-envs 'mine:*'`` runs ``check_env`` on each environment that matches.

Neither pytest nor hypothesis is needed. Every promise is one function: see ``promises.py``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
