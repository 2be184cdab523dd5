"""What a Dockerfile asks a sandbox to do: its instructions with variables put in, or the reason why it needs Docker."""

from __future__ import annotations

import platform
import posixpath
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from gem_terminal.backends.local.dockerfile import Heredoc, Instruction, expand, pairs, read, split
from gem_terminal.errors import TaskError

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Container

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"

_BASES = ("debian", "gem-python", "python", "python-3-13", "ubuntu", "ubuntu-24-04")
_HOMES = ("", "library", "docker.io", "docker.io/library", "ghcr.io/laude-institute/t-bench")
_OTHERS = ("alpine", "windowsservercore", "nanoserver")
_ROOT = ("root", "0", "root:root", "0:0", "0:root", "root:0")
_NOTHING = ("LABEL", "MAINTAINER", "EXPOSE", "STOPSIGNAL", "HEALTHCHECK")
_INSTALLS = re.compile(
    r"(?:^|[\s;&|(])(?:\S*/)?("
    r"(?:apt|apt-get|aptitude|apk|yum|dnf|zypper|pacman)\s+(?:-\S+\s+)*(?:update|install|add|upgrade|-S\w*)"
    r"|(?:python\S*\s+-m\s+)?(?:pip3?|pipx)\s+(?:-\S+\s+)*(?:install|download)"
    r"|uv\s+(?:pip|sync|add|tool|python)|(?:conda|mamba|poetry|gem|cargo|go|npm|pnpm|yarn)\s+(?:install|create|ci|add|get)"
    r"|(?:curl|wget)\s[^;&|]*https?://(?!localhost|127\.)|git\s+clone\s[^;&|]*(?:https?|git|ssh)(?:://|@))"
)
_MACHINES = {"x86_64": "amd64", "aarch64": "arm64"}


@dataclass(frozen=True)
class Run:
    """Run a program, with the environment that stands there."""

    words: tuple[str, ...]
    env: Mapping[str, str]
    workdir: str
    line: int


@dataclass(frozen=True)
class Copy:
    """Copy files of the build's folder, or contents that stand in the Dockerfile."""

    sources: tuple[str, ...]
    contents: Mapping[str, bytes]
    target: str
    mode: int | None
    unpack: bool
    line: int


@dataclass(frozen=True)
class Folder:
    """Make a folder."""

    path: str
    line: int


@dataclass(frozen=True)
class Recipe:
    """A Dockerfile that a sandbox can follow.

    Args:
        steps: What to do.
        env: Environment of the programs of a machine.
        workdir: Their working directory.
        entrypoint: Words before those of ``command``.
        command: Words of the machine's own program.
    """

    steps: tuple[Run | Copy | Folder, ...] = ()
    env: Mapping[str, str] = field(default_factory=dict)
    workdir: str = "/"
    entrypoint: tuple[str, ...] = ()
    command: tuple[str, ...] = ()


def of(container: Container, build_args: Mapping[str, str]) -> Recipe:
    """Return what a container's image asks for.

    Args:
        container: The container.
        build_args: Arguments of the build that come before the container's own.

    Raises:
        TaskError: It cannot be read, or needs an image of its own.
    """
    if container.image is not None:
        try:
            _check_base(container.image, 0)
        except TaskError:
            if container.context is None:
                raise
        else:
            return Recipe()
    if container.context is None:
        raise TaskError("the task names neither an image nor a Dockerfile")
    path = container.context / container.dockerfile
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise TaskError(f"{path} cannot be read: {error}") from error
    try:
        return of_text(text, {**container.build_args, **build_args})
    except TaskError as error:
        raise TaskError(f"{path}: {error}") from error


def of_text(text: str, build_args: Mapping[str, str]) -> Recipe:
    """Return what a Dockerfile asks for; see ``of``."""
    instructions, escape = read(text)
    return _Reader(dict(build_args), escape).follow(instructions)


