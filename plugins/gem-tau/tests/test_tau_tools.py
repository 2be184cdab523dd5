"""What the tools do to a database and answer: tau-bench's retail shop, and where tau2-bench's differs."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from tau_folders import AIRLINE, HOME, WORK, write_tau, write_tau2

from gem_tau import Database, TaskSet, fork, read_folder

ITEMS = {"order_id": "#W2", "item_ids": ["red", "red"], "new_item_ids": ["green", "blue"]}


class Shop:
    """A database, and its tools as methods that return what the assistant reads, parsed where it is JSON."""

    def __init__(self, task_set: TaskSet) -> None:
        self.task_set = task_set
        self.database: Database = fork(task_set.database)

    def __call__(self, name: str, **arguments: Any) -> Any:
        answer = self.task_set.domain.call(self.database, name, arguments)
        try:
            return json.loads(answer)
        except ValueError:
            return answer

    def balance(self, payment_id: str = "gift_card_1") -> float:
        method = self.database["users"]["ann_lee_1"]["payment_methods"][payment_id]
        return float(method.get("balance", method.get("amount")))


@pytest.fixture
def shop(tmp_path: Path) -> Shop:
    """tau-bench's."""
    return Shop(read_folder(write_tau(tmp_path)))


@pytest.fixture
def shop2(tmp_path: Path) -> Shop:
    """tau2-bench's."""
    return Shop(read_folder(write_tau2(tmp_path)))


@pytest.fixture
def airline(tmp_path: Path) -> Shop:
    """tau2-bench's."""
    return Shop(read_folder(write_tau2(tmp_path, database=AIRLINE)))


def test_a_cancelled_order_is_refunded_to_its_gift_card(shop: Shop) -> None:
    """The balance is rounded to cents, and the answer is the order with its new fields at the end."""
    order = shop("cancel_pending_order", order_id="#W1", reason="ordered by mistake")
    assert list(order)[-1:] == ["cancel_reason"]
    assert (order["status"], shop.balance()) == ("cancelled", 35.1)
    refund = {"transaction_type": "refund", "amount": 30.1, "payment_method_id": "gift_card_1"}
    assert order["payment_history"][1:] == [refund]


def test_changed_items_have_their_own_price_and_options(shop: Shop) -> None:
    """In tau-bench; the difference is not rounded in the history."""
    order = shop("modify_pending_order_items", **ITEMS, payment_method_id="gift_card_1")
    assert [(item["item_id"], item["price"], item["options"]) for item in order["items"]] == [
        ("green", 7.55, {"color": "green"}),
        ("blue", 12.2, {"color": "blue"}),
    ]
    difference = (7.55 - 10.1) + (12.2 - 10.1)
    assert order["payment_history"][1] == {
        "transaction_type": "refund",
        "amount": -difference,
        "payment_method_id": "gift_card_1",
    }
    assert (order["status"], shop.balance()) == ("pending (item modified)", 5.45)


def test_in_tau2_bench_all_changed_items_have_the_price_of_the_last(shop2: Shop) -> None:
    """So the benchmark's reference databases are."""
    order = shop2("modify_pending_order_items", **ITEMS, payment_method_id="gift_card_1")
    assert [(item["item_id"], item["price"]) for item in order["items"]] == [("green", 12.2), ("blue", 12.2)]


def test_a_payment_by_another_method_is_refunded_to_the_first(shop: Shop) -> None:
    """And the gift card pays."""
    shop.database["users"]["ann_lee_1"] = rich(shop)
    order = shop("modify_pending_order_payment", order_id="#W2", payment_method_id="gift_card_1")
    history = [(each["transaction_type"], each["payment_method_id"]) for each in order["payment_history"]]
    assert history == [("payment", "card_1"), ("payment", "gift_card_1"), ("refund", "card_1")]
    assert shop.balance() == 79.8


def rich(shop: Shop) -> dict[str, Any]:
    user = copy.deepcopy(shop.database["users"]["ann_lee_1"])
    user["payment_methods"]["gift_card_1"]["balance"] = 100
    return user


