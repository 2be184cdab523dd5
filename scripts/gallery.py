"""For authors of environments, after a change of an id, a docstring or a reward: write docs/gallery and its images.

    python scripts/gallery.py                       write all from the registry, docstrings and measured.json
    python scripts/gallery.py --measure             play everything again first; takes minutes
    python scripts/gallery.py --measure 'game/*'    play some families again

A test compares what it writes with what is there.
"""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from gallery_docstrings import described
from gallery_drawing import GRIDS, Frame, card, wrapped
from gallery_measuring import measure_family, solver_of
from gallery_sections import arguments, ids, needs_of, rewards, scores, transcript

from gem_core.docs import gallery_page
from gem_core.registry import EnvSpec, registry
from gem_core.registry.requirements import unmet
from gem_core.types import TERMINAL_STATE

DOCS = Path(__file__).resolve().parent.parent / "docs"
MEASURED = DOCS / "gallery" / "measured.json"
DIFFERENCES = DOCS / "differences-from-gem-llm.md"
MADE = "<!-- Made by scripts/gallery.py from the registry and docstrings: change those, not this file. -->\n"
CATEGORIES = {
    "game": "Games",
    "ta": "TextArena",
    "pz": "PettingZoo",
    "math": "Mathematics",
    "rg": "ReasoningGym",
    "code": "Programs",
    "qa": "Questions",
    "logic": "Logic",
    "eval": "To evaluate on",
    "tau": "Customer service",
    "mcp": "Databases",
    "terminal": "Terminal tasks",
    "train": "To train on",
}
"""Titles of namespaces, in the order of the index; another one stands at the end under its own name."""
GUIDES = {
    "code": ("Data sets", "data-sets.md"),
    "eval": ("Evaluation", "evaluation.md"),
    "logic": ("Data sets", "data-sets.md"),
    "math": ("Data sets", "data-sets.md"),
    "mcp": ("Databases", "mcpmark.md"),
    "pz": ("Several agents", "several-agents.md"),
    "qa": ("Data sets", "data-sets.md"),
    "tau": ("Customer service", "tau.md"),
    "terminal": ("Terminal tasks", "terminal.md"),
    "train": ("Training", "training.md"),
}
SECTIONS = {
    "game": "`game:*`",
    "math": "`math:*`, and mathematics in `eval:*`",
    "rg": "`rg:*`",
    "code": "`code:*`",
    "qa": "`qa:*`, `logic:*`, and questions in `eval:*`",
    "logic": "`qa:*`, `logic:*`, and questions in `eval:*`",
    "terminal": "`terminal:*`",
}
"""Headings of docs/differences-from-gem-llm.md; those of ``eval:*`` go by the plugin."""
ONLY_HERE = "Only in one of the two"
Pages = dict[str, str]
"""Text by path below docs/."""


def families() -> dict[str, list[EnvSpec]]:
    """Return the environments of each page, as ``game/wordle``, in order of id."""
    found: dict[str, list[EnvSpec]] = {}
    for record in registry().envs():
        if isinstance(record.entry_point, str) and registry().provider(record.id) is not None:
            found.setdefault(page_of(record.id), []).append(record)
    return found


def page_of(env_id: str) -> str:
    """Return the page of an environment below the gallery, without slashes around it."""
    return gallery_page(env_id).removeprefix("gallery/").strip("/")


def render() -> Pages:
    """Return all that the gallery consists of, without playing."""
    measured: dict[str, Any] = json.loads(MEASURED.read_text(encoding="utf-8"))
    members = families()
    titles = titles_of(members)
    pages: Pages = {}
    for page, records in members.items():
        like = _shown_by(page, members, measured)
        pages[f"gallery/{page}.md"] = "\n".join(_page(page, records, measured.get(page), like, titles))
        for path, picture in _pictures(page, measured.get(page, {})):
            pages[path] = picture
    pages["gallery/index.md"] = "\n".join(_index(members, titles, measured))
    pages["gallery/.nav.yml"] = "\n".join(_navigation(members))
    return pages


def _shown_by(page: str, members: Mapping[str, list[EnvSpec]], measured: Mapping[str, Any]) -> str | None:
    """Return the page of an environment of the same class that was played, where this one was not."""
    if page in measured:
        return None
    own = members[page][0].entry_point
    return next((other for other in measured if other in members and members[other][0].entry_point == own), None)


def picture_path(page: str, which: str = "good") -> str:
    """Return the path of a picture below docs/."""
    return f"images/gallery/{page.replace('/', '-')}{'' if which == 'good' else f'-{which}'}.svg"