class _Reader:
    """Follows instructions in their order.

    Args:
        build_args: Arguments of the build.
        escape: The escape character.
    """

    def __init__(self, build_args: dict[str, str], escape: str) -> None:
        self.build_args, self.escape = build_args, escape
        arch = _MACHINES.get(platform.machine(), platform.machine())
        self.known = {"TARGETARCH": arch, "TARGETOS": "linux", "TARGETPLATFORM": f"linux/{arch}"}
        self.globals: dict[str, str] = {}
        self.args: dict[str, str] = {}
        self.env: dict[str, str] = {}
        self.base = ""
        self.workdir = "/"
        self.shell: tuple[str, ...] = ("/bin/sh", "-c")
        self.entrypoint: tuple[str, ...] = ()
        self.command: tuple[str, ...] = ()
        self.steps: list[Run | Copy | Folder] = []

    def follow(self, instructions: list[Instruction]) -> Recipe:
        """Return what they come to."""
        for instruction in instructions:
            name = instruction.name.lower()
            if not self.base and name not in ("from", "arg"):
                raise TaskError(f"line {instruction.line}: {instruction.name} comes before FROM")
            method = getattr(self, f"do_{name}", None)
            if method is not None:
                method(instruction)
            elif instruction.name not in _NOTHING:
                self.refuse(instruction, f"{instruction.name} is not known")
        if not self.base:
            raise TaskError("there is no FROM")
        return Recipe(tuple(self.steps), self.env, self.workdir, self.entrypoint, self.command)

    def refuse(self, instruction: Instruction, why: str) -> NoReturn:
        """Raise the error of a task that needs more."""
        raise TaskError(f"line {instruction.line}: {why}; the task needs its own image: use the backend 'docker'")

    def fill(self, text: str) -> str:
        """Put variables in."""
        return expand(text, self.globals if not self.base else {**self.args, **self.env}, self.escape)

    def words(self, instruction: Instruction) -> list[str]:
        """Return the words of either form, variables put in."""
        if instruction.words is not None:
            return [self.fill(word) for word in instruction.words]
        return split(self.fill(instruction.value), self.escape)

    def do_arg(self, instruction: Instruction) -> None:
        """Declare arguments; before FROM they are for FROM, and defaults of those after it."""
        for word in split(self.fill(instruction.value), self.escape):
            name, equals, value = word.partition("=")
            if name in self.build_args:
                found: str | None = self.build_args[name]
            elif equals:
                found = value
            else:
                found = self.globals.get(name, self.known.get(name))
            if found is not None:
                (self.args if self.base else self.globals)[name] = found

    def do_from(self, instruction: Instruction) -> None:
        """Take one of the bases that a sandbox resembles."""
        if self.base:
            self.refuse(instruction, "it has several stages")
        words = split(self.fill(instruction.value), self.escape)
        if len(words) not in (1, 3) or (len(words) == 3 and words[1].lower() != "as"):
            raise TaskError(f"line {instruction.line}: FROM {instruction.value[:80]!r} is not FROM IMAGE [AS NAME]")
        _check_base(words[0], instruction.line)
        self.base = words[0]

    def do_env(self, instruction: Instruction) -> None:
        """Set environment variables."""
        self.env.update(pairs(self.fill(instruction.value), self.escape))

    def do_workdir(self, instruction: Instruction) -> None:
        """Change to a folder, and make it."""
        path = " ".join(split(self.fill(instruction.value), self.escape))
        if not path:
            raise TaskError(f"line {instruction.line}: WORKDIR names no folder")
        self.workdir = _path(self.workdir, path, instruction.line)
        self.steps.append(Folder(self.workdir, instruction.line))

    def do_volume(self, instruction: Instruction) -> None:
        """Make folders."""
        for path in self.words(instruction):
            self.steps.append(Folder(_path("/", path, instruction.line), instruction.line))

    def do_user(self, instruction: Instruction) -> None:
        """Allow root alone."""
        user = self.fill(instruction.value).strip()
        if user not in _ROOT:
            self.refuse(instruction, f"it runs as the user {user!r}, and a sandbox has root alone")

    def do_shell(self, instruction: Instruction) -> None:
        """Take another shell."""
        if not instruction.words:
            raise TaskError(f'line {instruction.line}: SHELL takes words as ["/bin/bash", "-c"]')
        self.shell = instruction.words

    def do_entrypoint(self, instruction: Instruction) -> None:
        """Set what a container runs; it forgets the command of its base."""
        self.entrypoint = self.program(instruction)

    def do_cmd(self, instruction: Instruction) -> None:
        """Set what a container runs, or the arguments of that."""
        self.command = self.program(instruction)

    def program(self, instruction: Instruction) -> tuple[str, ...]:
        """Return the words of a program; of other forms than JSON, those of a shell."""
        if instruction.words is not None:
            return instruction.words
        return (*self.shell, instruction.value) if instruction.value else ()

    def do_run(self, instruction: Instruction) -> None:
        """Run a command."""
        if instruction.flags:
            self.refuse(instruction, f"RUN --{next(iter(instruction.flags))} is not known")
        words = instruction.words
        script = instruction.value if words is None else " ".join(words)
        for document in instruction.heredocs:
            script += f"\n{document.text}{document.name}"
        installs = _INSTALLS.search(script)
        if installs is not None:
            self.refuse(instruction, f"{' '.join(installs[1].split())[:40]!r} needs a network, which a sandbox lacks")
        if words is None:
            words = (*self.shell, _only_script(instruction) or f"{script}\n")
        if not words:
            raise TaskError(f"line {instruction.line}: RUN has no command")
        self.steps.append(Run(tuple(words), {**self.args, **self.env}, self.workdir, instruction.line))

    def do_copy(self, instruction: Instruction) -> None:
        """Copy files."""
        self.copy(instruction, unpack=False)

    def do_add(self, instruction: Instruction) -> None:
        """Copy files, and unpack archives."""
        self.copy(instruction, unpack=True)

    def copy(self, instruction: Instruction, *, unpack: bool) -> None:
        """Copy files of the build's folder, or contents that stand in the Dockerfile."""
        for flag, value in instruction.flags.items():
            if flag not in ("chmod", "chown", "link") or (flag == "chown" and value not in _ROOT):
                self.refuse(instruction, f"{instruction.name} --{flag}={value} is not possible in a sandbox")
        words = self.words(instruction)
        if len(words) < 2:
            raise TaskError(f"line {instruction.line}: {instruction.name} takes at least one source, and a target")
        *sources, target = words
        contents: dict[str, bytes] = {}
        for document in instruction.heredocs:
            text = document.text if document.literal else self.fill(document.text)
            contents[document.name] = text.encode("utf-8", "surrogatepass")
        files = [source for source in sources if _document(source, instruction.heredocs) is None]
        for source in files:
            if unpack and ("://" in source or source.startswith("git@")):
                self.refuse(instruction, f"ADD {source[:80]} needs a network, which a sandbox lacks")
        whole = _path(self.workdir, target, instruction.line) + ("/" if target.endswith(("/", "/.")) else "")
        mode = _mode(instruction)
        copied = Copy(tuple(files), contents, whole, mode, unpack, instruction.line)
        self.steps.append(copied)


