r"""What is typed into a shell, and what the shell says outside of the agent's sight.

A shell tells when it is ready by *marks* on its terminal, ``ESC ] 7701 ; … BEL``, which no terminal shows: ``S`` when
it starts, ``B`` when a command begins, ``P`` when the shell is ready again, ``R`` when a line that keys have typed
begins, ``X`` when it has ended.
A command is typed as one logical line, which carries the command quoted, so that nothing in it means anything to the
terminal: control characters, unbalanced quotes and length (a terminal cuts lines at 4096 bytes) do no harm.

Each command has two words of its own that it cannot know beforehand, as long as the shell keeps them to itself; a mark
without them is not believed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

_MARK = b"\x1b]7701;"
_END = b"\x07"
_MOST_MARK = 8192

# Octal, which both bash's $'…' and printf's %b read. Tabs would complete names where a shell edits its lines.
_IN_BASH = {code: f"\\{code:03o}" for code in (*range(32), *range(127, 256))} | {
    10: "\\n", 9: "\\t", ord("'"): "\\'", ord("\\"): "\\\\"
}  # fmt: skip
_IN_SH = {code: f"\\0{code:03o}" for code in (*range(32), *range(127, 256), ord("'"))} | {
    10: "\\n", 9: "\\t", ord("\\"): "\\\\"
}  # fmt: skip
_PIECE = 700
"""Bytes of a command on a line: at most 3500 characters when all are escaped."""

# Sets up a shell: argument 1 is the word of its end, 2 its working directory, 3 "norc" for one that reads no files.
# ``trap`` without an action would be inherited; a caught signal is not.
START = r"""
trap : INT QUIT
gem_word=$1 gem_dir=$2 gem_plain=$3
cd "$gem_dir" 2>/dev/null || cd / 2>/dev/null
if [ -z "${LC_ALL-}${LANG-}${LC_CTYPE-}" ]; then LANG=C.UTF-8; export LANG; fi
stty -echo 2>/dev/null
gem_up=
IFS=' ' read -r gem_up gem_rest </proc/uptime
gem_bash=$(command -v bash) || gem_bash=
printf '\033]7701;S;%s;%s;%s\007' "$gem_word" "$gem_up" "${gem_bash:+1}"
if [ -n "$gem_bash" ]; then
  PS1= "$gem_bash" ${gem_plain:+--noprofile --norc} --noediting -i
else
  PS1= ENV= /bin/sh -i
