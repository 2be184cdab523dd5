"""A tiny OpenAI-compatible server with a scripted model, to try the whole path without a network, a key or a GPU.

In one command: start it on a free port, tell the agent where it is, and run::

    python examples/scripted_server.py --run "gem run game:GuessTheNumber-v0 --agent openai:scripted"

Or start it alone, and ask it from elsewhere::

    python examples/scripted_server.py --port 8000
    gem run game:GuessTheNumber-v0 --agent openai:scripted --base-url http://127.0.0.1:8000/v1

The model bisects GuessTheNumber from the hints that it reads in the conversation, calls the first tool that it is
offered once, and answers anything else with a fixed text.

Standard library only. It listens on this machine alone.
"""

from __future__ import annotations

import argparse
import http.server
import json
import os
import re
import shlex
import subprocess
import sys
import threading
import time

MODEL = "scripted"


# The model: a function of the conversation.


def answer(messages, tools):
    """Return the text that comes next, and the tool calls."""
    text = "\n".join(text_of(message) for message in messages)
    if tools and not has_used_a_tool(messages, text):
        return "Let me see what the tool says.", [example_call(tools[0]["function"])]
    if "Guess the Number" in text or "The number is from" in text:
        return guess(text), []
    return r"I am a script, and I say \boxed{42}.", []


def guess(text):
    """Bisect: every hint of the conversation narrows the range."""
    low, high = map(int, re.findall(r"from (-?\d+) to (-?\d+)", text)[-1])
    for hint, number in re.findall(r"(higher|lower) than (-?\d+)", text):
        if hint == "higher":
            low = max(low, int(number) + 1)
        else:
            high = min(high, int(number) - 1)
    middle = (low + high) // 2
    return f"It is from {low} to {high}, so I try the middle: \\boxed{{{middle}}}"


def has_used_a_tool(messages, text):
    """Tell whether a result is in the conversation already, as a message of its own or in a user's text."""
    return any(message.get("role") == "tool" for message in messages) or "Output of" in text or "Error from" in text


def example_call(function):
    """Return a call with a value of the right type for each required argument."""
    schema = function.get("parameters", {})
    examples = {"string": "print(6 * 7)", "integer": 6, "number": 7.0, "boolean": True, "array": [], "object": {}}
    properties = schema.get("properties", {})
    arguments = {name: examples.get(properties[name].get("type"), 1) for name in schema.get("required", properties)}
    called = {"name": function["name"], "arguments": json.dumps(arguments)}
    return {"id": "call_0", "type": "function", "function": called}


def text_of(message):
    """Return the text of a message, images left out."""
    content = message.get("content") or ""
    return content if isinstance(content, str) else "\n".join(part.get("text", "") for part in content)


# The protocol: https://platform.openai.com/docs/api-reference/chat.


def completion(request):
    """Return the answer to a request of the chat API."""
    text, calls = answer(request["messages"], request.get("tools"))
    message = {"role": "assistant", "content": text}
    if calls:
        message["tool_calls"] = calls
    read = sum(len(text_of(message).split()) for message in request["messages"])
    return {
        "id": "chatcmpl-0",
        "object": "chat.completion",
        "created": int(time.time()),
        "model": request["model"],
        "choices": [{"index": 0, "message": message, "finish_reason": "tool_calls" if calls else "stop"}],
        "usage": {
            "prompt_tokens": read,
            "completion_tokens": len(text.split()),
            "total_tokens": read + len(text.split()),
        },
    }


def chunks(whole, with_usage):
    """Cut a completion into the pieces of a stream."""
    head = {"id": whole["id"], "object": "chat.completion.chunk", "created": whole["created"], "model": whole["model"]}
    (choice,) = whole["choices"]
    pieces = [{"role": "assistant"}] + [
        {"content": word} for word in re.findall(r"\S+\s*", choice["message"]["content"])
    ]
    for index, call in enumerate(choice["message"].get("tool_calls", [])):
        arguments = call["function"]["arguments"]
        opened = {**call, "index": index, "function": {"name": call["function"]["name"], "arguments": ""}}
        rest = [{"index": index, "function": {"arguments": part}} for part in (arguments[:5], arguments[5:])]
        pieces += [{"tool_calls": [piece]} for piece in (opened, *rest)]
    for delta in pieces:
        yield {**head, "choices": [{"index": 0, "delta": delta, "finish_reason": None}]}
    yield {**head, "choices": [{"index": 0, "delta": {}, "finish_reason": choice["finish_reason"]}]}
    if with_usage:
        yield {**head, "choices": [], "usage": whole["usage"]}


class Handler(http.server.BaseHTTPRequestHandler):
    """Answers the two addresses of the API that an agent needs."""

    protocol_version = "HTTP/1.1"  # connections stay open
    disable_nagle_algorithm = True

    def do_GET(self):
        """List the models."""
        if self.path != "/v1/models":
            return self.refuse(404, "there is /v1/models and /v1/chat/completions")
        return self.send(200, {"object": "list", "data": [{"id": MODEL, "object": "model", "owned_by": "nobody"}]})

    def do_POST(self):
        """Answer a chat."""
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if self.path != "/v1/chat/completions":
            return self.refuse(404, "there is /v1/models and /v1/chat/completions")
        try:
            request = json.loads(body)
            whole = completion(request)
        except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
            return self.refuse(400, f"this is no request of the chat API: {type(error).__name__}: {error}")
        if request["model"] != MODEL:
            return self.refuse(404, f"the model {request['model']!r} does not exist; there is {MODEL!r}")
        if request.get("stream"):
            return self.send_stream(whole, request)
        return self.send(200, whole)

    def send_stream(self, whole, request):
        """Send server-sent events."""
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Connection", "close")
        self.end_headers()
        self.close_connection = True
        events = [json.dumps(chunk) for chunk in chunks(whole, bool(request.get("stream_options")))] + ["[DONE]"]
        for event in events:
            self.wfile.write(f"data: {event}\n\n".encode())

    def refuse(self, status, message):
        """Send an error as OpenAI does."""
        self.send(status, {"error": {"message": message, "type": "error", "param": None, "code": None}})

    def send(self, status, content):
        """Send JSON."""
        body = json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *arguments):
        """Say nothing for each request."""


class Server(http.server.ThreadingHTTPServer):
    """A thread for each connection."""

    daemon_threads = True
    request_queue_size = 256  # connections that may wait to be accepted


def main():
    """Serve, or serve as long as a command runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=0, help="0 takes a free one")
    parser.add_argument("--run", metavar="COMMAND", help="run this with OPENAI_BASE_URL set, and stop when it ends")
    options = parser.parse_args()
    server = Server(("127.0.0.1", options.port), Handler)
    address = f"http://127.0.0.1:{server.server_port}/v1"
    if options.run is None:
        print(f"the model {MODEL!r} is at {address} (Ctrl-C stops it)", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return 0
    threading.Thread(target=server.serve_forever, daemon=True).start()
    # The commands of this interpreter's environment come first, so that 'gem' is the one installed here.
    path = os.pathsep.join([os.path.dirname(sys.executable), os.environ.get("PATH", "")])
    environment = {**os.environ, "OPENAI_BASE_URL": address, "PATH": path}
    command = shlex.split(options.run)
    try:
        return subprocess.run(command, env=environment, check=False).returncode
    except FileNotFoundError:
        return f"there is no command {command[0]!r}; install gem-core into this interpreter's environment"


if __name__ == "__main__":
    sys.exit(main())
