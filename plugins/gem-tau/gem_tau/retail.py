"""The tools of tau-bench's retail shop: what each does to the database, and what it answers.

Effects, their order, roundings and answers are those of sierra-research/tau-bench at 59a200c. A tool raises what the
assistant reads after ``Error: ``; what it has changed until then stays changed, as there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field

from gem_tau.calculator import evaluate, is_arithmetic
from gem_tau.database import Database, Record, own
from gem_tau.shop import (
    Email,
    Expression,
    FirstName,
    ItemIds,
    LastName,
    NewItemIds,
    OrderId,
    PaymentId,
    ProductId,
    Reason,
    Summary,
    UserId,
    Zip,
    add_to_gift_card,
    check_items,
    find_item,
    product_types,
    transaction,
    user_with_email,
    user_with_name,
)


def calculate(
    database: Database,
    /,
    expression: Expression,
) -> str:
    """Compute an arithmetic expression."""
    if not is_arithmetic(expression):
        raise ValueError("invalid characters in expression")
    return evaluate(expression)


def find_user_id_by_email(database: Database, /, email: Email) -> str:
    """Find the id of a user by email address."""
    user_id = user_with_email(database, email)
    if user_id is None:
        raise ValueError("user not found")
    return user_id


def find_user_id_by_name_zip(
    database: Database,
    /,
    first_name: FirstName,
    last_name: LastName,
    zip: Zip,
) -> str:
    """Find the id of a user by name and postal code, where the email address is not known."""
    user_id = user_with_name(database, first_name, last_name, zip)
    if user_id is None:
        raise ValueError("user not found")
    return user_id


def list_all_product_types(database: Database, /) -> dict[str, str]:
    """List the names of all products with their product ids."""
    return product_types(database)


def get_order_details(database: Database, /, order_id: OrderId) -> Record:
    """Show an order: its items, status, address, deliveries and payments."""
    return _found(database, "orders", order_id)


def get_product_details(
    database: Database,
    /,
    product_id: ProductId,
) -> Record:
    """Show a product: all its variants with their item ids, options, prices and whether they are in stock."""
    return _found(database, "products", product_id)


def get_user_details(database: Database, /, user_id: UserId) -> Record:
    """Show a user: name, address, payment methods and orders."""
    return _found(database, "users", user_id)


def think(database: Database, /, thought: Annotated[str, Field(description="What there is to think about.")]) -> str:
    """Write down a thought. It changes nothing and finds nothing out."""
    return ""


def transfer_to_human_agents(database: Database, /, summary: Summary) -> str:
    """Hand the user over to a human agent, where the user asks for one or the tools and the policy cannot help."""
    return "Transfer successful"


def cancel_pending_order(
    database: Database,
    /,
    order_id: OrderId,
    reason: Reason,
) -> Record:
    """Cancel a pending order and refund it: to a gift card at once, to another payment method within days.

    Tell the user the details first, and get an explicit yes.
    """
    _check_status(database, order_id, "pending", "non-pending order cannot be cancelled")
    if reason not in ["no longer needed", "ordered by mistake"]:
        raise ValueError("invalid reason")
    order = own(database, "orders", order_id)
    refunds = []
    for payment in order["payment_history"]:
        payment_id, amount = payment["payment_method_id"], payment["amount"]
        refunds.append(transaction("refund", amount, payment_id))
        if "gift_card" in payment_id:
            add_to_gift_card(database, order, payment_id, amount)
    order["status"] = "cancelled"
    order["cancel_reason"] = reason
    order["payment_history"].extend(refunds)
    return order


def exchange_delivered_order_items(
    database: Database, /, order_id: OrderId, item_ids: ItemIds, new_item_ids: NewItemIds, payment_method_id: PaymentId
) -> Record:
    """Ask for items of a delivered order to be exchanged for others of the same products; only once for an order.

    Tell the user the details first, and get an explicit yes.
    """
    order = _check_status(database, order_id, "delivered", "non-delivered order cannot be exchanged")
    difference = round(_price_difference(database, order, item_ids, new_item_ids), 2)
    method = _payment_method(database, order, payment_method_id)
    if method["source"] == "gift_card" and method["balance"] < difference:
        raise ValueError("insufficient gift card balance to pay for the price difference")
    order = own(database, "orders", order_id)
    order["status"] = "exchange requested"
    order["exchange_items"] = sorted(item_ids)
    order["exchange_new_items"] = sorted(new_item_ids)
    order["exchange_payment_method_id"] = payment_method_id
    order["exchange_price_difference"] = difference
    return order


def modify_pending_order_address(
    database: Database,
    /,
    order_id: OrderId,
    address1: str,
    address2: str,
    city: str,
    state: str,
    country: str,
    zip: Zip,
) -> Record:
    """Change the address to which a pending order is sent.

    Tell the user the details first, and get an explicit yes.
    """
    _check_status(database, order_id, "pending", "non-pending order cannot be modified")
    order = own(database, "orders", order_id)
    order["address"] = _address(address1, address2, city, state, country, zip)
    return order


def modify_pending_order_items(
    database: Database, /, order_id: OrderId, item_ids: ItemIds, new_item_ids: NewItemIds, payment_method_id: PaymentId
) -> Record:
    """Change items of a pending order for others of the same products; only once for an order.

    Tell the user the details first, and get an explicit yes.
    """
    order = _check_status(database, order_id, "pending", "non-pending order cannot be modified")
    difference = _price_difference(database, order, item_ids, new_item_ids)
    method = _payment_method(database, order, payment_method_id)
    if method["source"] == "gift_card" and method["balance"] < difference:
        raise ValueError("insufficient gift card balance to pay for the new item")
    order = own(database, "orders", order_id)
    kind = "payment" if difference > 0 else "refund"
    order["payment_history"].append(transaction(kind, abs(difference), payment_method_id))
    if method["source"] == "gift_card":
        add_to_gift_card(database, order, payment_method_id, -difference)
    for item_id, new_item_id in zip(item_ids, new_item_ids, strict=True):
        item = find_item(order, item_id)
        item["item_id"] = new_item_id
        variant = database["products"][item["product_id"]]["variants"][new_item_id]
        item["price"] = variant["price"]
        item["options"] = variant["options"]
    order["status"] = "pending (item modified)"
    return order


def modify_pending_order_payment(database: Database, /, order_id: OrderId, payment_method_id: PaymentId) -> Record:
    """Pay a pending order by another payment method, and refund the one before.

    Tell the user the details first, and get an explicit yes.
    """
    order = _check_status(database, order_id, "pending", "non-pending order cannot be modified")
    method = _payment_method(database, order, payment_method_id)
    history = order["payment_history"]
    if len(history) > 1 or history[0]["transaction_type"] != "payment":
        raise ValueError("there should be exactly one payment for a pending order")
    amount, old_id = history[0]["amount"], history[0]["payment_method_id"]
    if old_id == payment_method_id:
        raise ValueError("the new payment method should be different from the current one")
    if method["source"] == "gift_card" and method["balance"] < amount:
        raise ValueError("insufficient gift card balance to pay for the order")
    order = own(database, "orders", order_id)
    order["payment_history"].append(transaction("payment", amount, payment_method_id))
    order["payment_history"].append(transaction("refund", amount, old_id))
    if method["source"] == "gift_card":
        add_to_gift_card(database, order, payment_method_id, -amount)
    if "gift_card" in old_id:
        add_to_gift_card(database, order, old_id, amount)
    return order


def modify_user_address(
    database: Database,
    /,
    user_id: UserId,
    address1: str,
    address2: str,
    city: str,
    state: str,
    country: str,
    zip: Zip,
) -> Record:
    """Change the address that a user's account has.

    Tell the user the details first, and get an explicit yes.
    """
    _found(database, "users", user_id)
    user = own(database, "users", user_id)
    user["address"] = _address(address1, address2, city, state, country, zip)
    return user


def return_delivered_order_items(
    database: Database, /, order_id: OrderId, item_ids: ItemIds, payment_method_id: PaymentId
) -> Record:
    """Ask for items of a delivered order to be taken back; the refund goes to a gift card or to what they were paid by.

    Tell the user the details first, and get an explicit yes.
    """
    order = _check_status(database, order_id, "delivered", "non-delivered order cannot be returned")
    _payment_method(database, order, payment_method_id)
    if "gift_card" not in payment_method_id and payment_method_id != order["payment_history"][0]["payment_method_id"]:
        raise ValueError("payment method should be either the original payment method or a gift card")
    check_items(order, item_ids, "some item not found")
    order = own(database, "orders", order_id)
    order["status"] = "return requested"
    order["return_items"] = sorted(item_ids)
    order["return_payment_method_id"] = payment_method_id
    return order


def _found(database: Database, table: str, key: str) -> Record:
    if key not in database[table]:
        raise ValueError(f"{table.removesuffix('s')} not found")
    return database[table][key]


def _check_status(database: Database, order_id: str, status: str, refusal: str) -> Record:
    order = _found(database, "orders", order_id)
    if order["status"] != status:
        raise ValueError(refusal)
    return order


def _payment_method(database: Database, order: Record, payment_id: str) -> Record:
    methods: dict[str, Record] = database["users"][order["user_id"]]["payment_methods"]
    if payment_id not in methods:
        raise ValueError("payment method not found")
    return methods[payment_id]


def _price_difference(database: Database, order: Record, item_ids: list[str], new_item_ids: list[str]) -> float:
    """Return what the new items cost more than the old ones; refuse items that are not in the order or in stock."""
    check_items(order, item_ids, "{} not found")
    if len(item_ids) != len(new_item_ids):
        raise ValueError("the number of items to be exchanged should match")
    difference: float = 0
    for item_id, new_item_id in zip(item_ids, new_item_ids, strict=True):
        item = find_item(order, item_id)
        variants = database["products"][item["product_id"]]["variants"]
        if not (new_item_id in variants and variants[new_item_id]["available"]):
            raise ValueError(f"new item {new_item_id} not found or available")
        difference += variants[new_item_id]["price"] - item["price"]
    return difference


def _address(address1: str, address2: str, city: str, state: str, country: str, zip: str) -> Record:
    return {
        "address1": address1,
        "address2": address2,
        "city": city,
        "state": state,
        "country": country,
        "zip": zip,
    }


TOOLS: tuple[Callable[..., Any], ...] = (
    calculate,
    cancel_pending_order,
    exchange_delivered_order_items,
    find_user_id_by_email,
    find_user_id_by_name_zip,
    get_order_details,
    get_product_details,
    get_user_details,
    list_all_product_types,
    modify_pending_order_address,
    modify_pending_order_items,
    modify_pending_order_payment,
    modify_user_address,
    return_delivered_order_items,
    think,
    transfer_to_human_agents,
)

WRITES = frozenset(
    tool.__name__ for tool in TOOLS if tool.__name__.startswith(("cancel_", "exchange_", "modify_", "return_"))
)
"""Names of the tools that change the database."""