fi
printf '\033]7701;X;%s;%s\007' "$gem_word" "$?"
"""

# ``\builtin`` passes by aliases and by functions of the same names. ``read`` empties what nobody has read. Marks go to
# the terminal that is the shell's input, since output may have been sent elsewhere, and /dev/tty may have been removed.
_BASH = r"""
__gem_say() { \builtin printf '\033]7701;%s\007' "$1" >&0 || \builtin printf '\033]7701;%s\007' "$1" >/dev/tty; }
__gem_begin() {
  \builtin local s=$? u=
  IFS=' ' \builtin read -r u _ </proc/uptime
  __gem_say "B;$1;$u;${!-}"
  case $- in *e*) \builtin return 0 ;; esac
  \builtin return $s
}
__gem_keep() {
  \builtin local s=$?
  __gem_word=$1 __gem_tidy=${2-1} __gem_keys=
  \builtin unset PROMPT_COMMAND
  PROMPT_COMMAND='{ __gem_prompt; } >/dev/null 2>&1' PS0= PS1= PS2=
  \builtin return $s
}
__gem_prompt() {
  \builtin local s=$? t=${__gem_loud-1} w=${__gem_keys:-${__gem_word-}} x=
  if \builtin test -z "${__gem_keys-}"; then
    if \builtin test -n "${__gem_tidy-1}"; then if \command stty sane -echo; then t=0; else t=1; fi; fi
    __gem_tidy=1 __gem_loud=$t
    while \builtin read -t 0; do \builtin read -rsn 4096 -t 0.01 x || \builtin break; done
  fi
  __gem_say "P;$w;$s;$t;$$;$PWD;$w"
  __gem_word=
}
__gem_by_keys() {
  __gem_keys=$1
  \command stty sane
  \builtin set -o emacs
  PS0=$'\e]7701;R;'$1$'\a'
  PS1='\u@\h:\w\$ ' PS2='> '
  PROMPT_COMMAND='{ __gem_prompt; } >/dev/null 2>&1'
}
"""
_SET_UP_BASH = r"\builtin set +o emacs +o vi +o history +o verbose; PS0= PS1= PS2= __gem_word= __gem_keys=;"

# A shell that is no bash tells of its prompts by expanding them, in a process of its own, which keeps nothing.
_SH = r"""
__gem_say() { \printf '\033]7701;%s\007' "$1" >&0 || \printf '\033]7701;%s\007' "$1" >/dev/tty; }
__gem_mark() { __gem_say "P;$1;$2;${__gem_t-1};$$;$PWD;$1"; }
__gem_begin() {
  __gem_s=$? __gem_u=
  IFS=' ' \read -r __gem_u _ </proc/uptime
  __gem_say "B;$1;$__gem_u;${!-}"
  \return $__gem_s
}
__gem_keep() {
  __gem_s=$? PS1=$__gem_ps PS2=
  if test -n "${2-1}"; then if \stty sane -echo; then __gem_t=0; else __gem_t=1; fi; fi
  __gem_mark "$1" "$__gem_s"
  \return $__gem_s
}
__gem_by_keys() {
  \stty sane
  __gem_t=0 PS1="$__gem_ps\$ " PS2='> '
  __gem_mark "$1" 0
}
__gem_ps='$({ __gem_mark "" $?; } 2>/dev/null)'
"""
_SET_UP_SH = r"PS1= PS2=;"


@dataclass(frozen=True)
class Dialect:
    """How a kind of shell is spoken to.

    Args:
        name: ``"bash"`` or ``"sh"``.
        restless: Whether its first line after some errors is refused, and has to be typed again.
    """

    name: str
    restless: bool

    def quoted(self, command: str) -> list[str]:
        """Return a command as words that the shell reads as one, each for a line of its own; NUL is left out."""
        content = command.replace("\x00", "").encode("utf-8", "replace")
        table = _IN_BASH if self.name == "bash" else _IN_SH
        opening = "$'" if self.name == "bash" else "'"
        pieces = [content[start : start + _PIECE] for start in range(0, len(content), _PIECE)] or [b""]
        return [f"{opening}{piece.decode('latin-1').translate(table)}'" for piece in pieces]

    def evaluated(self, command: str) -> str:
        """Return what evaluates a command, of several lines that are one for the shell."""
        words = "\\\n".join(self.quoted(command))
        if self.name == "bash":
            return f"\\builtin eval {words}"
        return f"\\eval \"$(\\printf '%b' {words})\""

    def command(self, command: str, begin: str, word: str, *, tidy: bool = True) -> bytes:
        """Return what is typed to run a command: ``begin`` and ``word`` come back in its marks.

        With ``tidy`` the terminal is brought in order at the end, which takes a process of its own.
        """
        line = f" {{ __gem_begin {begin}; }} >/dev/null 2>&1; {self.evaluated(command)}; "
        end = word if tidy else f"{word} ''"
        return f"{line}{{ __gem_keep {end}; }} >/dev/null 2>&1\n".encode("ascii")

    def set_up(self, word: str) -> bytes:
        """Return what is typed to make a shell, in whatever state, ready for commands."""
        script, settings = (_BASH, _SET_UP_BASH) if self.name == "bash" else (_SH, _SET_UP_SH)
        line = f" {settings} {self.evaluated(script)}; {{ __gem_keep {word}; }} >/dev/null 2>&1\n"
        return line.encode("ascii")

    def again(self, word: str) -> bytes:
        """Return what is typed to hear of a shell that is set up, and has broken off a command."""
        return f" {{ __gem_keep {word}; }} >/dev/null 2>&1\n".encode("ascii")

    def by_keys(self, word: str) -> bytes:
        """Return what is typed to give a shell a prompt and an echo, for an agent that types itself."""
        return f" {{ __gem_by_keys {word}; }} >/dev/null 2>&1\n".encode("ascii")


BASH = Dialect("bash", restless=True)
SH = Dialect("sh", restless=False)


@dataclass(frozen=True)
class Mark:
    """What a shell said outside of the agent's sight.

    Args:
        kind: ``"S"``, ``"B"``, ``"P"``, ``"R"`` or ``"X"``.
        word: The word it was given; empty when it broke off a command.
        status: Exit code, of ``"P"`` and ``"X"``.
        uptime_s: Seconds since the start of the machine, of ``"B"`` and ``"S"``; None where it could not tell.
        background: Number of the last background process, of ``"B"``, 0 for none; of ``"S"``, 1 where there is a bash.
        quiet: Whether the terminal echoes nothing, of ``"P"``.
        pid: The shell's number, of ``"P"``.
        workdir: Its working directory, of ``"P"``.
    """

    kind: str
    word: str
    status: int = 0
    uptime_s: float | None = None
    background: int = 0
    quiet: bool = False
    pid: int = 0
    workdir: str = ""


_BEGINS = re.compile(r"([BS]);([0-9a-f]*);([0-9.]*);([0-9]*)")
_READY = re.compile(r"P;([0-9a-f]*);([0-9]{1,3});([01]);([0-9]{1,9});(.*);\1", re.DOTALL)
_OTHER = re.compile(r"([RX]);([0-9a-f]*)(?:;([0-9]{1,3}))?")


def _read_mark(content: bytes) -> Mark | None:
    text = content.decode("utf-8", "replace")
    if found := _READY.fullmatch(text):
        return Mark("P", found[1], int(found[2]), quiet=found[3] == "0", pid=int(found[4]), workdir=found[5])
    if found := _BEGINS.fullmatch(text):
        seconds = float(found[3]) if re.fullmatch(r"\d{1,12}(\.\d{1,6})?", found[3]) else None
        return Mark(found[1], found[2], uptime_s=seconds, background=int(found[4][:9] or 0))
    if found := _OTHER.fullmatch(text):
        return Mark(found[1], found[2], status=int(found[3] or 0))
    return None


class Marks:
    """Takes marks out of what comes from a terminal, in pieces of any size."""

    def __init__(self) -> None:
        self._held = b""

    def feed(self, output: bytes) -> Iterator[bytes | Mark]:
        """Yield what was written and the marks in it, in order; what may be the beginning of a mark is kept back."""
        data = self._held + output if self._held else output
        self._held = b""
        position = 0
        while (start := data.find(_MARK, position)) >= 0:
            end = data.find(_END, start, start + _MOST_MARK)
            if end < 0:
                if len(data) - start < _MOST_MARK:
                    self._held = data[start:]
                    data = data[:start]
                    break
                end = start + len(_MARK) - 1
            mark = _read_mark(data[start + len(_MARK) : end])
            if start > position:
                yield data[position:start]
            if mark is not None:
                yield mark
            position = end + 1
        rest = data[position:]
        if not self._held:
            rest, self._held = _split_beginning(rest)
        if rest:
            yield rest

    def rest(self) -> bytes:
        """Return what was kept back, when nothing more will come."""
        rest, self._held = self._held, b""
        return rest


def _split_beginning(data: bytes) -> tuple[bytes, bytes]:
    """Split off a part of the beginning of a mark from the end."""
    start = data.rfind(b"\x1b", max(0, len(data) - len(_MARK)))
    if start >= 0 and _MARK.startswith(data[start:]):
        return data[:start], data[start:]
    return data, b""
