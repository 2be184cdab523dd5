"""What the tools of both retail shops have in common: their parameters, and small steps on the database."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from gem_tau.database import Database, Record, own

OrderId = Annotated[str, Field(description="Order number with its '#', such as '#W0000000'.")]
UserId = Annotated[str, Field(description="User id, such as 'sara_doe_496'.")]
ProductId = Annotated[str, Field(description="Product id, such as '6086499569'; an item id is something else.")]
ItemIds = Annotated[
    list[str], Field(description="Ids of items in the order; one that is there twice may be given twice.")
]
NewItemIds = Annotated[
    list[str], Field(description="Ids of the items to get instead, in the same order, each of the same product.")
]
PaymentId = Annotated[str, Field(description="Id of one of the user's payment methods, such as 'gift_card_0000000'.")]
Reason = Annotated[
    str,
    Field(description="Why it is cancelled.", json_schema_extra={"enum": ["no longer needed", "ordered by mistake"]}),
]
Email = Annotated[str, Field(description="The user's email address.")]
FirstName = Annotated[str, Field(description="The user's first name, such as 'John'.")]
LastName = Annotated[str, Field(description="The user's last name, such as 'Doe'.")]
Zip = Annotated[str, Field(description="Postal code, such as '12345'.")]
Expression = Annotated[str, Field(description="Arithmetic with numbers, + - * /, parentheses and blanks.")]
Summary = Annotated[str, Field(description="The user's problem in short.")]


def user_with_email(database: Database, email: str) -> str | None:
    """Return the id of the first user with an email address, whatever its case."""
    for user_id, user in database["users"].items():
        if user["email"].lower() == email.lower():
            return user_id
    return None


def user_with_name(database: Database, first_name: str, last_name: str, zip: str) -> str | None:
    """Return the id of the first user with a name, whatever its case, and a postal code."""
    for user_id, user in database["users"].items():
        if (
            user["name"]["first_name"].lower() == first_name.lower()
            and user["name"]["last_name"].lower() == last_name.lower()
            and user["address"]["zip"] == zip
        ):
            return user_id
    return None


def product_types(database: Database) -> dict[str, str]:
    """Return the product ids by name, sorted by name."""
    products = {product["name"]: product["product_id"] for product in database["products"].values()}
    return dict(sorted(products.items()))


def find_item(order: Record, item_id: str) -> Record:
    """Return the first item of an order with an id.

    Raises:
        IndexError: There is none.
    """
    items: list[Record] = order["items"]
    for item in items:
        if item["item_id"] == item_id:
            return item
    raise IndexError("list index out of range")


def check_items(order: Record, item_ids: list[str], refusal: str) -> None:
    """Check that an order has items, and as often as they are named.

    Args:
        order: The order.
        item_ids: Ids of items.
        refusal: What the error says, with ``{}`` for the first item that is missing.

    Raises:
        ValueError: It does not have them.
    """
    in_order = [item["item_id"] for item in order["items"]]
    for item_id in item_ids:
        if item_ids.count(item_id) > in_order.count(item_id):
            raise ValueError(refusal.format(item_id))


def transaction(kind: str, amount: float, payment_id: str) -> Record:
    """Return an entry of a payment history; ``kind`` is ``payment`` or ``refund``."""
    return {"transaction_type": kind, "amount": amount, "payment_method_id": payment_id}


def add_to_gift_card(database: Database, order: Record, payment_id: str, amount: float) -> None:
    """Add dollars to a gift card of the user of an order, or take them off, and round the balance to cents."""
    method: dict[str, Any] = own(database, "users", order["user_id"])["payment_methods"][payment_id]
    method["balance"] = round(method["balance"] + amount, 2)
