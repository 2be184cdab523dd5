"""A filter of system calls: what no script needs and attacks begin with.

It stands behind the namespaces as a second wall, and on the level ``process`` it is what keeps code off the network and
off other processes. Numbers of system calls: ``asm/unistd_64.h`` and ``asm-generic/unistd.h`` of Linux.
"""

from __future__ import annotations

import errno
import os
import platform
from typing import NamedTuple

from gem_tools.python.inside import kernel

_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_ALLOW, _FAIL, _KILL = 0x7FFF0000, 0x00050000, 0x80000000
_NUMBER, _ARCH = 0, 4
_FIRST_ARGUMENT, _SECOND_ARGUMENT, _THIRD_ARGUMENT = 16, 24, 32  # their low halves, on little-endian machines
_NEW_NAMESPACE = 0x7E020080  # CLONE_NEWTIME, NEWNS, NEWCGROUP, NEWUTS, NEWIPC, NEWUSER, NEWPID, NEWNET
_X32 = 0x40000000
_AF_UNIX = 1
_FAMILIES = (_AF_UNIX, 2, 10, 16)  # INET, INET6, NETLINK; others, as VSOCK, reach out of a network namespace
_ADDRESSED = 2  # the bit of the types of sockets that send to any address: DGRAM, RAW
_OWNERS = (8, 10, 15)  # F_SETOWN, F_SETSIG, F_SETOWN_EX: a file that becomes ready signals its owner, whoever that is
_IOCTL_OWNERS = (0x8901, 0x8902)  # FIOSETOWN, SIOCSPGRP
PIDFD_SEND_SIGNAL = 424  # on every processor; any folder of /proc that can be opened will do
_TERMINALS, _SOCKETS = 0x5400, 0x8900  # the first of 256 commands each, FIONREAD and FIONBIO among them


class Machine(NamedTuple):
    """The numbers of one kind of processor."""

    arch: int
    denied: tuple[int, ...]
    clone: int
    clone3: int
    socket: int
    socketpair: int
    connect: int
    bind: int
    timer_create: int
    fcntl: int
    ioctl: int
    signalling: tuple[int, ...]
    """Calls whose first argument is the process that they reach, by a signal, a limit, or its place on processors."""
    priorities: tuple[int, ...]
    """Calls that slow down all processes of a user."""
    owning: tuple[int, ...]
    """Calls that the owner of a file may make, wherever it is: they change its mode, its owner and its times."""
    attributes: tuple[int, ...]
    """Calls that change a file's extended attributes."""
    utimensat: int
    x32: bool


# Tracing and other processes' memory; mounts, roots, namespaces; keys; bpf, perf, userfaultfd, io_uring; modules and
# restarts; handles of files; System V and POSIX message objects, which outlive a process; clocks and host names;
# memory files, which no limit on memory counts; moving the memory of processes.
_X86_64 = Machine(
    arch=0xC000003E,
    denied=(
        *(101, 310, 311, 312, 438, 440),
        *(165, 166, 155, 161, 272, 308, 428, 429, 430, 431, 432, 433, 442),
        *(248, 249, 250, 321, 298, 323, 425, 426, 427, 300),
        *(246, 320, 175, 313, 176, 169, 167, 168, 163, 179, 103, 172, 173),
        *(303, 304),
        *(29, 30, 31, 64, 65, 66, 67, 68, 69, 70, 71, 220, 240, 241),
        *(164, 227, 159, 305, 170, 171),
        *(319, 447),
        *(256, 279),
    ),
    clone=56,
    clone3=435,
    socket=41,
    socketpair=53,
    connect=42,
    bind=49,
    timer_create=222,
    fcntl=72,
    ioctl=16,
    signalling=(62, 200, 234, 129, 297, 302, 434, 203, 142, 144, 314),
    priorities=(141, 251),
    owning=(90, 91, 268, 452, 92, 93, 94, 260, 132, 235, 261, 469),
    attributes=(188, 189, 190, 197, 198, 199, 463, 466),
    utimensat=280,
    x32=True,
)
_AARCH64 = Machine(
    arch=0xC00000B7,
    denied=(
        *(117, 270, 271, 272, 438, 440),
        *(40, 39, 41, 51, 97, 268, 428, 429, 430, 431, 432, 433, 442),
        *(217, 218, 219, 280, 241, 282, 425, 426, 427, 262),
        *(104, 294, 105, 273, 106, 142, 224, 225, 89, 60, 116),
        *(264, 265),
        *(194, 195, 196, 197, 190, 191, 192, 193, 186, 187, 188, 189, 180, 181),
        *(170, 112, 171, 266, 161, 162),
        *(279, 447),
        *(238, 239),
    ),
    clone=220,
    clone3=435,
    socket=198,
    socketpair=199,
    connect=203,
    bind=200,
    timer_create=107,
    fcntl=25,
    ioctl=29,
    signalling=(129, 130, 131, 138, 240, 261, 434, 122, 118, 119, 274),
    priorities=(140, 30),
    owning=(52, 53, 452, 54, 55, 469),
    attributes=(5, 6, 7, 14, 15, 16, 463, 466),
    utimensat=88,
    x32=False,
)
MACHINES = {"x86_64": _X86_64, "aarch64": _AARCH64}

Instruction = tuple[int, int, int, int]


