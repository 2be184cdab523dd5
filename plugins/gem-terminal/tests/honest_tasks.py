"""Small tasks of Harbor's format whose honest solutions change the machine in every way that tasks ask for.

By hand (``docker exec`` in the same container) the tests of each pass after its solution and fail without it.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from task_writing import write


class Honest(NamedTuple):
    """A task.

    Args:
        ask: What the agent is asked to do.
        solution: Lines of bash that do it.
        check: A command of bash that succeeds once it is done.
    """

    ask: str
    solution: str
    check: str


def _listens(port: int) -> str:
    return f"until (exec 3<>/dev/tcp/127.0.0.1/{port}) 2>/dev/null; do sleep 0.05; done\n"


_SERVER = """cat >/app/server.py <<'END'
import http.server

class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        with open("/app/requests.log", "a") as log:
            log.write(self.path + "\\n")
        self.send_response(204)
        self.end_headers()

http.server.HTTPServer(("127.0.0.1", 8001), Handler).serve_forever()
END
nohup python3 /app/server.py >/dev/null 2>&1 &
"""
_WATCHER = """mkdir -p /app/in /app/out
cat >/app/watch.py <<'END'
import pathlib, time
while True:
    for path in pathlib.Path("/app/in").iterdir():
        pathlib.Path("/app/out", path.name).write_text(path.read_text().upper())
    time.sleep(0.05)
END
setsid python3 /app/watch.py </dev/null >/dev/null 2>&1 &
"""
_SOCKET = """cat >/app/echo.py <<'END'
import socketserver

class Handler(socketserver.StreamRequestHandler):
    def handle(self):
        self.wfile.write(self.rfile.readline()[::-1])

socketserver.UnixStreamServer("/run/reverse.sock", Handler).serve_forever()
END
nohup python3 /app/echo.py >/dev/null 2>&1 &
until [ -S /run/reverse.sock ]; do sleep 0.05; done
"""
_ASK_SOCKET = """python3 -c "
import socket
ask = socket.socket(socket.AF_UNIX)
ask.connect('/run/reverse.sock')
ask.sendall(b'abc\\n')
assert ask.makefile('rb').read().strip() == b'cba'
" """
_LIBRARIES = """cp /usr/lib/x86_64-linux-gnu/libexpat.so.1 /usr/local/lib
mkdir -p /opt/more
cp /usr/lib/x86_64-linux-gnu/libbz2.so.1.0 /opt/more
echo /opt/more >/etc/ld.so.conf.d/more.conf
ldconfig
"""
_LOAD_LIBRARIES = """python3 -c "
import ctypes
ctypes.CDLL('libexpat.so.1')
ctypes.CDLL('libbz2.so.1.0')
loaded = open('/proc/self/maps').read()
assert '/usr/local/lib/libexpat' in loaded and '/opt/more/libbz2' in loaded
" """

