"""For authors of docs/concepts, after a change of a picture: draw them, one small SVG for each page.

    python scripts/drawings.py            # writes docs/images/concepts/*.svg
    python scripts/drawings.py --check    # fails where a file is not what this script makes

Every picture has a ground of its own, which is dark where the reader's colours are.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from html import escape
from pathlib import Path

FOLDER = Path(__file__).parent.parent / "docs" / "images" / "concepts"
WIDTH = 720
SIZE, SMALL = 15, 13
WIDTH_OF_LETTER = 0.58
"""Of the height of the letters; wider than most fonts are, so that text stays inside its box in all of them."""
FILLS = {
    "agent": ("#dbe7fb", "#2f5da8"),
    "env": ("#d9f0df", "#2b7a45"),
    "tool": ("#fdeccb", "#9a6700"),
    "fault": ("#fadcd9", "#b3362b"),
    "plain": ("#ffffff", "#6b7785"),
}

DARK = {
    "#dbe7fb": "#1d3557",
    "#d9f0df": "#1d4029",
    "#fdeccb": "#4d3a10",
    "#fadcd9": "#57241f",
    "#ffffff": "#2a313b",
    "#f7f9fb": "#1b2027",
    "#3d4854": "#b4bec9",
    "#1d242c": "#e6e9ed",
}
"""What takes the place of each colour."""


class TooNarrowError(ValueError):
    """A text would not fit into its box."""


class Drawing:
    """A picture that is built from boxes, arrows and texts.

    Args:
        name: Of the file, and what the ids in it begin with.
        height: In units of which the picture is 720 wide.
        title: What it is, for those who hear it.
        description: What can be seen, for those who hear it.
    """

    def __init__(self, name: str, height: int, title: str, description: str) -> None:
        self.name = name
        self._height = height
        self._head = (title, description)
        self._parts: list[str] = []

    def box(self, x: int, y: int, width: int, height: int, text: str, kind: str = "plain", size: int = SIZE) -> None:
        """Add a box with centred lines; the first is bold where there are several."""
        fill, line = FILLS[kind]
        self._parts.append(
            f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="8" fill="{fill}" stroke="{line}"/>'
        )
        lines = text.split("\n")
        top = y + height / 2 - (len(lines) - 1) * size * 0.65 + size * 0.35
        for number, each in enumerate(lines):
            bold = number == 0 and len(lines) > 1
            if len(each) * size * WIDTH_OF_LETTER > width - 6:
                raise TooNarrowError(f"{self.name}: {each!r} does not fit into {width}")
            self.text(x + width // 2, round(top + number * size * 1.3), each, size=size, bold=bold, anchor="middle")

    def text(self, x: int, y: int, text: str, *, size: int = SMALL, bold: bool = False, anchor: str = "start") -> None:
        """Add a line of text."""
        weight = ' font-weight="600"' if bold else ""
        where = f'x="{x}" y="{y}" font-size="{size}" text-anchor="{anchor}"{weight}'
        self._parts.append(f"<text {where}>{escape(text, quote=False)}</text>")

    def arrow(self, *points: tuple[int, int], dashed: bool = False) -> None:
        """Add an arrow along some points."""
        path = " ".join(f"{x},{y}" for x, y in points)
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        self._parts.append(
            f'<polyline points="{path}" fill="none" stroke="#3d4854" stroke-width="1.6"{dash} '
            f'marker-end="url(#{self.name}-tip)"/>'
        )

    def line(self, x: int, top: int, bottom: int, kind: str) -> None:
        """Add an upright dashed line."""
        self._parts.append(
            f'<line x1="{x}" y1="{top}" x2="{x}" y2="{bottom}" stroke="{FILLS[kind][1]}" stroke-width="1.6" '
            'stroke-dasharray="5 4"/>'
        )

    def svg(self) -> str:
        """Return the file."""
        title, description = (escape(text) for text in self._head)
        name, body = self.name, "\n".join(self._parts)
        dark = " ".join(f'[fill="{light}"]{{fill:{dark}}}' for light, dark in DARK.items())
        return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {self._height}" role="img" \
aria-labelledby="{name}-title {name}-description" \
font-family="system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif" \
fill="#1d242c">
<title id="{name}-title">{title}</title>
<desc id="{name}-description">{description}</desc>
<style>@media (prefers-color-scheme: dark) {{ {dark} [stroke="#3d4854"]{{stroke:{DARK["#3d4854"]}}} }}</style>
<defs><marker id="{name}-tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" orient="auto">\
<path d="M0 0 10 5 0 10z" fill="#3d4854"/></marker></defs>
<rect width="{WIDTH}" height="{self._height}" rx="12" fill="#f7f9fb"/>
{body}
</svg>
"""