def program(machine: Machine, *, sockets: bool, own_pid: int | None) -> list[Instruction]:
    """Return the filter.

    Args:
        machine: Numbers of the processor.
        sockets: Whether sockets of every usual kind may be made and have addresses, as in a network namespace of its
            own. Elsewhere only pairs are of use: names of sockets lead to this machine's services, and to other calls.
        own_pid: The only process that may be reached by signals, where others are of the same user, whose files'
            permissions and times stay as well; None where neither is in sight.
    """
    refuse = [(_RETURN, 0, 0, _FAIL | errno.EPERM)]
    lines: list[Instruction] = [(_LOAD, 0, 0, _ARCH), (_EQUAL, 1, 0, machine.arch), (_RETURN, 0, 0, _KILL)]
    lines.append((_LOAD, 0, 0, _NUMBER))
    if machine.x32:
        lines += [(_AT_LEAST, 0, 1, _X32), *refuse]
    # Programs fall back to clone, whose flags can be looked at; and to timers that cannot wake a stopped process.
    for number in (machine.clone3, machine.timer_create):
        lines += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _FAIL | errno.ENOSYS)]
    lines += [(_EQUAL, 0, 3, machine.clone), (_LOAD, 0, 0, _FIRST_ARGUMENT), (_ANY_BIT, 0, 1, _NEW_NAMESPACE), *refuse]
    lines.append((_LOAD, 0, 0, _NUMBER))
    families = _FAMILIES if sockets else (_AF_UNIX,)
    known = [(_EQUAL, len(families) - place, 0, family) for place, family in enumerate(families)]
    lines += [(_EQUAL, 0, len(known) + 2 + 1, machine.socket), (_LOAD, 0, 0, _FIRST_ARGUMENT), *known, *refuse]
    # Loaded anew for the checks below, which look at sockets too.
    lines.append((_LOAD, 0, 0, _NUMBER))
    if not sockets:
        for number in (machine.socket, machine.socketpair):
            lines += _second(number, [(_ANY_BIT, 0, 1, _ADDRESSED), *refuse])
        lines += [line for number in (machine.connect, machine.bind) for line in ((_EQUAL, 0, 1, number), *refuse)]
    if own_pid is not None:
        for number, values, further in ((machine.fcntl, _OWNERS, []), (machine.ioctl, _IOCTL_OWNERS, _of_no_file())):
            refused = [line for value in values for line in ((_EQUAL, 0, 1, value), *refuse)]
            lines += _second(number, [*refused, *further])
        others = (*machine.priorities, PIDFD_SEND_SIGNAL)
        lines += [line for number in others for line in ((_EQUAL, 0, 1, number), *refuse)]
        for number in machine.signalling:
            lines += [(_EQUAL, 0, 5, number), (_LOAD, 0, 0, _FIRST_ARGUMENT), (_EQUAL, 2, 0, own_pid)]
            lines += [(_EQUAL, 1, 0, 0), *refuse, (_RETURN, 0, 0, _ALLOW)]
        lines += _files_kept(machine)
    count = len(machine.denied)
    lines += [(_EQUAL, count - place, 0, number) for place, number in enumerate(machine.denied)]
    return [*lines, (_RETURN, 0, 0, _ALLOW), *refuse]


def _files_kept(machine: Machine) -> list[Instruction]:
    """Return checks that leave modes, owners, attributes and times of all files as they are, which no Landlock does.

    What copies and unpacks files changes modes and times as its last step: that does nothing, and does not fail.
    ``Path.touch`` sets the present time by name, and makes a file where that fails: so it must.
    """
    nothing, refuse, unsupported = ((_RETURN, 0, 0, _FAIL | number) for number in (0, errno.EPERM, errno.ENOTSUP))
    lines: list[Instruction] = []
    for numbers, result in ((machine.owning, nothing), (machine.attributes, unsupported)):
        lines += [line for number in numbers for line in ((_EQUAL, 0, 1, number), result)]
    lines += [(_EQUAL, 0, 7, machine.utimensat), (_LOAD, 0, 0, _THIRD_ARGUMENT), (_EQUAL, 1, 0, 0), nothing]
    return [*lines, (_LOAD, 0, 0, _SECOND_ARGUMENT), (_EQUAL, 0, 1, 0), nothing, refuse]


def _of_no_file() -> list[Instruction]:
    """Return a check of ``ioctl``: those of file systems change a file, or its folder, that may merely be read."""
    return [
        (_AT_LEAST, 3, 0, _SOCKETS + 256),
        (_AT_LEAST, 3, 0, _SOCKETS),
        (_AT_LEAST, 1, 0, _TERMINALS + 256),
        (_AT_LEAST, 1, 0, _TERMINALS),
        (_RETURN, 0, 0, _FAIL | errno.ENOTTY),
    ]


def _second(number: int, checks: list[Instruction]) -> list[Instruction]:
    """Return checks of the second argument of one call, which is allowed if it passes."""
    return [
        (_EQUAL, 0, len(checks) + 2, number),
        (_LOAD, 0, 0, _SECOND_ARGUMENT),
        *checks,
        (_RETURN, 0, 0, _ALLOW),
    ]


class Filter:
    """A filter that is made ahead and set in each process that runs code.

    Args:
        sockets: Whether sockets may have addresses.
        only_own: Whether signals reach no other process.
    """

    def __init__(self, *, sockets: bool, only_own: bool) -> None:
        self._machine = MACHINES.get(platform.machine())
        self._sockets, self._only_own = sockets, only_own
        self._made = None if self._machine is None or only_own else self._make(self._machine, None)

    def _make(self, machine: Machine, own_pid: int | None) -> kernel.FilterProgram:
        return kernel.FilterProgram(program(machine, sockets=self._sockets, own_pid=own_pid))

    def works(self) -> bool:
        """Try it in a process of its own."""
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
                code = 0 if self.set() else 1
            finally:
                os._exit(code)
        return os.waitpid(pid, 0)[1] == 0

    def set(self) -> bool:
        """Set it for this process and its children, for good; False where this kernel or processor has none."""
        if self._machine is None:
            return False
        try:
            (self._made or self._make(self._machine, os.getpid())).set()
        except OSError:
            return False
        return True