def _pictures(page: str, played: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for which in ("good", "bad"):
        if which in played:
            episode = played[which]
            name = re.split(r"-v\d", episode["id"].partition(":")[2])[0]
            grid = GRIDS.get(name) if page.startswith("game/") else None
            frames = _with_question([Frame(*frame) for frame in episode["frames"]])
            yield picture_path(page, which), card(episode["id"], episode["player"], frames, grid)


def _with_question(frames: list[Frame]) -> list[Frame]:
    """Keep the question of a task of one turn in sight, and say plainly that a task is over."""
    frames = [frame._replace(feedback=frame.feedback.replace(TERMINAL_STATE, "The task is over.")) for frame in frames]
    if len(frames) != 2 or (frames[0].drawing and not frames[0].drawing.startswith("data:")):
        return frames
    question, answered = frames
    if question.drawing:
        return [question, answered._replace(feedback=f"{question.feedback}\n\n{answered.feedback}")]
    text = "\n".join(wrapped(question.feedback, 88, 14))
    return [question._replace(drawing=text, feedback=""), answered._replace(drawing=text)]


# A page.


def _page(
    page: str, records: list[EnvSpec], played: Mapping[str, Any] | None, like: str | None, titles: Mapping[str, str]
) -> Iterator[str]:
    told = described(str(records[0].entry_point))
    yield f"# {titles[page]}\n"
    yield MADE  # below the title, which the site takes from the first line
    yield f"{_summary(page, records)}\n"
    above = "../" * (page.count("/") + 1)
    shown = page if played and "good" in played else like
    if like is not None:
        other = f"[{titles[like]}]({_link(page, like)})"
        yield f"It was not played for this page. This is an episode of {other}, which has the same class:\n"
    if shown is not None:
        yield f"![An episode, turn by turn]({above}{picture_path(shown)})\n"
    yield from _start(page, records)
    yield from ids(records)
    yield from arguments(told, above, records)
    yield from rewards(told)
    yield from scores(records, played, solver_of(page))
    for which, title in (("good", "A good episode"), ("bad", "A bad episode")):
        if played and which in played:
            yield f"## {title}\n"
            if which == "bad" or shown != page:
                yield f"![The episode, turn by turn]({above}{picture_path(page, which)})\n"
            yield from transcript(played[which])
    yield from _differences(page, records, above)
    if page.partition("/")[0] in GUIDES:
        title, guide = GUIDES[page.partition("/")[0]]
        yield f"More about these tasks: [{title}]({above}{guide}).\n"


def titles_of(members: Mapping[str, Sequence[EnvSpec]]) -> dict[str, str]:
    """Return the title of each page: the name of its environments, with the namespace where others have that name."""
    names = {page: _family(page, records) for page, records in members.items()}
    counts = Counter(names.values())
    return {page: name if counts[name] == 1 else f"{page.partition('/')[0]}:{name}" for page, name in names.items()}


def _family(page: str, records: Sequence[EnvSpec]) -> str:
    if "/" not in page:
        return CATEGORIES.get(page, page)
    return re.split(r"-v\d", records[0].name)[0]


def _link(page: str, other: str) -> str:
    """Return the relative link from a page to another one."""
    return f"{'../' * page.count('/')}{other}.md"


def _summary(page: str, records: Sequence[EnvSpec]) -> str:
    if "/" not in page:
        return f"{len(records)} environments under `{page}:`. They share one class, its arguments and this page."
    return records[0].summary.partition(";")[0].rstrip(".") + "."


def _start(page: str, records: Sequence[EnvSpec]) -> Iterator[str]:
    first = records[0]
    provider = registry().provider(first.id)
    distribution = provider.distribution if provider is not None else ""
    extras = [word.partition(":")[2] for word in first.requires if word.startswith("package:")]
    yield "```console"
    yield f"pip install {json.dumps(extras[0]) if extras else distribution}"
    yield f"gem info {first.id}"
    yield f"gem run {first.id} {_agents(page, first)} --episodes 10"
    yield "```\n"
    yield f"Class `{first.entry_point}`, of the distribution `{distribution}`."
    needed = needs_of(first)
    yield f"{needed}\n" if needed else ""


def _agents(page: str, record: EnvSpec) -> str:
    """Return who plays, as options of ``gem run``: the one of the plugin against a random player where there is one."""
    solver = solver_of(page)
    name = solver.name.strip("`") if solver is not None and solver.name.startswith("`") else "random"
    if "user" in record.seats:
        return f"--agent assistant={name} --agent user=tau-user:patient"
    if record.seats and name != "random":
        return f"--agent {name} --agent random"
    return f"--agent {name}"


def _differences(page: str, records: Sequence[EnvSpec], above: str) -> Iterator[str]:
    """Say what differs from the environment of gem-llm: its row of the table, or a link to its section."""
    yield "## Differences from the paper's version\n"
    namespace = page.partition("/")[0]
    text = DIFFERENCES.read_text(encoding="utf-8")
    ours = namespace not in (*SECTIONS, "eval", "mcp") or all(_is_ours(record.id, text) for record in records)
    heading = ONLY_HERE if ours or namespace == "mcp" else SECTIONS.get(namespace) or _section_of_eval(records[0])
    link = f"[Differences from gem-llm]({above}{DIFFERENCES.name}#{_slug(heading)})"
    if ours:
        yield f"gem-llm, the package of the paper, has no such environment: it is ours. See {link}.\n"
        return
    rows = [row for row in _table(text, heading) if _concerns(row[0], _family(page, records))]
    if rows:
        yield "| | gem-llm | here |\n| --- | --- | --- |"
        yield from (f"| {' | '.join(row)} |" for row in rows)
        yield ""
    yield f"{'All of them' if rows else 'What differs'}: {link}.\n"


def _is_ours(env_id: str, text: str) -> bool:
    return env_id.partition("-")[0].endswith("Sample") or f"`{env_id}`" in text.partition(f"## {ONLY_HERE}")[2]


def _section_of_eval(record: EnvSpec) -> str:
    provider = registry().provider(record.id)
    return SECTIONS[provider.distribution.removeprefix("gem-") if provider is not None else "math"]


def _slug(heading: str) -> str:
    return re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())


