"""The part of Compose that task formats use is read as it is specified; what reaches for the host is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from task_writing import TERMINAL_BENCH, read_task, write

from gem_terminal.errors import TaskError
from gem_terminal.tasks.task import Container, Environment, Healthcheck


def environment(tmp_path: Path, compose: str, **files: str) -> Environment:
    """Read a task with a Compose file, and more files."""
    return read_task(write(tmp_path / "t", TERMINAL_BENCH, {"docker-compose.yaml": compose}, files)).environment


def notes(tmp_path: Path, compose: str, **files: str) -> tuple[str, ...]:
    """Return the notes of such a task, without the file's name."""
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, {"docker-compose.yaml": compose}, files))
    return tuple(note.removeprefix("docker-compose.yaml: ") for note in task.notes)


def client(tmp_path: Path, text: str, **files: str) -> Container:
    """Read a task whose agent's service says this, in YAML's flow style."""
    return environment(tmp_path, f"services: {{client: {{build: ., {text}}}}}\n", **files).main


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
    """Build, words, variables to the letter, limits, healthcheck, volumes, merge keys."""
    found = environment(tmp_path, EVERYTHING, **{"app/files/Dockerfile": "FROM x\n"})
    assert found.main == Container(
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
    assert found.services == {
        "web": Container(
            image="web:1",
            command=("run", "two words"),
            healthcheck=Healthcheck(("true", "x"), 30.0, 30.0, 0.0, 3),
            cpus=0.25,
            memory_mb=293,
            volumes={"shared": "/data"},
        )
    }
    assert notes(tmp_path, EVERYTHING) == (
        "the service 'client': 'C' would come from the host's environment, and is not set.",
        "the service 'client': the volume at '/srv' can be written to.",
        "the service 'web': the temporary file system '/run' is an ordinary folder.",
    )
    assert found.unsupported == ()


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("$TWO", "2"),
        ("${TWO}x", "2x"),
        ("${NONE:-a b}", "a b"),
        ("${NONE-}", ""),
        ("${EMPTY:-e}${EMPTY-no}", "e"),
        ("${TWO:+set}${NONE:+set}", "set"),
        ("${NONE:-${TWO:-3}}", "2"),
        ("${TWO:-${NONE}}", "2"),
        ("${TWO:?it is needed}", "2"),
        ("$$TWO", "$TWO"),
        ("${T_BENCH_TEST_DIR}", "/tests"),
        ("${COMPOSE_PROJECT_NAME}", "gem-terminal-task"),
    ],
)
def test_variables_have_their_values(tmp_path: Path, written: str, value: str) -> None:
    """Of the file ``.env`` beside, of the harness, or the default; else nothing."""
    files = {".env": "# a comment\nexport TWO=2 # two\nEMPTY=\n"}
    assert client(tmp_path, f"environment: ['A={written}']", **files).env == {"A": value}


def test_a_variable_without_a_value_is_missing(tmp_path: Path) -> None:
    """Until it is given; those in a default that is not used are not."""
    text = "'a=${A}$B', 'c=${C:?it is needed}', 'd=${D:-${E}}', 'f=${F:-x${G}}', 'h=${H:+$I}', J"
    folder = write(
        tmp_path / "t",
        TERMINAL_BENCH,
        {"docker-compose.yaml": f"services: {{client: {{build: ., environment: ['X=$T_BENCH_TEST_DIR', {text}]}}}}\n"},
    )
    given = {"A": "1", "D": "2"}
    task = read_task(folder, variables=given)
    assert task.missing == {
        "B": "docker-compose.yaml",
        "C": "docker-compose.yaml (it is needed)",
        "G": "docker-compose.yaml",
    }
    asked = {"A": None, "B": None, "C": None, "D": "", "E": None, "F": "x", "G": None, "H": None, "I": None, "J": None}
    assert task.variables == asked
    given |= {"B": "b", "C": "c", "G": "g", "H": "h", "I": "i", "J": "j"}
    task = read_task(folder, variables=given)
    assert task.missing == {}
    assert task.environment.main.env["J"] == "j"
    with pytest.raises(TaskError, match=r"expected one of them\. Variables without a value: IMAGE; give them with var"):
        client(tmp_path, "x-y: 1}, other: {image: $IMAGE")


def test_files_of_variables_are_read_in_order(tmp_path: Path) -> None:
    """Quotes, escapes and variables of their own; ``environment`` comes after them; a missing one may be allowed."""
    files = {
        "a.env": "A='$$X'\nB=\"one\\ntwo\"\nC=3\n",
        "b.env": "\ufeffC=${T_BENCH_TEST_DIR}/c\nD=d # no\n",
    }
    text = "env_file: [a.env, {path: ./b.env}, {path: c.env, required: false}], environment: {D: 4}"
    assert client(tmp_path, text, **files).env == {"A": "$X", "B": "one\ntwo", "C": "/tests/c", "D": "4"}


def test_services_start_after_those_they_depend_on(tmp_path: Path) -> None:
    """Else in the order of the file; the agent's container comes last."""
    compose = """
services:
  web: {image: w, depends_on: {cache: {condition: service_healthy}, db: {condition: service_started}}}
  client: {build: ., depends_on: [web]}
  db: {image: d, depends_on: [cache]}
  other: {image: o}
  cache: {image: c}
"""
    assert list(environment(tmp_path, compose).services) == ["other", "cache", "db", "web"]


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
    compose = f"services: {{client: {{build: ., {text}}}}}\nnetworks: {{inner: {{internal: true}}, outer: }}\n"
    assert environment(tmp_path, compose).network == network