def _only_script(instruction: Instruction) -> str:
    """Return the text of a here-document that is all there is to a command."""
    if len(instruction.heredocs) == 1 and _document(instruction.value, instruction.heredocs) is not None:
        return instruction.heredocs[0].text
    return ""


def _document(word: str, documents: tuple[Heredoc, ...]) -> Heredoc | None:
    name = word.removeprefix("<<").removeprefix("-").strip("'\"") if word.startswith("<<") else None
    return next((document for document in documents if document.name == name), None)


def _mode(instruction: Instruction) -> int | None:
    value = instruction.flags.get("chmod")
    if value is None:
        return None
    if not re.fullmatch(r"[0-7]{3,4}", value):
        raise TaskError(f"line {instruction.line}: --chmod={value[:20]} is not an octal number, as 755")
    return int(value, 8)


def _path(workdir: str, path: str, line: int) -> str:
    whole = posixpath.normpath(posixpath.join(workdir, path))
    if "\0" in whole:
        raise TaskError(f"line {line}: {path[:60]!r} is no path")
    return "/" + whole.lstrip("/")


def _check_base(image: str, line: int) -> None:
    """Raise unless an image is a general one, of which a sandbox has about the same programs."""
    name = image.partition("@")[0]
    head, _, last = name.rpartition("/")
    repository, _, tag = last.partition(":")
    if head not in _HOMES or repository not in _BASES or any(other in tag for other in _OTHERS):
        place = f"line {line}: " if line else ""
        raise TaskError(
            f"{place}its image is {image[:100]!r}, and a sandbox takes the place of {', '.join(_BASES)} alone: "
            "use the backend 'docker'"
        )


def context_file(context: Path, source: str) -> Path:
    """Return a path of the build's folder, which must lie in it.

    Raises:
        TaskError: It does not.
    """
    parts = [part for part in source.split("/") if part not in ("", ".", "..")]
    path = context.joinpath(*parts)
    if not path.resolve().is_relative_to(context.resolve()):
        raise TaskError(f"{source[:80]!r} leads out of {context}")
    return path
