"""GEM: a gym for language-model agents.

An environment is a task plus optional tools; an agent's whole response is one action; every turn has its own reward::

    import gem_core as gem

    env = gem.make("game:GuessTheNumber-v0")
    observation, info = env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.sample_random_action())

Names are resolved on first use, so that ``import gem_core`` loads nothing heavy.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.1.0"