HONEST = {
    "server-logs-requests": Honest(
        "Serve HTTP on 127.0.0.1:8001; append the path of each request to /app/requests.log.",
        _SERVER + _listens(8001),
        "python3 -c \"import urllib.request as u; u.urlopen('http://127.0.0.1:8001/seen', timeout=5)\" && "
        "grep -qx /seen /app/requests.log",
    ),
    "daemon-watches-folder": Honest(
        "Have each file that is put into /app/in copied to /app/out in capitals.",
        _WATCHER,
        "echo abc >/app/in/one; timeout 5 bash -c 'until grep -qs ABC /app/out/one; do sleep 0.05; done'",
    ),
    "unix-socket": Honest("Answer each line on the socket /run/reverse.sock backwards.", _SOCKET, _ASK_SOCKET),
    "fifo": Honest(
        "Answer each number that is written to the FIFO /app/ask with its double on the FIFO /app/answer.",
        "mkfifo /app/ask /app/answer\n"
        "nohup bash -c 'while read n </app/ask; do echo $((2 * n)) >/app/answer; done' >/dev/null 2>&1 &\n",
        "[ -p /app/ask ] && timeout 5 bash -c 'echo 21 >/app/ask; read n </app/answer; [ $n = 42 ]'",
    ),
    "shared-memory": Honest(
        "Put 'warm' into /dev/shm/cache.", "echo warm >/dev/shm/cache", "grep -qx warm /dev/shm/cache"
    ),
    "libraries": Honest(
        "Have programs load libexpat from /usr/local/lib and libbz2 from /opt/more.", _LIBRARIES, _LOAD_LIBRARIES
    ),
    "newer-tool": Honest(
        "Install a sort whose version is 99 in /usr/local/bin.",
        "printf '#!/bin/sh\\necho sort 99\\n' >/usr/local/bin/sort; chmod +x /usr/local/bin/sort",
        "sort --version | grep -qx 'sort 99'",
    ),
    "names-of-hosts": Honest(
        "Have db.internal resolve to 10.1.2.3, and no name asked of DNS.",
        "echo '10.1.2.3 db.internal' >>/etc/hosts; sed -i 's/^hosts:.*/hosts: files/' /etc/nsswitch.conf",
        "grep -qx 'hosts: files' /etc/nsswitch.conf && getent hosts db.internal | grep -q ^10.1.2.3",
    ),
    "standard-library": Honest(
        "colorsys.rgb_to_hsv of Python's standard library raises NameError: repair it.",
        "sed -i 's/maxx/maxc/g' /usr/lib/python3.11/colorsys.py",
        "python3 -c 'import colorsys; assert colorsys.rgb_to_hsv(0, 0, 1)[2] == 1'",
    ),
    "settings-at-the-root": Honest(
        "Write /pyproject.toml, a project called 'root'.",
        "printf '[project]\\nname = \"root\"\\n' >/pyproject.toml",
        "python3 -c \"import tomllib as t; assert t.load(open('/pyproject.toml', 'rb'))['project']['name'] == 'root'\"",
    ),
    "background-job": Honest(
        "Serve the folder /srv over HTTP on port 8002 of 127.0.0.1.",
        "cd /srv; echo 42 >answer\npython3 -m http.server 8002 --bind 127.0.0.1 &\n" + _listens(8002),
        "python3 -c \"import urllib.request as u; assert b'42' in u.urlopen('http://127.0.0.1:8002/answer').read()\"",
    ),
    "loop-like-cron": Honest(
        "Write the time to /app/beat again and again, several times a second.",
        "setsid bash -c 'while :; do date +%s%N >/app/beat; sleep 0.1; done' </dev/null >/dev/null 2>&1 &",
        'sleep 0.2; a=$(cat /app/beat); sleep 0.5; b=$(cat /app/beat); [ "${b:-0}" -gt "${a:-0}" ]',
    ),
    "environment": Honest(
        "Set APP_MODE to 'fast' for login shells by /etc/profile.d, and in /etc/environment.",
        "echo 'export APP_MODE=fast' >/etc/profile.d/app.sh; echo APP_MODE=fast >>/etc/environment",
        "[ \"$(bash -lc 'echo $APP_MODE')\" = fast ] && grep -qx APP_MODE=fast /etc/environment",
    ),
    "user-and-permissions": Honest(
        "Make a user deploy with the number 4242, and /app/key that only this user can read.",
        "useradd -m -u 4242 deploy; echo key >/app/key; chown deploy /app/key; chmod 600 /app/key",
        "[ \"$(stat -c '%u %a' /app/key)\" = '4242 600' ] && su deploy -c 'cat /app/key' | grep -qx key",
    ),
    "temporary-file-and-link": Honest(
        "Put 'now' into /tmp/state and link /app/current to it.",
        "echo now >/tmp/state; ln -s /tmp/state /app/current",
        "[ -L /app/current ] && grep -qx now /app/current",
    ),
}
"""The tasks by name."""

_DOCKERFILE = """ARG BASE=gem-python:base
FROM ${BASE}
RUN mkdir /app && sed -i 's/maxc = max/maxx = max/' /usr/lib/python3.11/colorsys.py
WORKDIR /app
"""
_TEST = "if {check}\nthen echo 1 >/logs/verifier/reward.txt\nelse echo 0 >/logs/verifier/reward.txt\nfi\n"


def write_honest(folder: Path) -> Path:
    """Write the folders of all tasks, which share one image, and return the folder."""
    for name, task in HONEST.items():
        files = {
            "task.toml": 'schema_version = "1.4"\n[agent]\ntimeout_sec = 60\n[verifier]\ntimeout_sec = 20\n',
            "instruction.md": task.ask + "\n",
            "environment/Dockerfile": _DOCKERFILE,
            "tests/test.sh": _TEST.replace("{check}", task.check),
            "solution/solve.sh": task.solution,
        }
        write(folder / name, files)
    return folder
