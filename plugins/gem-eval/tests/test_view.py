"""What gem view answers: ranges of a table, episodes, images, events; and what it does not."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from PIL import Image
from recorded import HOSTILE, broken, duel, failed, hostile, maze
from starlette.testclient import TestClient

from gem_core import Episode, write_episodes
from gem_core.cli import main
from gem_core.errors import ArgumentError
from gem_eval.records import RunWriter
from gem_eval.show.text import escaped
from gem_eval.viewing.app import make_app
from gem_eval.viewing.library import Library


def write_run(path: Path, played: list[Episode], **info: Any) -> Path:
    """Write a run, with what a server reports of each episode."""
    with RunWriter(path) as writer:
        writer.write_info(info)
        for number, episode in enumerate(played):
            episode.key = str(number)
            evaluation = {"model": "one" if number % 2 else "two", "row": f"{episode.id}/{episode.seed}"}
            writer.write(episode, {**evaluation, "seconds": 1.0 + number, "cost": 0.01 * number, "finished": 1.0})
    return path


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder with a run of five episodes and a file of three."""
    picture = Image.new("RGB", (8, 8), (200, 40, 40))
    write_run(tmp_path / "runs" / "first", [maze(), failed(), broken(), hostile(), maze(picture)], status="finished")
    write_episodes(tmp_path / "runs" / "second.jsonl", [maze(), duel(), failed(seed=9)])
    return tmp_path / "runs"


def library_of(*paths: Path) -> Library:
    """A library that has read all there is."""
    library = Library(paths)
    while library.read():
        pass
    return library


@pytest.fixture
def client(runs: Path) -> TestClient:
    """A client of the two runs."""
    return TestClient(make_app(library_of(runs)), base_url="http://127.0.0.1")


def numbers(client: TestClient, parameters: str) -> list[tuple[str, int]]:
    """The episodes of a table."""
    return [(row["run"], row["number"]) for row in client.get(f"/api/rows?{parameters}").json()["rows"]]


def test_the_runs_are_listed_with_their_scores(client: TestClient) -> None:
    """By model and task, with the interval, and how many episodes there are."""
    first, second = client.get("/api/runs").json()
    assert (first["name"], first["episodes"], first["status"], first["live"]) == ("first", 5, "finished", False)
    assert (second["name"], second["episodes"]) == ("second.jsonl", 3)
    success = [score for score in first["scores"] if score["metric"] == "success" and score["id"] == "maze:Room-v0"]
    assert {score["model"]: score["mean"] for score in success} == {"two": 1.0, "one": 0.0}


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ("", [1, 2, 3, 4, 5]),
        ("outcome=error&outcome=failure", [2, 3]),
        ("outcome=unscored", [4]),
        ("model=one&outcome=failure", [2]),
        ("id=chat:Talk-v0", [3]),
        ("reason=timeout", [3]),
        ("text=no%20ANSWER", [3]),
        ("row=maze:Room-v0/7", [1, 2, 5]),
        ("return=>0.2, <0.5", [2]),
        ("tokens=>100&seconds=<2.5&cost=>=0.01", [2]),
        ("sort=return", [3, 4, 2, 1, 5]),
        ("sort=return&reverse=1", [1, 5, 2, 3, 4]),
        ("sort=tokens&reverse=1", [1, 2, 5, 3, 4]),
        ("sort=outcome", [3, 2, 1, 5, 4]),
        ("reverse=1", [5, 4, 3, 2, 1]),
        ("start=1&count=2", [2, 3]),
    ],
)
def test_the_table_is_filtered_sorted_and_cut(client: TestClient, parameters: str, expected: list[int]) -> None:
    """By the server; what has no value in a column comes last either way."""
    assert numbers(client, f"run=first&{parameters}") == [("first", number) for number in expected]