def loop() -> Drawing:
    """Draw a turn: observation, response, reward."""
    it = Drawing(
        "loop",
        300,
        "A turn of an episode",
        "The environment sends an observation to the agent. The agent sends a response back. Each step of the "
        "environment also gives a reward and says whether the episode terminated or was truncated.",
    )
    it.box(30, 90, 190, 110, "Agent\na model, a function,\na person", "agent")
    it.box(490, 90, 190, 110, "Environment\na task", "env")
    it.arrow((490, 120), (223, 120))
    it.text(355, 110, "observation, info", anchor="middle")
    it.arrow((220, 170), (487, 170))
    it.text(355, 190, "response: the whole text is the action", anchor="middle")
    it.arrow((585, 48), (585, 87))
    it.text(585, 38, "reset(seed=…) begins an episode", anchor="middle")
    it.arrow((585, 200), (585, 228))
    it.box(220, 231, 150, 46, "reward\nof this turn", size=SMALL)
    it.box(380, 231, 140, 46, "terminated\ntask is over", size=SMALL)
    it.box(530, 231, 160, 46, "truncated\ncut off from outside", size=SMALL)
    it.text(30, 250, "step returns, beside the")
    it.text(30, 268, "observation and info:")
    return it


def views() -> Drawing:
    """Draw what each view of the history shows after two turns."""
    it = Drawing(
        "views",
        330,
        "What each view shows after two turns",
        "The history has five parts: the task, response 1, output 1, response 2, output 2. The view latest shows "
        "output 2. The view concat shows the task and both outputs. The views concat_with_action and messages show all "
        "five; messages gives each part a role.",
    )
    parts = [
        ("task", "env"),
        ("response 1", "agent"),
        ("output 1", "env"),
        ("response 2", "agent"),
        ("output 2", "env"),
    ]
    shown = {
        "history": ("what happened", range(5)),
        "latest": ("the newest output", [4]),
        "concat": ("all outputs", [0, 2, 4]),
        "concat_with_action": ("and all responses", range(5)),
        "messages": ("as chat messages", range(5)),
    }
    for column, (name, (what, places)) in enumerate(shown.items()):
        x = 14 + column * 140
        it.text(x + 66, 34, name, bold=True, anchor="middle", size=12)
        it.text(x + 66, 54, what, anchor="middle", size=12)
        for place in places:
            text, kind = parts[place]
            role = {"env": "user", "agent": "assistant"}[kind]
            label = f"{role}\n{text}" if name == "messages" else text
            it.box(x, 72 + place * 48, 132, 40, label, kind, size=12 if name == "messages" else SMALL)
    return it