def test_an_exchange_and_a_return_are_asked_for(shop: Shop) -> None:
    """Ids are sorted, and nothing is paid yet."""
    exchange = {"item_ids": ["wool", "red"], "new_item_ids": ["silk", "blue"], "payment_method_id": "card_1"}
    asked = fork(shop.database)
    order = shop("exchange_delivered_order_items", order_id="#W3", **exchange)
    assert (order["status"], order["exchange_items"]) == ("exchange requested", ["red", "wool"])
    assert (order["exchange_new_items"], order["exchange_price_difference"]) == (["blue", "silk"], 482.6)
    shop.database = asked
    order = shop("return_delivered_order_items", order_id="#W3", item_ids=["red"], payment_method_id="gift_card_1")
    assert (order["status"], order["return_items"], shop.balance()) == ("return requested", ["red"], 5)


def test_addresses(shop: Shop) -> None:
    """Of an order, and of a user."""
    assert shop("modify_pending_order_address", order_id="#W1", **WORK)["address"] == WORK
    assert shop("modify_user_address", user_id="ann_lee_1", **WORK)["address"] == WORK
    assert shop.task_set.database["orders"]["#W1"]["address"] == HOME


def test_what_is_looked_up(shop: Shop) -> None:
    """Names and email addresses whatever their case."""
    assert shop("find_user_id_by_email", email="ANN.lee@example.com") == "ann_lee_1"
    assert shop("find_user_id_by_name_zip", first_name="ann", last_name="LEE", zip="89501") == "ann_lee_1"
    assert shop("list_all_product_types") == {"lamp": "lamp", "rug": "rug"}
    for table, name in (("orders", "#W1"), ("products", "rug"), ("users", "ann_lee_1")):
        kind = table.removesuffix("s")
        assert shop(f"get_{kind}_details", **{f"{kind}_id": name}) == shop.task_set.database[table][name]
    assert shop("think", thought="hm") == ""
    assert shop("transfer_to_human_agents", summary="hm") == "Transfer successful"


def swap(**changes: Any) -> dict[str, Any]:
    """Return arguments of an exchange in the delivered order."""
    return {"order_id": "#W3", "item_ids": ["red"], "new_item_ids": [], "payment_method_id": "card_1", **changes}


EXCHANGE, RETURN = "exchange_delivered_order_items", "return_delivered_order_items"
PENDING: dict[str, Any] = {"order_id": "#W2", "payment_method_id": "card_1"}
BACK: dict[str, Any] = {"order_id": "#W3", "item_ids": ["red"]}
REFUSALS: list[tuple[str, dict[str, Any], str]] = [
    ("get_order_details", {"order_id": "W1"}, "order not found"),
    ("get_product_details", {"product_id": "x"}, "product not found"),
    ("find_user_id_by_email", {"email": "x"}, "user not found"),
    ("cancel_pending_order", {"order_id": "#W3", "reason": "lost"}, "non-pending order cannot be cancelled"),
    ("cancel_pending_order", {"order_id": "#W1", "reason": "bored"}, "invalid reason"),
    (EXCHANGE, swap(new_item_ids=["gone"]), "new item gone not found or available"),
    (
        EXCHANGE,
        swap(item_ids=["wool"], new_item_ids=["silk"], payment_method_id="gift_card_1"),
        "insufficient gift card balance to pay for the price difference",
    ),
    (
        "modify_pending_order_items",
        {**PENDING, "item_ids": ["red"], "new_item_ids": []},
        "the number of items to be exchanged should match",
    ),
    (
        "modify_pending_order_payment",
        PENDING,
        "the new payment method should be different from the current one",
    ),
    (RETURN, {**BACK, "payment_method_id": "card_2"}, "payment method not found"),
    ("calculate", {"expression": "a"}, "invalid characters in expression"),
]


@pytest.mark.parametrize(("name", "arguments", "words"), REFUSALS)
def test_refusals_are_worded_as_in_the_benchmarks(
    shop: Shop, tmp_path: Path, name: str, arguments: dict[str, Any], words: str
) -> None:
    """In tau2-bench with a capital letter; and change nothing."""
    shop2 = Shop(read_folder(write_tau2(tmp_path / "2")))
    for each, expected in ((shop, words), (shop2, words[0].upper() + words[1:])):
        assert each(name, **arguments) == f"Error: {expected}"
        assert each.database == each.task_set.database


