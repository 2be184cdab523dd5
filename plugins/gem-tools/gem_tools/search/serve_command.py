"""``gem serve-search``: a retrieval server over a corpus."""

from __future__ import annotations

import asyncio
import os

import click

from gem_core.errors import GemError, MissingRequirementError


@click.command(
    "serve-search",
    epilog="""\b
Examples:
  gem serve-search articles
  gem serve-search wiki.jsonl --port 8000
\b
A corpus is a file of lines {"id": …, "title": …, "text": …}, a folder of text files, or the word
articles, for those that come with the plugin. It is indexed once; the index is kept.
\b
Ask it:
  curl http://127.0.0.1:8000/retrieve -d '{"queries": ["Rembrandt in Leiden"], "topk": 3, "return_scores": true}'
  curl http://127.0.0.1:8000/health
  gem.make(…, wrappers=[("search", {"url": "http://127.0.0.1:8000/retrieve"})])
\b
Ctrl-C ends it, after the requests that have begun; the exit code is 0.
""",
)
@click.argument("corpus", type=click.Path())
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on; 0.0.0.0 for all.")
@click.option("--port", type=click.IntRange(0, 65535), default=8000, show_default=True, help="0 takes a free one.")
@click.option("--cache-dir", type=click.Path(file_okay=False), help="Folder of the indices.")
def command(corpus: str, host: str, port: int, cache_dir: str | None) -> None:
    """Serve a CORPUS to many trainers, in the form of Search-R1's retrieval server."""
    try:
        from gem_tools.search.index import open_index
        from gem_tools.search.server import serve
    except ModuleNotFoundError as error:
        message = f"gem serve-search needs the package {error.name}: pip install 'gem-tools[search]'"
        raise MissingRequirementError(message) from error

    index = open_index(corpus, cache_dir)

    def started(address: str) -> None:
        click.echo(f"Serving {len(index)} passages at {address}/retrieve; Ctrl-C ends it")
        if host not in ("127.0.0.1", "localhost", "::1"):
            click.echo("gem: whoever reaches this address can read the corpus; there is no password", err=True)

    try:
        asyncio.run(serve(index, host, port, started))
    except OSError as error:
        # asyncio puts words of its own into strerror; faults of names have negative numbers.
        number = error.errno or 0
        reason = os.strerror(number) if number > 0 else error.strerror or error
        raise GemError(f"cannot listen on {host}:{port}: {reason}. Name another by --host and --port") from error
    click.echo("Stopped")
