"""The part of Compose that task formats use is read as it is specified; what reaches for the host is refused."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from task_writing import TERMINAL_BENCH, read_task, write

from gem_terminal.errors import TaskError
from gem_terminal.tasks.task import Container, Healthcheck

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task


def compose(tmp_path: Path, text: str, variables: dict[str, str] | None = None, **files: str) -> Task:
    """Read a task with a Compose file, and more files."""
    return read_task(write(tmp_path / "t", TERMINAL_BENCH, {"docker-compose.yaml": text}, files), variables)


def client(tmp_path: Path, text: str, **files: str) -> Task:
    """Read a task whose agent's service says this, in YAML's flow style."""
    return compose(tmp_path, f"services: {{client: {{build: ., {text}}}}}\n", **files)


def notes(task: Task) -> list[str]:
    """Return the notes on a task's Compose file, without its name."""
    return [note.removeprefix("docker-compose.yaml: ") for note in task.notes]


EVERYTHING = """
x-common: &common
  environment: {A: yes, B: 0777, C: null, D: "", E: 1.50}
services:
  client:
    <<: *common
    build: {context: app, dockerfile: files/Dockerfile, args: [ONE=1, "TWO=${TWO:-2}"], target: last}
    entrypoint: /init --now
    command: ["bash", "-c", "run && sleep infinity"]
    working_dir: /work
    user: "1000:1000"
    hostname: box
    shm_size: 64m
    deploy: {resources: {limits: {cpus: "1.5", memory: 1gb}}}
    healthcheck: {test: "curl -f localhost", interval: 1m30s, timeout: 500ms, start_period: 2s, retries: 5}
    volumes: ["shared:/srv:ro"]
  web:
    image: web:1
    mem_limit: 300000k
    cpus: 0.25
    command: run 'two words'
    healthcheck: {test: ["CMD", "true", "x"]}
    volumes: [{type: volume, source: shared, target: /data}]
    tmpfs: /run
volumes: {shared: }
"""


def test_every_part_arrives(tmp_path: Path) -> None:
    """Build, words, variables to the letter, limits, healthcheck, volumes, merge keys; the rest is noted."""
    task = compose(tmp_path, EVERYTHING, **{"app/files/Dockerfile": "FROM x\n"})
    assert task.environment.main == Container(
        context=tmp_path / "t/app",
        dockerfile="files/Dockerfile",
        build_args={"ONE": "1", "TWO": "2"},
        target="last",
        entrypoint=("/init", "--now"),
        command=("bash", "-c", "run && sleep infinity"),
        env={"A": "yes", "B": "0777", "D": "", "E": "1.50"},
        workdir="/work",
        user="1000:1000",
        healthcheck=Healthcheck(("sh", "-c", "curl -f localhost"), 90.0, 0.5, 2.0, 5),
        cpus=1.5,
        memory_mb=1024,
        shm_mb=64,
        volumes={"shared": "/srv"},
        hostname="box",
    )
    web = Container(
        image="web:1",
        command=("run", "two words"),
        healthcheck=Healthcheck(("true", "x"), 30.0, 30.0, 0.0, 3),
        cpus=0.25,
        memory_mb=293,
        volumes={"shared": "/data"},
    )
    assert task.environment.services == {"web": web}
    assert [note.split("'")[3] for note in notes(task)] == ["C", "/srv", "/run"]
    assert task.environment.unsupported == ()


VALUES = {
    "$TWO ${TWO}x": "2 2x",
    "${NONE:-a b}${NONE-}": "a b",
    "${EMPTY:-e}${EMPTY-no}": "e",
    "${TWO:+set}${NONE:+set}": "set",
    "${NONE:-${TWO:-3}}${TWO:-${NONE}}": "22",
    "${TWO:?it is needed}": "2",
    "$$TWO": "$TWO",
    "${T_BENCH_TEST_DIR}": "/tests",
    "${COMPOSE_PROJECT_NAME}": "gem-terminal-task",
}


@pytest.mark.parametrize("written", VALUES)
def test_variables_have_their_values(tmp_path: Path, written: str) -> None:
    """Of the file ``.env`` beside, of the harness, or the default; else nothing."""
    files = {".env": "# a comment\nexport TWO=2 # two\nEMPTY=\n"}
    task = client(tmp_path, f"environment: ['A={written}']", **files)
    assert task.environment.main.env == {"A": VALUES[written]}


def test_a_variable_without_a_value_is_missing(tmp_path: Path) -> None:
    """Until it is given; those in a default that is not used are not."""
    text = "'a=${A}$B', 'c=${C:?it is needed}', 'd=${D:-${E}}', 'f=${F:-x${G}}', 'h=${H:+$I}', J"
    text = f"services: {{client: {{build: ., environment: ['X=$T_BENCH_TEST_DIR', {text}]}}}}\n"
    given = {"A": "1", "D": "2"}
    task = compose(tmp_path, text, given)
    place = "docker-compose.yaml"
    assert task.missing == {"B": place, "C": f"{place} (it is needed)", "G": place}
    assert task.variables == dict.fromkeys("ABCEGHIJ") | {"D": "", "F": "x"}
    task = compose(tmp_path, text, given | dict.fromkeys("BCGHIJ", "j"))
    assert (task.missing, task.environment.main.env["J"]) == ({}, "j")
    with pytest.raises(TaskError, match="without a value: IMAGE"):
        client(tmp_path, "x-y: 1}, other: {image: $IMAGE")


