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

from gem_eval.records.row import Row
from gem_eval.records.run import Run, open_run, read_info
from gem_eval.records.writer import RunWriter

__all__ = ["Row", "Run", "RunWriter", "open_run", "read_info"]
