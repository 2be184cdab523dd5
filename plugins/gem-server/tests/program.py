"""A program that asks a model by one of three APIs, and acts: what an agent of somebody's own is like.

    python program.py API [how]

It uses the standard library alone. ``how``: ``streamed``; ``forgets`` shows the model only the newest observation;
``prints`` prints the first reply instead of acting; ``leaves`` ends after one reply; ``hangs`` waits for ever after it.
"""

import json
import os
import sys
import time
import urllib.request

API, HOW = sys.argv[1], sys.argv[2:]
KEY = os.environ["OPENAI_API_KEY"]


def post(url, body):
    headers = {"authorization": f"Bearer {KEY}", "x-api-key": KEY, "content-type": "application/json"}
    return urllib.request.urlopen(urllib.request.Request(url, json.dumps(body).encode(), headers)).read().decode()


def events(text):
    return [json.loads(line[6:]) for line in text.splitlines() if line.startswith("data: ") and line != "data: [DONE]"]


def ask(history):
    streamed = "streamed" in HOW
    if API == "chat":
        body = {"model": "m", "messages": [{"role": "system", "content": "Play."}, *history], "stream": streamed}
        text = post(os.environ["OPENAI_BASE_URL"] + "/chat/completions", body)
        if streamed:
            return "".join(each["choices"][0]["delta"].get("content", "") for each in events(text))
        return json.loads(text)["choices"][0]["message"]["content"]
    if API == "responses":
        body = {"model": "m", "instructions": "Play.", "input": history, "stream": streamed}
        text = post(os.environ["OPENAI_BASE_URL"] + "/responses", body)
        if streamed:
            return "".join(e["delta"] for e in events(text) if e["type"] == "response.output_text.delta")
        return json.loads(text)["output"][0]["content"][0]["text"]
    body = {"model": "m", "system": "Play.", "max_tokens": 9, "messages": history, "stream": streamed}
    text = post(os.environ["ANTHROPIC_BASE_URL"] + "/v1/messages", body)
    if streamed:
        return "".join(e["delta"]["text"] for e in events(text) if e["type"] == "content_block_delta")
    return json.loads(text)["content"][0]["text"]


history = [{"role": "user", "content": os.environ["GEM_INSTRUCTION"]}]
while True:
    reply = ask(history)
    if "prints" in HOW:
        sys.stdout.write(reply)
    if "hangs" in HOW:
        time.sleep(600)
    if {"prints", "leaves"} & set(HOW):
        break
    told = json.loads(post(os.environ["GEM_ACT_URL"], {"action": reply}))
    if told["over"]:
        break
    seen = {"role": "user", "content": told["observation"]}
    history = [seen] if "forgets" in HOW else [*history, {"role": "assistant", "content": reply}, seen]
