"""``gem terminal clean``: removes what processes that are dead have left behind."""

from __future__ import annotations

import click

from gem_terminal.backends.choosing import shared_backend
from gem_terminal.errors import EngineError


@click.command(
    "clean",
    epilog="""\b
Examples:
  gem terminal clean
  gem terminal clean --images     also the images that were built, which the next run builds again
""",
)
@click.option("--images", is_flag=True, help="Also remove every image that was built.")
@click.option("--backend", type=click.Choice(["all", "docker", "local"]), default="all", show_default=True)
def command(images: bool, backend: str) -> None:
    """Remove containers, networks, volumes and folders that dead processes of GEM left, and say which.

    What a living process uses is kept, and so is what other programs made.
    """
    names = ("docker", "local") if backend == "all" else (backend,)
    removed: list[str] = []
    missing: list[EngineError] = []
    for name in names:
        try:
            removed += shared_backend(name).clean(images=images)
        except EngineError as error:
            missing.append(error)
    for line in removed:
        click.echo(line)
    if len(missing) == len(names):
        raise missing[0]
    click.echo(f"{len(removed)} removed" if removed else "There was nothing to remove.")