def test_some_refusals_of_tau2_bench_are_its_own(shop: Shop, shop2: Shop) -> None:
    twice, paypal = swap(item_ids=["red", "red"]), {**BACK, "payment_method_id": "paypal_1"}
    assert shop(EXCHANGE, **twice) == "Error: red not found"
    assert shop2(EXCHANGE, **twice) == "Error: Number of red not found."
    original = "ayment method should be either the original payment method or a gift card"
    assert shop(RETURN, **paypal) == f"Error: p{original}"
    assert shop2(RETURN, **paypal) == "Error: Payment method should be the original payment method"
    assert shop("calculate", expression="1/0") == shop2("calculate", expression="1/0") == "Error: division by zero"


def test_an_address_that_is_no_text_is_refused_in_tau2_bench_only(shop: Shop, shop2: Shop) -> None:
    """With pydantic's words, as there."""
    odd = {**WORK, "zip": 89502}
    assert shop("modify_user_address", user_id="ann_lee_1", **odd)["address"]["zip"] == 89502
    answer = shop2("modify_user_address", user_id="ann_lee_1", **odd)
    assert answer.startswith("Error: 1 validation error for UserAddress\nzip\n  Input should be a valid string")


def test_an_item_of_tau2_bench(shop2: Shop) -> None:
    """Found in whatever product it is of."""
    assert shop2("get_item_details", item_id="silk")["price"] == 500.5
    assert shop2("get_item_details", item_id="tin") == "Error: Item not found"


HOSTILE: list[dict[str, Any]] = [
    {},
    {"order_id": []},
    {"order_id": None, "item_ids": None, "new_item_ids": 5, "payment_method_id": {}},
    {"order_id": "#W3", "item_ids": ["red"] * 100_000, "new_item_ids": "red", "payment_method_id": "card_1"},
    {"database": 1, "data": 2, "self": 3},
    {"email": 5, "expression": ["1", "+"], "\ud800": "\ud800"},
]


@pytest.mark.parametrize("arguments", HOSTILE)
def test_arguments_that_a_model_made_up_give_an_answer(tmp_path: Path, arguments: dict[str, Any]) -> None:
    """Whatever they are, for every tool there is."""
    for folder in (write_tau(tmp_path / "1"), write_tau2(tmp_path / "2"), write_tau2(tmp_path / "3", database=AIRLINE)):
        shop = Shop(read_folder(folder))
        for name in shop.task_set.domain.tools:
            assert isinstance(shop.task_set.domain.call(shop.database, name, arguments), str)
        assert shop.task_set.digest(shop.database)


def test_wrong_arguments_are_told_as_the_originals_tell_them(shop: Shop, shop2: Shop) -> None:
    """By the names of its classes; a tool that does not exist has its own answer."""
    missing = "missing 1 required positional argument: 'reason'"
    assert shop("cancel_pending_order", order_id="#W1") == f"Error: CancelPendingOrder.invoke() {missing}"
    assert shop2("cancel_pending_order", order_id="#W1") == f"Error: RetailTools.cancel_pending_order() {missing}"
    assert shop("fly") == "Unknown action fly"
    assert shop2("fly") == "Error: Tool 'fly' not found."


def booking(**changes: Any) -> dict[str, Any]:
    """Return arguments of a booking for two, with one bag and insurance: 610 dollars."""
    return {
        "user_id": "ann_lee_1",
        "origin": "SFO",
        "destination": "JFK",
        "flight_type": "one_way",
        "cabin": "economy",
        "flights": [{"flight_number": name, "date": "2024-05-20"} for name in ("SFO-DEN", "DEN-JFK")],
        "passengers": [{"first_name": name, "last_name": "Lee", "dob": "1990-01-01"} for name in ("Ann", "Bob")],
        "payment_methods": [
            {"payment_id": "certificate_1", "amount": 50},
            {"payment_id": "gift_card_1", "amount": 100},
            {"payment_id": "card_1", "amount": 460},
        ],
        "total_baggages": 3,
        "nonfree_baggages": 1,
        "insurance": "yes",
        **changes,
    }


