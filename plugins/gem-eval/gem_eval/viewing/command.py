"""``gem view``: runs in the browser."""

from __future__ import annotations

import socket
import webbrowser
from contextlib import suppress
from pathlib import Path

import click
import uvicorn

from gem_core.errors import ArgumentError
from gem_eval.viewing.app import make_app
from gem_eval.viewing.library import Library

_HOST = "127.0.0.1"


@click.command(
    "view",
    epilog="""\b
Examples:
  gem view                              all runs in runs/
  gem view runs/math runs/math-again    two runs beside each other
  gem view runs/mine.jsonl --open       a file of 'gem run', in the browser at once
\b
The page follows runs that go on. Its address names what is shown; '?' lists its keys. It is read-only, and
answers this machine alone. From another machine: ssh -L 8600:localhost:8600 HOST, and there
'gem view --port 8600'. Ctrl-C ends it.
\b
Exit code: 0 when it is ended with Ctrl-C, 2 if there is no run or the port is taken.
""",
)
@click.argument("paths", metavar="[RUN…]", nargs=-1, type=click.Path(path_type=Path))
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the page.  [default: a free one]")
@click.option("--open", "opens", is_flag=True, help="Open it in the browser.")
def command(paths: tuple[Path, ...], port: int, opens: bool) -> None:
    """Look at runs in the browser: scores, a table of episodes, and each of them turn by turn.

    RUN is the folder of a run of 'gem eval', a file of 'gem run', or a folder that holds such.  [default: runs]
    """
    library = Library(paths or (Path("runs"),))
    try:
        listener = socket.create_server((_HOST, port))
    except OSError as error:
        raise ArgumentError(
            f"port {port} cannot be used: {error.strerror}. Name another, or leave --port out"
        ) from error
    with listener:
        address = f"http://{_HOST}:{listener.getsockname()[1]}/"
        server = uvicorn.Server(
            uvicorn.Config(
                make_app(library, lambda: server.should_exit),
                log_level="warning",
                access_log=False,
                lifespan="off",
                ws="none",
            )
        )
        library.start()
        click.echo(f"{address}  (Ctrl-C ends it)")
        if opens:
            webbrowser.open(address)
        # The server ends what is open, and raises the interrupt again.
        with suppress(KeyboardInterrupt):
            server.run(sockets=[listener])
        library.stop()