def test_files_of_variables_are_read_in_order(tmp_path: Path) -> None:
    """Quotes, escapes and variables of their own; ``environment`` comes after them; a missing one may be allowed."""
    files = {"a.env": "A='$$X'\nB=\"one\\ntwo\"\nC=3\n", "b.env": "\ufeffC=${T_BENCH_TEST_DIR}/c\nD=d # no\n"}
    text = "env_file: [a.env, {path: ./b.env}, {path: c.env, required: false}], environment: {D: 4}"
    found = client(tmp_path, text, **files).environment.main.env
    assert found == {"A": "$X", "B": "one\ntwo", "C": "/tests/c", "D": "4"}


def test_services_start_after_those_they_depend_on(tmp_path: Path) -> None:
    """Else in the order of the file; the agent's container comes last."""
    text = """
services:
  web: {image: w, depends_on: {cache: {condition: service_healthy}, db: {condition: service_started}}}
  client: {build: ., depends_on: [web]}
  db: {image: d, depends_on: [cache]}
  other: {image: o}
  cache: {image: c}
"""
    assert list(compose(tmp_path, text).environment.services) == ["other", "cache", "db", "web"]


@pytest.mark.parametrize(
    ("text", "network"),
    [
        ("network_mode: none", "none"),
        ("network_mode: bridge", "public"),
        ("networks: [inner]", "none"),
        ("networks: [inner, outer]", None),
        ("networks: {outer: }", None),
    ],
)
def test_what_the_file_says_of_the_network_counts(tmp_path: Path, text: str, network: str | None) -> None:
    """None at all, the engine's own, only internal ones; else it says nothing."""
    nets = "networks: {inner: {internal: true}, outer: }"
    assert compose(tmp_path, f"services: {{client: {{build: ., {text}}}}}\n{nets}\n").environment.network == network


def test_folders_of_logs_are_volumes_only_where_they_are_shared(tmp_path: Path) -> None:
    """The harness's own folders of the host are never mounted."""
    logs = "volumes: ['${T_BENCH_TASK_LOGS_PATH}:/logs']"
    alone = client(tmp_path, logs).environment
    assert (alone.main.volumes, alone.unsupported) == ({}, ())
    shared = compose(tmp_path, f"services: {{client: {{build: ., {logs}}}, web: {{image: w, {logs}}}}}\n").environment
    assert shared.main.volumes == shared.services["web"].volumes == {"logs": "/logs"}


KEYS = """privileged: true, cap_add: [SYS_ADMIN], devices: ['/dev/kvm:/dev/kvm'], pid: host, ipc: host,
userns_mode: host, security_opt: ['seccomp:unconfined'], extra_hosts: ['host.docker.internal:host-gateway'],
extends: {file: x.yaml, service: y}, secrets: [key], sysctls: {net.ipv4.ip_forward: 1}"""
REFUSED = {
    KEYS: "privileged cap_add devices pid ipc userns_mode security_opt extra_hosts extends secrets sysctls",
    "deploy: {resources: {reservations: {devices: [{driver: x}]}}}": "deploy.resources.reservations.devices",
    "network_mode: host": "host",
    "network_mode: 'service:db'": "service:db",
    "volumes: ['/var/run/docker.sock:/var/run/docker.sock']": "/var/run/docker.sock",
    "volumes: ['./data:/data:ro']": "./data",
    "volumes: [{type: bind, source: /, target: /host}]": "/",
    "volumes: ['/.gem-terminal/../etc:/etc']": "/.gem-terminal/../etc",
    "deploy: {replicas: 3}": "deploy.replicas",
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_reaches_for_the_host_is_never_granted(tmp_path: Path, text: str) -> None:
    """The task can be read, and says why it cannot be run."""
    found = client(tmp_path, text).environment
    assert {said.split("'")[3] for said in found.unsupported} == set(REFUSED[text].split())
    assert found.main.volumes == {}


def test_what_takes_nothing_from_the_host_is_no_matter(tmp_path: Path) -> None:
    """Such keys say what is so anyway."""
    name = "container_name: '${T_BENCH_TASK_DOCKER_CLIENT_CONTAINER_NAME}'"
    task = client(
        tmp_path,
        "privileged: false, cap_add: [CAP_NET_BIND_SERVICE, chown], security_opt: ['no-new-privileges:true'], "
        "devices: [], deploy: {resources: {reservations: {memory: 1g}}}, ipc: private, cap_drop: [ALL], init: true, "
        f"stdin_open: true, restart: always, {name}, x-mine: 1",
    )
    assert (task.environment.unsupported, task.notes) == ((), ())


def test_volumes_and_networks_of_the_host_are_refused(tmp_path: Path) -> None:
    """A volume with a driver's options may be any folder of the host."""
    text = """
services: {client: {build: ., volumes: ['a:/a', 'b:/b'], networks: [n]}}
volumes: {a: {external: true}, b: {driver_opts: {type: none, device: /etc, o: bind}}, unused: {external: true}}
networks: {n: {external: true}}
include: [other.yaml]
"""
    found = sorted(compose(tmp_path, text).environment.unsupported)
    assert [said.split("'")[1] for said in found] == ["n", "a", "b", "include"]


def test_what_is_passed_over_is_noted(tmp_path: Path) -> None:
    """Each with its service."""
    text = """
services:
  client: {build: ., ports: ['80:80'], environment: [HOME_OF_HOST], volumes: [/cache], networks: [a]}
  web: {image: w, ulimits: {nproc: 5}, depends_on: [client], networks: [b]}
  tool: {image: t, profiles: [debug]}
networks: {a: , b: }
"""
    noted = "".join(notes(compose(tmp_path, text)))
    named = ("'tool'", "networks", "'client', and is", "'ports'", "'HOME_OF_HOST'", "'/cache'", "'ulimits'")
    assert [words for words in named if words not in noted] == []