def test_a_booking_takes_seats_and_money(airline: Shop) -> None:
    """A certificate is used up, and the reservation is the user's."""
    booked = airline("book_reservation", **booking())
    assert (booked["reservation_id"], booked["status"]) == ("HATHAT", None)
    assert [flight["price"] for flight in booked["flights"]] == [100, 150]
    user = airline.database["users"]["ann_lee_1"]
    assert (user["reservations"], sorted(user["payment_methods"])) == (["HATHAT"], ["card_1", "gift_card_1"])
    assert airline.balance() == 100.0
    seats = airline.database["flights"]["SFO-DEN"]["dates"]["2024-05-20"]["available_seats"]
    assert seats == {"business": 2, "economy": 0, "basic_economy": 2}
    assert airline("book_reservation", **booking()) == "Error: Not enough seats on flight SFO-DEN"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"insurance": "no"}, "Payment amount does not add up, total price is 550, but paid 610"),
        ({"user_id": "bob"}, "User bob not found"),
        (
            {"flights": [{"flight_number": "SFO-DEN", "date": "2024-05-21"}]},
            "Flight SFO-DEN not available on date 2024",
        ),
        ({"payment_methods": [{"payment_id": "gift_card_1", "amount": 610}]}, "Not enough balance in payment method"),
        ({"cabin": "roof"}, "1 validation error for Reservation\ncabin\n  Input should be 'business', 'economy' or"),
        ({"flights": ["SFO-DEN"]}, "'str' object has no attribute 'flight_number'"),
    ],
)
def test_a_booking_that_is_refused(airline: Shop, changes: dict[str, Any], expected: str) -> None:
    assert airline("book_reservation", **booking(**changes)).startswith(f"Error: {expected}")
    assert airline.database == airline.task_set.database


def test_a_reservation_is_changed_and_cancelled(airline: Shop) -> None:
    """Each change is paid by a method of the user, and none by a certificate."""
    airline("book_reservation", **booking())
    bags = {"reservation_id": "HATHAT", "total_baggages": 4, "nonfree_baggages": 2}
    changed = airline("update_reservation_baggages", **bags, payment_id="gift_card_1")
    assert (changed["nonfree_baggages"], airline.balance()) == (2, 50.0)
    flights = [{"flight_number": "SFO-DEN", "date": "2024-05-20"}]
    update = {"reservation_id": "HATHAT", "cabin": "economy", "flights": flights}
    changed = airline("update_reservation_flights", **update, payment_id="card_1")
    assert changed["payment_history"][-1] == {"payment_id": "card_1", "amount": -300}
    changed = airline("update_reservation_passengers", reservation_id="HATHAT", passengers=[])
    assert changed == "Error: Number of passengers does not match"
    cancelled = airline("cancel_reservation", reservation_id="HATHAT")
    assert (cancelled["status"], sum(each["amount"] for each in cancelled["payment_history"])) == ("cancelled", 0)


def test_flights_are_found_and_certificates_sent(airline: Shop) -> None:
    """Directly, and with one stop where the second leaves after the first has arrived."""
    (direct,) = airline("search_direct_flight", origin="SFO", destination="DEN", date="2024-05-20")
    assert (direct["date"], direct["prices"]["economy"]) == (None, 100)
    ((first, second),) = airline("search_onestop_flight", origin="SFO", destination="JFK", date="2024-05-20")
    assert (first["flight_number"], second["flight_number"], second["date"]) == ("SFO-DEN", "DEN-JFK", "2024-05-20")
    assert airline("get_flight_status", flight_number="SFO-DEN", date="2024-05-21") == "cancelled"
    assert airline("list_all_airports")[0] == {"iata": "SFO", "city": "San Francisco"}
    sent = airline("send_certificate", user_id="ann_lee_1", amount=70)
    assert sent == "Certificate certificate_3221322 added to user ann_lee_1 with amount 70."
    assert airline.balance("certificate_3221322") == 70.0


def test_deeply_nested_arguments_are_refused(shop: Shop) -> None:
    """They would make the database too deep to be hashed."""
    deep: Any = "x"
    for _ in range(900):
        deep = [deep]
    answer = shop("modify_user_address", user_id="ann_lee_1", **{**WORK, "city": deep})
    assert answer == "Error: the arguments are nested more than 20 levels deep"