def _table(text: str, heading: str) -> Iterator[list[str]]:
    """Yield the rows of the table below a heading."""
    section = text.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    for line in section.split("\n"):
        cells = [cell.strip() for cell in line.strip("|").split(" |")]
        if line.startswith("|") and len(cells) == 3 and cells[0] not in ("game", "---"):
            yield cells


def _concerns(cell: str, name: str) -> bool:
    return cell in ("all", "random actions") or name in cell.split(", ")


# The index, and all files.


def _index(
    members: Mapping[str, list[EnvSpec]], titles: Mapping[str, str], measured: Mapping[str, Any]
) -> Iterator[str]:
    yield "# Gallery\n"
    yield MADE
    count = sum(map(len, members.values()))
    yield f"{count} environments in {len(members)} families. Each page has the ids, the arguments and the rewards. "
    yield "Where an environment needs nothing from elsewhere, it also has two recorded episodes, and the scores of a "
    yield "random player and of a good one.\n"
    for namespace in _namespaces(members):
        pages = [page for page in members if page.partition("/")[0] == namespace]
        yield f"## {CATEGORIES.get(namespace, namespace)}\n"
        yield from _grid([page for page in pages if "good" in measured.get(page, {})], members, titles)
        for page in pages:
            if "good" not in measured.get(page, {}):
                yield f"- [{titles[page]}]({page}.md): {_summary(page, members[page])}"
        yield ""


def _navigation(members: Mapping[str, list[EnvSpec]]) -> Iterator[str]:
    """Yield the lines of the site's navigation in the gallery: namespaces by their titles."""
    yield f"# {MADE[5:-5]}\nnav:\n  - index.md"
    for namespace in _namespaces(members):
        title = CATEGORIES.get(namespace, namespace)
        yield f"  - {title}: {namespace}{'.md' if namespace in members else ''}"
    yield ""


def _namespaces(members: Iterable[str]) -> list[str]:
    present = {page.partition("/")[0] for page in members}
    return [*(name for name in CATEGORIES if name in present), *sorted(present - set(CATEGORIES))]


def _grid(pages: Sequence[str], members: Mapping[str, list[EnvSpec]], titles: Mapping[str, str]) -> Iterator[str]:
    """Yield a table of pictures, two in a row."""
    if not pages:
        return
    yield "| | |\n| --- | --- |"
    for start in range(0, len(pages), 2):
        cells = []
        for page in pages[start : start + 2]:
            title = titles[page]
            picture = f"[![{title}](../{picture_path(page)})]({page}.md)"
            cells.append(f"{picture}<br>**[{title}]({page}.md)**: {_summary(page, members[page])}")
        yield f"| {' | '.join([*cells, ''][:2])} |"
    yield ""


def measure(patterns: Sequence[str]) -> None:
    """Play the families whose pages match, all without a pattern, and keep what came out."""
    measured: dict[str, Any] = json.loads(MEASURED.read_text(encoding="utf-8")) if MEASURED.exists() else {}
    for page, records in families().items():
        if patterns and not any(fnmatchcase(page, pattern) for pattern in patterns):
            continue
        runnable = [record for record in records if not unmet(record.requires)]
        if runnable:
            print(f"{page}: {len(runnable)} environments", flush=True)
            measured[page] = measure_family(page, runnable)
            keep(measured)


def keep(measured: Mapping[str, Any]) -> None:
    """Write what was measured of the families that there are."""
    known = families()
    kept = {page: measured[page] for page in sorted(measured) if page in known}
    MEASURED.parent.mkdir(parents=True, exist_ok=True)
    MEASURED.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def write(pages: Pages) -> None:
    """Write the files, and remove those that no longer belong there."""
    for path, text in pages.items():
        (DOCS / path).parent.mkdir(parents=True, exist_ok=True)
        (DOCS / path).write_text(text, encoding="utf-8")
    for folder, pattern in ((DOCS / "gallery", "*.md"), (DOCS / "images" / "gallery", "*.svg")):
        for old in folder.rglob(pattern):
            if old.relative_to(DOCS).as_posix() not in pages:
                old.unlink()


def main() -> None:
    """Measure if asked to, and write all."""
    parser = argparse.ArgumentParser(description="Write the gallery of environments.")
    parser.add_argument("--measure", nargs="*", metavar="PAGE", help="play these families first; all without a name")
    options = parser.parse_args()
    if options.measure is not None:
        measure(options.measure)
    pages = render()
    write(pages)
    size = sum(len(text.encode()) for text in pages.values())
    print(f"{len(pages)} files, {size / 1e6:.2f} MB, in {DOCS}")


if __name__ == "__main__":
    main()
