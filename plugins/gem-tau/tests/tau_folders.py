"""Small data folders in the forms of tau-bench and tau2-bench, and where the real one is."""

from __future__ import annotations

import copy
import json
import os
from pathlib import Path
from typing import Any

_FOLDERS = [Path(os.environ.get("GEM_SHARED_DATA", "")), *(each / "shared" / "data" for each in Path(__file__).parents)]
REAL = next((each / "tau_retail" for each in _FOLDERS if (each / "tau_retail").is_dir()), None)
"""The data of tau-bench's retail domain; None where it is not here."""

HOME = {"address1": "1 Oak St", "address2": "", "city": "Reno", "country": "USA", "state": "NV", "zip": "89501"}
WORK = {"address1": "9 Elm St", "address2": "Floor 2", "city": "Reno", "state": "NV", "country": "USA", "zip": "89502"}


def _order(number: int, status: str, items: list[tuple[str, str, float]], paid_by: str) -> dict[str, Any]:
    return {
        "order_id": f"#W{number}",
        "user_id": "ann_lee_1",
        "address": HOME,
        "items": [
            {"name": product, "product_id": product, "item_id": item, "price": price, "options": {"color": item}}
            for product, item, price in items
        ],
        "fulfillments": [],
        "status": status,
        "payment_history": [
            {
                "transaction_type": "payment",
                "amount": sum(price for _, _, price in items),
                "payment_method_id": paid_by,
            }
        ],
    }


def _product(name: str, prices: dict[str, float]) -> dict[str, Any]:
    variants = {
        item: {"item_id": item, "options": {"color": item}, "available": item != "gone", "price": price}
        for item, price in prices.items()
    }
    return {"name": name, "product_id": name, "variants": variants}


_CARD = {"source": "credit_card", "id": "card_1", "brand": "visa", "last_four": "1111"}
_SHOP: dict[str, dict[str, Any]] = {
    "orders": {
        "#W1": _order(1, "pending", [("lamp", "red", 10.1), ("rug", "wool", 20)], "gift_card_1"),
        "#W2": _order(2, "pending", [("lamp", "red", 10.1), ("lamp", "red", 10.1)], "card_1"),
        "#W3": _order(3, "delivered", [("lamp", "red", 10.1), ("rug", "wool", 20)], "card_1"),
    },
    "products": {
        "rug": _product("rug", {"wool": 20, "silk": 500.5}),
        "lamp": _product("lamp", {"red": 10.1, "blue": 12.2, "green": 7.55, "gone": 1.0}),
    },
    "users": {
        "ann_lee_1": {
            "name": {"first_name": "Ann", "last_name": "Lee"},
            "address": HOME,
            "email": "Ann.Lee@example.com",
            "payment_methods": {
                "gift_card_1": {"source": "gift_card", "balance": 5, "id": "gift_card_1"},
                "card_1": _CARD,
                "paypal_1": {"source": "paypal", "id": "paypal_1"},
            },
            "orders": ["#W1", "#W2", "#W3"],
        }
    },
}
CANCEL: dict[str, Any] = {"name": "cancel_pending_order", "kwargs": {"order_id": "#W1", "reason": "no longer needed"}}
MOVE: dict[str, Any] = {"name": "modify_user_address", "kwargs": {"user_id": "ann_lee_1", **WORK}}


def tau_task(*actions: dict[str, Any], outputs: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return a task as tau-bench's files have it."""
    return {"user_id": "ann_lee_1", "instruction": "You are Ann.", "actions": actions, "outputs": outputs}


def write_tau(folder: Path, *tasks: dict[str, Any]) -> Path:
    """Write a shop in tau-bench's form, with tasks of the split ``test``; by default one of one write."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, records in _SHOP.items():
        (folder / f"{name}.json").write_text(json.dumps(records))
    (folder / "policy.md").write_text("Be kind.")
    (folder / "tasks_test.json").write_text(json.dumps(tasks or [tau_task(CANCEL)]))
    return folder


def tau2_task(task_id: str, *actions: dict[str, Any], **criteria: Any) -> dict[str, Any]:
    """Return a task as tau2-bench's files have it."""
    instructions = {"domain": "retail", "reason_for_call": "A lamp.", "known_info": None, "task_instructions": "Nod."}
    calls = [{"action_id": "0", "name": each["name"], "arguments": each["kwargs"]} for each in actions]
    return {
        "id": task_id,
        "user_scenario": {"persona": None, "instructions": instructions},
        "initial_state": None,
        "evaluation_criteria": {"actions": calls, **criteria},
    }


def write_tau2(folder: Path, *tasks: dict[str, Any], database: dict[str, Any] | None = None) -> Path:
    """Write a shop, or another database, in tau2-bench's form, with a split ``test`` of its first task."""
    if database is None:
        database = copy.deepcopy(_SHOP)
        for user_id, user in database["users"].items():
            user["user_id"] = user_id
    tasks = tasks or (tau2_task("a", CANCEL),)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "db.json").write_text(json.dumps(database))
    (folder / "policy.md").write_text("Be kind.")
    (folder / "tasks.json").write_text(json.dumps(tasks))
    (folder / "split_tasks.json").write_text(json.dumps({"test": [tasks[0]["id"]]}))
    return folder


def _flight(number: str, leaves: str, arrives: str, **dates: dict[str, Any]) -> dict[str, Any]:
    origin, destination = number.split("-")
    return {
        "flight_number": number,
        "origin": origin,
        "destination": destination,
        "scheduled_departure_time_est": leaves,
        "scheduled_arrival_time_est": arrives,
        "dates": {f"2024-05-{day[1:]}": flight for day, flight in dates.items()},
    }


def _bookable(seats: int, price: int) -> dict[str, Any]:
    cabins = ("business", "economy", "basic_economy")
    return {
        "status": "available",
        "available_seats": dict.fromkeys(cabins, seats),
        "prices": dict.fromkeys(cabins, price),
    }


AIRLINE: dict[str, Any] = {
    "flights": {
        "SFO-DEN": _flight("SFO-DEN", "06:00:00", "09:00:00", d20=_bookable(2, 100), d21={"status": "cancelled"}),
        "DEN-JFK": _flight("DEN-JFK", "10:00:00", "15:00:00", d20=_bookable(2, 150), d21=_bookable(0, 170)),
    },
    "users": {
        "ann_lee_1": {
            "user_id": "ann_lee_1",
            "name": {"first_name": "Ann", "last_name": "Lee"},
            "address": HOME,
            "email": "ann@example.com",
            "dob": "1990-01-01",
            "payment_methods": {
                "card_1": _CARD,
                "gift_card_1": {"source": "gift_card", "id": "gift_card_1", "amount": 200},
                "certificate_1": {"source": "certificate", "id": "certificate_1", "amount": 50},
            },
            "saved_passengers": [],
            "membership": "gold",
            "reservations": [],
        }
    },
    "reservations": {},
}
