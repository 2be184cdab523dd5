"""Assistants of ``tau:Sample`` that act by rules: they read what the user says and what their tools return."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from gem_core import Response
from gem_core.errors import AgentError, ArgumentError

if TYPE_CHECKING:
    from gem_core.rollouts import Context
    from gem_core.types import Observation

_WISHES = {
    "address": r"\bchange (?:the|my) address\b",
    "cancel": r"\bcancel\b",
    "return": r"\breturn\b|\bsend back\b",
    "swap": r"\bswap\b|\bexchange\b",
    "total": r"\btotal\b|\bcosts?\b",
}
_EMAIL = re.compile(r"(?<![\w.+-])[\w.+-]+@[\w-]+\.[\w.]{0,200}\w")
_NUMBER = re.compile(r"#\d{4}")
_ADDRESS = re.compile(r"\b\d{1,5} [^\W\d_][\w ]{0,60}, [^\W\d_][\w ]{0,60} \d{4,5}")
_REASON = re.compile(r"no longer needed|ordered by mistake", re.IGNORECASE)
_REFUND = re.compile(r"gift card|original payment", re.IGNORECASE)
_PRODUCT = re.compile(r"helmet|bell|floor pump|saddle|light set", re.IGNORECASE)
_COLOUR = re.compile(r"red|blue|black|brass|grey|brown|white|green", re.IGNORECASE)

_SORRY = "I am sorry, that cannot be done."
_MORE = "Is there anything else that I can do for you?"


class Call(NamedTuple):
    """A call of a tool."""

    name: str
    arguments: dict[str, str]


class Plan(NamedTuple):
    """A change that an assistant is about to make."""

    words: str
    """What a customer is asked to agree to."""

    call: Call


class UnknownYetError(Exception):
    """The assistant needs the result of a call before it can go on."""

    def __init__(self, call: Call) -> None:
        super().__init__(call.name)
        self.call = call


class Talk:
    """What an assistant knows: what was said, and what its tools returned.

    Args:
        messages: What the agent is sent.
    """

    def __init__(self, messages: list[dict[str, Any]]) -> None:
        self.heard: list[str] = []
        self.said: list[str] = []
        self.wish: str | None = None
        self.text = ""  # all that the user said since telling the present wish
        self.worked: bool | None = None  # whether the last change for this wish did; None before one is tried
        self._results: dict[str, Any] = {}
        calls: dict[str, Any] = {}
        for message in messages:
            content = str(message.get("content") or "")
            if message["role"] == "user":
                self._hear(content)
            elif message["role"] == "assistant":
                self.said += [content] if content else []
                calls |= {call["id"]: call["function"] for call in message.get("tool_calls") or ()}
            elif message["role"] == "tool":
                self._read_result(calls[message["tool_call_id"]], content)

    def _hear(self, text: str) -> None:
        self.heard.append(text)
        wish = next((name for name, words in _WISHES.items() if re.search(words, text, re.IGNORECASE)), None)
        if wish is not None:
            self.wish, self.text, self.worked = wish, "", None
        self.text += f"\n{text}"

    def _read_result(self, called: dict[str, str], content: str) -> None:
        failed = content.startswith(("Error: ", "The call could not"))
        self._results[called["name"] + called["arguments"]] = None if failed else json.loads(content)
        if called["name"] in ("cancel_order", "return_item", "swap_item", "change_address"):
            self.worked = not failed

    def look_up(self, name: str, **arguments: str) -> Any:
        """Return the record that a tool returned; None where it failed.

        Raises:
            UnknownYetError: It was not called yet.
        """
        key = name + json.dumps(arguments)
        if key not in self._results:
            raise UnknownYetError(Call(name, arguments))
        return self._results[key]

    def last(self, pattern: re.Pattern[str]) -> str | None:
        """Return what a pattern matches last in what the user said."""
        return _last(pattern, "\n".join(self.heard))

    def detail(self, pattern: re.Pattern[str]) -> str | None:
        """Return a detail of the present wish, in small letters where it is a word of the shop."""
        found = _last(pattern, self.text)
        return found.lower() if found and pattern is not _ADDRESS else found


def _last(pattern: re.Pattern[str], text: str) -> str | None:
    found = pattern.findall(text)
    return found[-1] if found else None


def careful(talk: Talk) -> str | Call:
    """Identify the customer, look everything up, keep the policy, ask for a yes, then act."""
    if talk.wish is None:
        return "Hello! What can I do for you?"
    if talk.worked is not None:
        return f"{'Done.' if talk.worked else _SORRY} {_MORE}"
    email = talk.last(_EMAIL)
    if email is None:
        return f"What is the email address of your account{'' if talk.last(_NUMBER) else ', and the order number'}?"
    customer = talk.look_up("find_customer", email=email)
    if customer is None:
        return f"I find no account with {email}. What is the right email address?"
    order = _order_of(talk, customer)
    if isinstance(order, str):
        return order
    order_id = order["order_id"]
    if talk.wish == "total":
        return f"Order {order_id} comes to {order['total']}. {_MORE}"
    if order["status"] != _STATUS[talk.wish]:
        return f"I am sorry, that cannot be done: order {order_id} is {order['status']}. {_MORE}"
    plan = _PLANNERS[talk.wish](talk, order, guess=False)
    if isinstance(plan, str):
        return plan
    question = f"I will {plan.words}. Is that right? Please answer yes or no."
    agreed = talk.said[-1:] == [question] and talk.heard[-1].lower().startswith("yes")
    return plan.call if agreed else question


def hasty(talk: Talk) -> str | Call:
    """Act at once on what was said, and guess the rest."""
    if talk.wish is None:
        return "What do you want?"
    if talk.worked is not None:
        return "Done." if talk.worked else _SORRY
    order_id = talk.last(_NUMBER)
    if order_id is None:
        email = talk.last(_EMAIL)
        if email is None:
            return "What is your email address?"
        customer = talk.look_up("find_customer", email=email)
        if customer is None:
            return _SORRY
        order_id = customer["orders"][0]
    order = talk.look_up("get_order", order_id=order_id)
    if order is None:
        return _SORRY
    if talk.wish == "total":
        return f"It comes to {order['total']}."
    plan = _PLANNERS[talk.wish](talk, order, guess=True)
    return plan if isinstance(plan, str) else plan.call


def passive(talk: Talk) -> str | Call:
    """Talk, then hand over to a human."""
    lines = ("Thank you for your message. Please tell me more about it.", "I understand, and I am looking into it.")
    if len(talk.said) < len(lines):
        return lines[len(talk.said)]
    return Call("hand_over", {"summary": talk.heard[0]})


def _order_of(talk: Talk, customer: dict[str, Any]) -> dict[str, Any] | str:
    """Return the order that the customer means, or what to ask."""
    order_id = talk.last(_NUMBER)
    if order_id is not None:
        order: dict[str, Any] | None = talk.look_up("get_order", order_id=order_id)
        if order is None or order_id not in customer["orders"]:
            return f"There is no order {order_id} in your account. What is the right order number?"
        return order
    if "not know" not in talk.text:
        return "What is the order number?"
    orders = [talk.look_up("get_order", order_id=each) for each in customer["orders"]]
    product = talk.detail(_PRODUCT)
    if product is None:
        return "Which item is in it?"
    fitting: list[dict[str, Any]] = [
        order
        for order in orders
        if order["status"] == _STATUS.get(str(talk.wish), order["status"])
        and any(item["product"] == product for item in order["items"])
    ]
    if len(fitting) == 1:
        return fitting[0]
    return "I cannot tell which of your orders that is. What is the order number?"


def _cancel(talk: Talk, order: dict[str, Any], *, guess: bool) -> Plan | str:
    reason = talk.detail(_REASON) or ("no longer needed" if guess else None)
    if reason is None:
        return "What is the reason: is it no longer needed, or was it ordered by mistake?"
    order_id = order["order_id"]
    call = Call("cancel_order", {"order_id": order_id, "reason": reason})
    return Plan(f"cancel order {order_id}, with the reason '{reason}'", call)


def _move(talk: Talk, order: dict[str, Any], *, guess: bool) -> Plan | str:
    address = talk.detail(_ADDRESS)
    if address is None:
        return "What is the new address?"
    order_id = order["order_id"]
    call = Call("change_address", {"order_id": order_id, "address": address})
    return Plan(f"send order {order_id} to {address}", call)


def _take_back(talk: Talk, order: dict[str, Any], *, guess: bool) -> Plan | str:
    item = _item_of(talk, order, guess=guess)
    if item is None:
        return "Which item of the order is it?"
    if item["final_sale"] and not guess:
        return f"I am sorry, that cannot be done: the {item['product']} was a final sale. {_MORE}"
    refund = talk.detail(_REFUND) or ("original payment" if guess else None)
    if refund is None:
        return "Where should the money go: to the original payment, or to a gift card?"
    order_id = order["order_id"]
    call = Call("return_item", {"order_id": order_id, "item_id": item["item_id"], "refund_to": refund})
    return Plan(f"take back the {item['product']} of order {order_id}, and send the money to the {refund}", call)


def _swap(talk: Talk, order: dict[str, Any], *, guess: bool) -> Plan | str:
    item = _item_of(talk, order, guess=guess)
    if item is None:
        return "Which item of the order is it?"
    product = talk.look_up("get_product", product=item["product"])
    others = [each for each in product["variants"].values() if each["item_id"] != item["item_id"]]
    colour = talk.detail(_COLOUR) or (others[0]["colour"] if guess and others else None)
    if colour is None:
        return "Which colour would you like instead?"
    variant = next((each for each in others if each["colour"] == colour), None)
    if variant is None or (not variant["stock"] and not guess):
        return f"I am sorry, that cannot be done: there is none in {colour}. {_MORE}"
    order_id = order["order_id"]
    arguments = {"order_id": order_id, "item_id": item["item_id"], "new_item_id": variant["item_id"]}
    return Plan(f"swap the {item['product']} of order {order_id} for one in {colour}", Call("swap_item", arguments))


def _item_of(talk: Talk, order: dict[str, Any], *, guess: bool) -> dict[str, Any] | None:
    product = talk.detail(_PRODUCT)
    named = [item for item in order["items"] if item["product"] == product]
    if not named and (guess or len(order["items"]) == 1):
        named = order["items"]
    return dict(named[0]) if named else None


_STATUS = {"address": "pending", "cancel": "pending", "return": "delivered", "swap": "pending"}
_PLANNERS = {"address": _move, "cancel": _cancel, "return": _take_back, "swap": _swap}

_CHARACTERS: dict[str, Callable[[Talk], str | Call]] = {"careful": careful, "hasty": hasty, "passive": passive}
CHARACTERS = tuple(_CHARACTERS)


class ScriptedAssistant:
    """An assistant of ``tau:Sample``, by rules; it calls tools natively.

    ``careful`` keeps the policy: it identifies the customer, asks for what is missing, reads back what it will do, and
    asks for further wishes. ``hasty`` acts on the first guess. ``passive`` talks, and hands over.

    Args:
        character: ``careful``, ``hasty`` or ``passive``.

    Raises:
        ArgumentError: There is no such character.
    """

    reads = "messages"
    native_tools = True

    def __init__(self, character: str = "careful") -> None:
        if character not in _CHARACTERS:
            raise ArgumentError(f"there is no tau-assistant:{character}; there are: {', '.join(_CHARACTERS)}")
        self._act = _CHARACTERS[character]

    def __call__(self, observation: Observation, context: Context) -> Response:
        """Say something, or call a tool."""
        if context.seat == "user":
            raise AgentError("a tau-assistant plays only the assistant, as in --agent assistant=tau-assistant:careful")
        try:
            act = self._act(Talk(context.messages))
        except UnknownYetError as missing:
            act = missing.call
        if isinstance(act, str):
            return Response(act)
        function = {"name": act.name, "arguments": json.dumps(act.arguments)}
        return Response("", tool_calls=[{"id": f"call_{context.turn}", "type": "function", "function": function}])