def test_several_runs_stand_in_one_table(client: TestClient) -> None:
    """Their episodes of one row are found together, and the place of one is told."""
    assert len(numbers(client, "")) == 8
    assert numbers(client, "row=duel:Words-v0/4") == [("second.jsonl", 2)]
    answer = client.get("/api/rows?sort=number&reverse=1&count=1&at=second.jsonl/3").json()
    assert (answer["total"], answer["at"], len(answer["rows"])) == (8, 3, 1)
    assert answer["summary"]["errors"] == 1
    assert answer["choices"]["outcomes"][:3] == [["success", 3], ["failure", 2], ["split", 1]]


def test_what_cannot_be_answered_is_refused_in_one_line(client: TestClient) -> None:
    for parameters in ("return=much", "start=-1", "run=third", "start=9999999999999999999"):
        answer = client.get(f"/api/rows?{parameters}")
        assert (answer.status_code, "\n" in answer.text) == (400, False)


def test_an_episode_is_sent_as_data(client: TestClient) -> None:
    """Turn by turn, with rewards; one of several agents as well."""
    data = client.get("/api/episode?run=first&number=1").json()
    assert [turn["reward"] for turn in data["turns"]] == [0.25, -0.5, 1.0]
    assert (data["row"], data["outcome"], data["seconds"]) == ("maze:Room-v0/7", "success", 1.0)
    joint = client.get("/api/episode?run=second.jsonl&number=2").json()
    assert [turn["seat"] for turn in joint["turns"]][:2] == ["white (openai:tiny)", "black (random)"]
    assert client.get("/api/episode?run=first&number=99").status_code == 400


def test_images_come_from_the_folder_of_the_run_alone(client: TestClient, runs: Path) -> None:
    """By the name that is a hash; what is no such name is not looked for."""
    (image,) = (runs / "first" / "images").iterdir()
    answer = client.get(f"/api/image?run=first&name={image.name}")
    assert (answer.headers["content-type"], answer.content[:4]) == ("image/png", b"\x89PNG")
    secret = runs / "first" / "images" / "secret.png"
    secret.write_bytes(image.read_bytes())
    for name in ("secret.png", f"../images/{image.name}", f"{runs}/first/images/{image.name}", "../run.json", "", "\0"):
        assert client.get("/api/image", params={"run": "first", "name": name}).status_code == 422
    assert client.get(f"/api/image?run=../first&name={image.name}").status_code == 400
    for path in ("/../run.json", "/%2e%2e/run.json", "/assets/view.js", "/first/run.json"):
        assert client.get(path).status_code == 404


def test_texts_of_others_are_escaped(client: TestClient) -> None:
    """In rows, episodes and the list of runs: what a browser would obey or hide stands as its code."""
    for address in ("/api/rows", "/api/episode?run=first&number=4", "/api/runs"):
        text = client.get(address).text
        assert escaped(HOSTILE) in "".join(_texts(json.loads(text)))
        assert not re.search(r"\\u(202e|d800|001b)", text.replace("\\\\", ""))


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for part in [*value, *value.values()] if isinstance(value, dict) else value:
            yield from _texts(part)


def test_only_this_machine_is_answered_and_only_its_own_scripts_run(client: TestClient) -> None:
    """A page of another site whose name points here is refused, as is whatever would write."""
    page = client.get("/")
    assert "script-src 'self'; style-src 'self'" in page.headers["content-security-policy"]
    assert not re.search(r"<script>|<style|\son\w+=|https?:|style=", page.text)
    for host in ("evil.example", "127.0.0.1.evil.example", ""):
        assert client.get("/api/runs", headers={"host": host}).status_code == 400
    assert client.get("/api/runs", headers={"host": "localhost:8600"}).status_code == 200
    for method in ("POST", "PUT", "DELETE"):
        assert client.request(method, "/api/rows").status_code == 405


