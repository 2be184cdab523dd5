"""The record of a run: a folder that is appended to while the run goes on, and what reads it.

::

    RUN/run.json             what was asked, with which versions, where, when, from which seed
    RUN/episodes.jsonl.zst   each episode as one line of JSON, in a zstd frame of its own
    RUN/index.jsonl          one line for each episode: what a table shows, and where the frame is
    RUN/metrics.json         the scores, written at the end
    RUN/images/              images of the episodes, named by their hash

A frame is written before its line of the index. After a kill at any byte, what follows the last whole frame is cut
off, and what the index lacks is read again from the frames; a damaged frame costs its own episode. Nothing is ever
changed: an episode that is run again is appended once more, and the later one counts.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
