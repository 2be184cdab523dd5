"""The tools of tau2-bench's retail shop, which refuse other things than tau-bench's and in other words.

Effects, their order, roundings and answers are those of sierra-research/tau2-bench at a2c0247. As with tau-bench's, a
tool raises what the assistant reads after ``Error: ``, and what it has changed until then stays changed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field

from gem_tau.calculator import evaluate, is_arithmetic
from gem_tau.database import Database, Record, own
from gem_tau.records import UserAddress
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


def calculate(database: Database, /, expression: Expression) -> str:
    """Compute an arithmetic expression."""
    if not is_arithmetic(expression):
        raise ValueError("Invalid characters in expression")
    return evaluate(expression)


def cancel_pending_order(database: Database, /, order_id: OrderId, reason: Reason) -> Record:
    """Cancel a pending order and refund it: to a gift card at once, to another payment method within days.

    Tell the user the details first, and get an explicit yes.
    """
    order = _found(database, "orders", order_id)
    if order["status"] != "pending":
        raise ValueError("Non-pending order cannot be cancelled")
    if reason not in {"no longer needed", "ordered by mistake"}:
        raise ValueError("Invalid reason")
    order = own(database, "orders", order_id)
    refunds = []
    for payment in order["payment_history"]:
        payment_id, amount = payment["payment_method_id"], payment["amount"]
        refunds.append(transaction("refund", amount, payment_id))
        if _payment_method(database, order, payment_id)["source"] == "gift_card":
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
    order = _found(database, "orders", order_id)
    if order["status"] != "delivered":
        raise ValueError("Non-delivered order cannot be exchanged")
    check_items(order, item_ids, "Number of {} not found.")
    if len(item_ids) != len(new_item_ids):
        raise ValueError("The number of items to be exchanged should match.")
    difference: float = 0
    for item_id, new_item_id in zip(item_ids, new_item_ids, strict=True):
        item = find_item(order, item_id)
        difference += _variant(database, item, new_item_id)["price"] - item["price"]
    difference = round(difference, 2)
    method = _payment_method(database, order, payment_method_id)
    if method["source"] == "gift_card" and method["balance"] < difference:
        raise ValueError("Insufficient gift card balance to pay for the price difference")
    order = own(database, "orders", order_id)
    order["status"] = "exchange requested"
    order["exchange_items"] = sorted(item_ids)
    order["exchange_new_items"] = sorted(new_item_ids)
    order["exchange_payment_method_id"] = payment_method_id
    order["exchange_price_difference"] = difference
    return order


def find_user_id_by_name_zip(database: Database, /, first_name: FirstName, last_name: LastName, zip: Zip) -> str:
    """Find the id of a user by name and postal code, where the email address is not known."""
    user_id = user_with_name(database, first_name, last_name, zip)
    if user_id is None:
        raise ValueError("User not found")
    return user_id


def find_user_id_by_email(database: Database, /, email: Email) -> str:
    """Find the id of a user by email address."""
    user_id = user_with_email(database, email)
    if user_id is None:
        raise ValueError("User not found")
    return user_id


def get_order_details(database: Database, /, order_id: OrderId) -> Record:
    """Show an order: its items, status, address, deliveries and payments."""
    return _found(database, "orders", order_id)


def get_product_details(database: Database, /, product_id: ProductId) -> Record:
    """Show a product: all its variants with their item ids, options, prices and whether they are in stock."""
    return _found(database, "products", product_id)


def get_item_details(
    database: Database,
    /,
    item_id: Annotated[str, Field(description="Item id, such as '6086499569'; a product id is something else.")],
) -> Record:
    """Show one variant of a product: its options, its price and whether it is in stock."""
    for product in database["products"].values():
        if item_id in product["variants"]:
            found: Record = product["variants"][item_id]
            return found
    raise ValueError("Item not found")


def get_user_details(database: Database, /, user_id: UserId) -> Record:
    """Show a user: name, address, payment methods and orders."""
    return _found(database, "users", user_id)


def list_all_product_types(database: Database, /) -> dict[str, str]:
    """List the names of all products with their product ids."""
    return product_types(database)


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
    _check_pending(_found(database, "orders", order_id))
    address = UserAddress(address1=address1, address2=address2, city=city, country=country, state=state, zip=zip)
    order = own(database, "orders", order_id)
    order["address"] = address.model_dump()
    return order


def modify_pending_order_items(
    database: Database, /, order_id: OrderId, item_ids: ItemIds, new_item_ids: NewItemIds, payment_method_id: PaymentId
) -> Record:
    """Change items of a pending order for others of the same products; only once for an order.

    Tell the user the details first, and get an explicit yes.
    """
    order = _found(database, "orders", order_id)
    if order["status"] != "pending":
        raise ValueError("Non-pending order cannot be modified")
    check_items(order, item_ids, "{} not found")
    if len(item_ids) != len(new_item_ids):
        raise ValueError("The number of items to be exchanged should match")
    difference: float = 0
    variant: Record = {}
    for item_id, new_item_id in zip(item_ids, new_item_ids, strict=True):
        if item_id == new_item_id:
            raise ValueError("The new item id should be different from the old item id")
        item = find_item(order, item_id)
        variant = _variant(database, item, new_item_id)
        difference += variant["price"] - item["price"]
    method = _payment_method(database, order, payment_method_id)
    if method["source"] == "gift_card" and method["balance"] < difference:
        raise ValueError("Insufficient gift card balance to pay for the new item")
    order = own(database, "orders", order_id)
    kind = "payment" if difference > 0 else "refund"
    order["payment_history"].append(transaction(kind, abs(float(difference)), payment_method_id))
    if method["source"] == "gift_card":
        add_to_gift_card(database, order, payment_method_id, -difference)
    for item_id, new_item_id in zip(item_ids, new_item_ids, strict=True):
        item = find_item(order, item_id)
        item["item_id"] = new_item_id
        # Price and options are those of the last new item for all of them: the benchmark's own databases have it so.
        item["price"] = variant["price"]
        item["options"] = variant["options"]
    order["status"] = "pending (item modified)"
    return order


def modify_pending_order_payment(database: Database, /, order_id: OrderId, payment_method_id: PaymentId) -> Record:
    """Pay a pending order by another payment method, and refund the one before.

    Tell the user the details first, and get an explicit yes.
    """
    order = _found(database, "orders", order_id)
    _check_pending(order)
    method = _payment_method(database, order, payment_method_id)
    history = order["payment_history"]
    if len(history) != 1 or history[0]["transaction_type"] != "payment":
        raise ValueError("There should be exactly one payment for a pending order")
    amount, old_id = history[0]["amount"], history[0]["payment_method_id"]
    if old_id == payment_method_id:
        raise ValueError("The new payment method should be different from the current one")
    if method["source"] == "gift_card" and method["balance"] < amount:
        raise ValueError("Insufficient gift card balance to pay for the order")
    order = own(database, "orders", order_id)
    order["payment_history"].append(transaction("payment", amount, payment_method_id))
    order["payment_history"].append(transaction("refund", amount, old_id))
    if method["source"] == "gift_card":
        add_to_gift_card(database, order, payment_method_id, -amount)
    if _payment_method(database, order, old_id)["source"] == "gift_card":
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
    address = UserAddress(address1=address1, address2=address2, city=city, country=country, state=state, zip=zip)
    user = own(database, "users", user_id)
    user["address"] = address.model_dump()
    return user


def return_delivered_order_items(
    database: Database, /, order_id: OrderId, item_ids: ItemIds, payment_method_id: PaymentId
) -> Record:
    """Ask for items of a delivered order to be taken back; the refund goes to a gift card or to what they were paid by.

    Tell the user the details first, and get an explicit yes.
    """
    order = _found(database, "orders", order_id)
    if order["status"] != "delivered":
        raise ValueError("Non-delivered order cannot be returned")
    method = _payment_method(database, order, payment_method_id)
    if method["source"] != "gift_card" and payment_method_id != order["payment_history"][0]["payment_method_id"]:
        raise ValueError("Payment method should be the original payment method")
    check_items(order, item_ids, "Some item not found")
    order = own(database, "orders", order_id)
    order["status"] = "return requested"
    order["return_items"] = sorted(item_ids)
    order["return_payment_method_id"] = payment_method_id
    return order


def transfer_to_human_agents(database: Database, /, summary: Summary) -> str:
    """Hand the user over to a human agent, where the user asks for one or the tools and the policy cannot help."""
    return "Transfer successful"


def _found(database: Database, table: str, key: str) -> Record:
    if key not in database[table]:
        raise ValueError(f"{table.removesuffix('s').capitalize()} not found")
    return database[table][key]


def _check_pending(order: Record) -> None:
    if "pending" not in order["status"]:
        raise ValueError("Non-pending order cannot be modified")


def _payment_method(database: Database, order: Record, payment_id: str) -> Record:
    methods: dict[str, Record] = _found(database, "users", order["user_id"])["payment_methods"]
    if payment_id not in methods:
        raise ValueError("Payment method not found")
    return methods[payment_id]


def _variant(database: Database, item: Record, item_id: str) -> Record:
    variants: dict[str, Record] = _found(database, "products", item["product_id"])["variants"]
    if item_id not in variants:
        raise ValueError("Variant not found")
    if not variants[item_id]["available"]:
        raise ValueError(f"New item {item_id} not found or available")
    return variants[item_id]


TOOLS: tuple[Callable[..., Any], ...] = (
    calculate,
    cancel_pending_order,
    exchange_delivered_order_items,
    find_user_id_by_email,
    find_user_id_by_name_zip,
    get_item_details,
    get_order_details,
    get_product_details,
    get_user_details,
    list_all_product_types,
    modify_pending_order_address,
    modify_pending_order_items,
    modify_pending_order_payment,
    modify_user_address,
    return_delivered_order_items,
    transfer_to_human_agents,
)
WRITES = frozenset(
    tool.__name__ for tool in TOOLS if tool.__name__.startswith(("cancel_", "exchange_", "modify_", "return_"))
)
"""Names of the tools that change the database."""