def test_folders_of_logs_are_volumes_only_where_they_are_shared(tmp_path: Path) -> None:
    """The harness's own folders of the host are never mounted."""
    logs = "'${T_BENCH_TASK_LOGS_PATH}:/logs'"
    one = environment(tmp_path, f"services: {{client: {{build: ., volumes: [{logs}]}}}}\n")
    assert (one.main.volumes, one.unsupported) == ({}, ())
    two = f"services: {{client: {{build: ., volumes: [{logs}]}}, web: {{image: w, volumes: [{logs}]}}}}\n"
    found = environment(tmp_path, two)
    assert found.main.volumes == found.services["web"].volumes == {"logs": "/logs"}


REFUSED = {
    **{
        text: f"'{key}', which reaches out of its container"
        for key, text in {
            "privileged": "privileged: true",
            "cap_add": "cap_add: [SYS_ADMIN]",
            "devices": "devices: ['/dev/kvm:/dev/kvm']",
            "pid": "pid: host",
            "ipc": "ipc: host",
            "userns_mode": "userns_mode: host",
            "security_opt": "security_opt: ['seccomp:unconfined']",
            "extra_hosts": "extra_hosts: ['host.docker.internal:host-gateway']",
            "extends": "extends: {file: x.yaml, service: y}",
            "secrets": "secrets: [key]",
            "sysctls": "sysctls: {net.ipv4.ip_forward: 1}",
            "deploy.resources.reservations.devices": "deploy: {resources: {reservations: {devices: [{driver: x}]}}}",
        }.items()
    },
    "network_mode: host": "the network 'host' ('network_mode')",
    "network_mode: 'service:db'": "the network 'service:db' ('network_mode')",
    "volumes: ['/var/run/docker.sock:/var/run/docker.sock']": "'/var/run/docker.sock' of the host at "
    "'/var/run/docker.sock' ('volumes'); COPY it instead",
    "volumes: ['./data:/data:ro']": "'./data' of the host at '/data' ('volumes'); COPY it instead",
    "volumes: [{type: bind, source: /, target: /host}]": "'/' of the host at '/host' ('volumes'); COPY it instead",
    "volumes: ['/.gem-terminal/../etc:/etc']": "'/.gem-terminal/../etc' of the host at '/etc' ('volumes'); COPY it "
    "instead",
    "deploy: {replicas: 3}": "to run more than once ('deploy.replicas', 'scale')",
    "networks: {default: {aliases: [a, b]}}": "more than one name on the network: a, b",
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_reaches_for_the_host_is_never_granted(tmp_path: Path, text: str) -> None:
    """The task can be read, and says why it cannot be run."""
    found = environment(tmp_path, f"services: {{client: {{build: ., {text}}}}}\n")
    assert found.unsupported == (f"docker-compose.yaml: the service 'client' asks for {REFUSED[text]}",)
    assert found.main.volumes == {}


@pytest.mark.parametrize(
    "text",
    [
        "privileged: false",
        "cap_add: [CAP_NET_BIND_SERVICE, chown]",
        "security_opt: ['no-new-privileges:true']",
        "devices: []",
        "deploy: {resources: {reservations: {memory: 1g}}}",
        "ipc: private",
        "cap_drop: [ALL]",
        "init: true",
        "stdin_open: true",
        "restart: always",
        "container_name: '${T_BENCH_TASK_DOCKER_CLIENT_CONTAINER_NAME}'",
        "x-mine: 1",
    ],
)
def test_what_takes_nothing_from_the_host_is_no_matter(tmp_path: Path, text: str) -> None:
    """Such keys say what is so anyway."""
    compose = f"services: {{client: {{build: ., {text}}}}}\n"
    assert (environment(tmp_path, compose).unsupported, notes(tmp_path, compose)) == ((), ())


def test_volumes_and_networks_of_the_host_are_refused(tmp_path: Path) -> None:
    """A volume with a driver's options may be any folder of the host."""
    compose = """
services: {client: {build: ., volumes: ['a:/a', 'b:/b'], networks: [n]}}
volumes: {a: {external: true}, b: {driver_opts: {type: none, device: /etc, o: bind}}, unused: {external: true}}
networks: {n: {external: true}}
include: [other.yaml]
"""
    assert sorted(environment(tmp_path, compose).unsupported) == [
        "docker-compose.yaml: the network 'n' is one of the host's ('external')",
        "docker-compose.yaml: the volume 'a' is one of the host's ('external', 'driver_opts')",
        "docker-compose.yaml: the volume 'b' is one of the host's ('external', 'driver_opts')",
        "docker-compose.yaml: to include another Compose file ('include')",
    ]


def test_what_is_passed_over_is_noted(tmp_path: Path) -> None:
    """Each with its service."""
    compose = """
services:
  client: {build: ., ports: ['80:80'], environment: [HOME_OF_HOST], volumes: [/cache], networks: [a]}
  web: {image: w, ulimits: {nproc: 5}, depends_on: [client], networks: [b]}
  tool: {image: t, profiles: [debug]}
networks: {a: , b: }
"""
    assert notes(tmp_path, compose) == (
        "the service 'tool': has a profile, and is not started.",
        "its networks are made one, in which all services see each other.",
        "the service 'web': depends on 'client', and is started before it all the same.",
        "the service 'client': 'ports' has no effect.",
        "the service 'client': 'HOME_OF_HOST' would come from the host's environment, and is not set.",
        "the service 'client': the volume without a name at '/cache' is an ordinary folder.",
        "the service 'web': 'ulimits' has no effect.",
    )