def seeds_and_plans() -> Drawing:
    """Draw how a plan and the seed of a run fix the episodes."""
    it = Drawing(
        "seeds-and-plans",
        330,
        "From a plan to episodes",
        "A plan lists what episodes start from. The seed of the run and the place in the plan give each episode its "
        "own seed. Two slots take the next item whenever one is free. The episodes are the same with any number "
        "of slots.",
    )
    it.text(95, 34, "plan", bold=True, anchor="middle")
    it.text(300, 34, "seed of the episode", bold=True, anchor="middle")
    it.text(560, 34, "slots", bold=True, anchor="middle")
    for number in range(5):
        y = 52 + number * 44
        it.box(30, y, 130, 34, f"item {number}: row {number}", size=SMALL)
        it.box(210, y, 180, 34, f"from run seed and {number}", "env", size=SMALL)
        it.arrow((160, y + 17), (207, y + 17))
    for number, (x, y) in enumerate([(440, 62), (440, 172), (570, 172), (570, 62)]):
        it.box(x, y, 116, 40, f"episode {number}", "agent", size=SMALL)
    it.text(440, 54, "slot 0")
    it.text(440, 164, "slot 1")
    it.arrow((390, 69), (437, 80))
    it.arrow((390, 113), (437, 190))
    it.text(440, 240, "Whoever is free takes the next item.")
    it.box(30, 280, 660, 34, "Same plan, same run seed: same episodes, with 1 slot or 64, in any backend.", size=SMALL)
    return it


def tools() -> Drawing:
    """Draw where a response goes: to a tool or to the task."""
    it = Drawing(
        "tools",
        300,
        "Where a response goes",
        "A response that calls a tool goes to the tool, and its output goes back to the agent. Any other response goes "
        "to the task, which gives an observation and a reward. A call that cannot be read is told to the agent.",
    )
    it.box(30, 115, 120, 70, "Agent", "agent")
    it.box(250, 105, 150, 90, "ToolEnv\nis it a call?", "plain")
    it.box(530, 30, 150, 60, "Tool\npython, search, …", "tool", size=SMALL)
    it.box(530, 120, 150, 60, "Task\nobservation, reward", "env", size=SMALL)
    it.box(530, 210, 150, 60, "Not readable\nerror message", "fault", size=SMALL)
    it.arrow((150, 150), (247, 150))
    it.text(199, 140, "response", anchor="middle")
    it.arrow((400, 130), (527, 62))
    it.text(440, 82, "a call", anchor="middle")
    it.arrow((400, 150), (527, 150))
    it.text(464, 142, "anything else", anchor="middle")
    it.arrow((400, 172), (527, 238))
    it.text(410, 222, "a broken call", anchor="middle")
    it.arrow((530, 46), (90, 46), (90, 112))
    it.text(290, 36, "output: the next observation; the task has not moved", anchor="middle")
    it.arrow((530, 256), (90, 256), (90, 188))
    it.text(280, 276, "what is wrong with it; counts as a use", anchor="middle")
    return it


def vector_environments() -> Drawing:
    """Draw four slots, of which one is slow."""
    it = Drawing(
        "vector-environments",
        310,
        "Four environments, one of them slow",
        "Four slots begin a step at the same time. Three are done early, one takes much longer. recv with min_envs=3 "
        "returns when three are ready. step returns when the slowest is ready.",
    )
    it.line(268, 46, 250, "agent")
    it.line(574, 46, 250, "fault")
    lengths = (150, 120, 480, 170)
    for slot, length in enumerate(lengths):
        y = 70 + slot * 44
        it.text(30, y + 22, f"slot {slot}")
        kind = "fault" if length > 300 else "env"
        it.box(90, y, length, 32, "waits for a slow server" if length > 300 else "a step", kind, size=SMALL)
    for slot in (0, 1, 3):
        it.box(276, 70 + slot * 44, 120, 32, "the next step", "agent", size=SMALL)
    it.text(268, 36, "recv(min_envs=3) returns", anchor="middle", bold=True)
    it.text(574, 36, "step(actions) returns", anchor="middle", bold=True)
    it.arrow((90, 262), (660, 262))
    it.text(664, 267, "time")
    it.text(90, 290, "With send and recv, three go on at once. With step, all wait for slot 2.")
    return it