def test_scripts_never_read_text_as_html() -> None:
    """Nor do they reach the network, or run text."""
    folder = Path(__file__).parent.parent / "gem_eval" / "assets"
    for path in folder.glob("*.js"):
        text = path.read_text("utf-8")
        assert not re.search(r"innerHTML|outerHTML|insertAdjacent|document\.write|\beval\(|new Function|import\(", text)
        assert {*re.findall(r"https?://[^\s\"']+", text)} <= {"http://www.w3.org/2000/svg"}


def test_transcripts_are_searched_as_a_stream(client: TestClient) -> None:
    """In what the table has, with an excerpt; a damaged episode is passed over."""
    lines = client.get("/api/search?wanted=night%20FALLS").text.splitlines()
    told = [json.loads(line) for line in lines]
    found = [row for each in told for row in each["found"]]
    assert [(row["run"], row["number"], row["excerpt"]) for row in found] == [
        ("first", 2, "Night falls."),
        ("second.jsonl", 3, "Night falls."),
    ]
    assert (told[-1]["done"], told[-1]["of"], told[-1]["full"]) == (8, 8, False)
    assert len(client.get("/api/search?wanted=night&outcome=success").text.splitlines()) == 2


def test_a_run_is_followed_as_it_grows_and_begins_anew(tmp_path: Path) -> None:
    """New rows, new scores, new runs in the folder, and another run in the place of one."""
    write_run(tmp_path / "run", [maze()], status="running", episodes=2)
    library = library_of(tmp_path)
    (viewed,) = library.runs
    assert (viewed.summary["live"], viewed.summary["planned"]) == (False, 2)
    with RunWriter(tmp_path / "run") as writer:
        episode = failed()
        episode.key = "1"
        writer.write(episode, {"model": "two"})
    library.read()
    assert (viewed.version, len(viewed.rows), viewed.summary["live"]) == (2, 2, True)
    # Computing scores may not take up the time, and is put off.
    while sum(score["episodes"] for score in viewed.summary["scores"] if score["metric"] == "success") < 2:
        library.read()
    (tmp_path / "run" / "index.jsonl").write_text("")
    library.read()
    assert viewed.rows == []


def test_runs_are_found_and_told_apart(tmp_path: Path, runs: Path) -> None:
    """By their folders if their names are the same; a damaged episode is refused, the others are not."""
    one, other = (write_run(tmp_path / folder / "run", [maze()]) for folder in ("a", "b"))
    assert [viewed.name for viewed in library_of(one, other).runs] == ["run", "b/run"]
    with pytest.raises(ArgumentError):
        Library([tmp_path])
    path = runs / "first" / "episodes.jsonl.zst"
    content = bytearray(path.read_bytes())
    content[20] ^= 0xFF
    path.write_bytes(content)
    client = TestClient(make_app(library_of(runs)), base_url="http://127.0.0.1")
    assert [client.get(f"/api/episode?run=first&number={number}").status_code for number in (1, 2)] == [422, 200]


@contextmanager
def served(*paths: Path) -> Iterator[str]:
    """Serve runs, and give the address."""
    library = Library(paths)
    config = uvicorn.Config(make_app(library, lambda: server.should_exit), port=0, log_level="error", lifespan="off")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    library.start()
    while not server.started:
        thread.join(0.01)
    try:
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}/"
    finally:
        server.should_exit = True
        thread.join()
        library.stop()


def test_a_port_that_is_taken_is_an_error(runs: Path) -> None:
    """With exit code 2."""
    with served(runs) as address, pytest.raises(SystemExit) as caught:
        main(["view", str(runs), "--port", address.split(":")[-1].strip("/")])
    assert caught.value.code == 2


def test_ctrl_c_ends_it_quietly(runs: Path) -> None:
    """Also while a page is open."""
    command = [sys.executable, "-m", "gem_core", "view", str(runs)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ})
    assert process.stdout is not None
    port = int(re.findall(r"http://127\.0\.0\.1:(\d+)/", process.stdout.readline())[0])
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request("GET", "/api/runs")
    assert connection.getresponse().status == 200
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (0, "")
    connection.close()