def faults() -> Drawing:
    """Draw the three ways in which an episode goes wrong, and what each counts."""
    it = Drawing(
        "faults",
        330,
        "Three ways to end badly, and how each is counted",
        "If the agent fails, the episode terminates with its reward and counts. If a limit is reached, the episode is "
        "truncated and counts as not solved. If the machinery fails, the episode is truncated with info error, and is "
        "in no score.",
    )
    columns = [
        (
            "The agent fails",
            "a wrong answer,\ntext that cannot be read,\nits turns are used up",
            "terminated",
            "counts, with its reward",
            "agent",
        ),
        (
            "A limit is reached",
            "of time, tokens,\ncost or turns\nfrom outside",
            "truncated",
            "counts as not solved",
            "tool",
        ),
        (
            "The machinery fails",
            "a server is down,\nan environment raises,\nhangs or dies",
            'truncated, info["error"]',
            "is in no score",
            "fault",
        ),
    ]
    for column, (head, examples, flag, counted, kind) in enumerate(columns):
        x = 20 + column * 230
        it.box(x, 24, 220, 46, head, kind)
        for number, text in enumerate(examples.split("\n")):
            it.text(x + 110, 96 + number * 20, text, anchor="middle")
        it.arrow((x + 110, 148), (x + 110, 171))
        it.box(x, 174, 220, 44, flag, size=SMALL)
        it.arrow((x + 110, 218), (x + 110, 241))
        it.box(x, 244, 220, 44, counted, kind)
    it.text(360, 314, "Other environments and episodes go on in all three cases.", anchor="middle")
    return it


def plugins() -> Drawing:
    """Draw how a plugin is found, and when its code is loaded."""
    it = Drawing(
        "plugins",
        330,
        "How a plugin is found, and when it is loaded",
        "An entry point in pyproject.toml names the module _plugin.py, which declares records. The registry reads the "
        "records. gem list shows them and loads nothing else. gem.make imports the module that one record names.",
    )
    it.text(180, 34, "your distribution", bold=True, anchor="middle")
    it.text(560, 34, "gem_core", bold=True, anchor="middle")
    it.box(40, 52, 280, 56, 'pyproject.toml\n[project.entry-points."gem.plugins"]', "env", size=SMALL)
    it.box(40, 142, 280, 56, "gem_mine/_plugin.py\nrecords: EnvSpec, ToolSpec, …", "env", size=SMALL)
    it.box(40, 252, 280, 56, "gem_mine/game.py\nthe class, with heavy imports", "env", size=SMALL)
    it.box(460, 142, 200, 56, "registry\nids and names", "agent", size=SMALL)
    it.box(440, 52, 240, 46, "gem list, gem info", "plain", size=SMALL)
    it.box(440, 257, 240, 46, 'gem.make("mine:Game-v0")', "plain", size=SMALL)
    it.arrow((180, 108), (180, 139))
    it.text(192, 129, "names")
    it.arrow((320, 170), (457, 170))
    it.text(388, 160, "declares", anchor="middle")
    it.arrow((560, 142), (560, 101))
    it.text(572, 126, "loads no class")
    it.arrow((560, 257), (560, 201))
    it.text(572, 234, "asks for one id")
    it.arrow((440, 280), (323, 280))
    it.text(381, 270, "imports it now", anchor="middle")
    return it


DRAWINGS: tuple[Callable[[], Drawing], ...] = (
    loop,
    views,
    seeds_and_plans,
    tools,
    vector_environments,
    faults,
    plugins,
)


def files() -> dict[Path, str]:
    """Return the path and the content of each picture."""
    drawings = [draw() for draw in DRAWINGS]
    return {FOLDER / f"{drawing.name}.svg": drawing.svg() for drawing in drawings}


def main(arguments: list[str]) -> int:
    """Write the pictures, or say which are out of date."""
    stale = [path for path, text in files().items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    if "--check" in arguments:
        for path in stale:
            print(f"{path.name} is not what scripts/drawings.py makes: run it", file=sys.stderr)
        return int(bool(stale))
    FOLDER.mkdir(parents=True, exist_ok=True)
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
    print(f"{len(files())} pictures in {FOLDER}, {len(stale)} of them new")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
