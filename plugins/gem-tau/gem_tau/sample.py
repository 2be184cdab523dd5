"""The sample: a shop for bicycle parts with eight tools, whose data and ten tasks come with the plugin."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from gem_tau.database import Database, Record, own

OrderId = Annotated[str, Field(description="Number of an order, such as #1001.")]
ItemId = Annotated[str, Field(description="Id of an item in the order, such as bell-brass.")]


class SampleTools:
    """The tools of the sample.

    Args:
        database: What they work on.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    def find_customer(self, email: Annotated[str, Field(description="Email address.")]) -> Record:
        """Find a customer by email address: name, address and order numbers."""
        for customer in self._database["customers"].values():
            if customer["email"] == email.strip().lower():
                return customer
        raise ValueError(f"there is no customer with the email address {email}")

    def get_order(self, order_id: OrderId) -> Record:
        """Show an order: its customer, status, items, total and address."""
        return self._found("orders", order_id)

    def get_product(self, product: Annotated[str, Field(description="Name of a product, such as helmet.")]) -> Record:
        """Show the variants of a product, with their item ids, colours, prices and numbers in stock."""
        return self._found("products", product)

    def cancel_order(
        self,
        order_id: OrderId,
        reason: Annotated[Literal["no longer needed", "ordered by mistake"], Field(description="Why it is cancelled.")],
    ) -> Record:
        """Cancel a pending order."""
        if reason not in ("no longer needed", "ordered by mistake"):
            raise ValueError("the reason must be 'no longer needed' or 'ordered by mistake'")
        order = self._in_status(order_id, "pending")
        order |= {"status": "cancelled", "reason": reason}
        return order

    def return_item(
        self,
        order_id: OrderId,
        item_id: ItemId,
        refund_to: Annotated[Literal["original payment", "gift card"], Field(description="Where the money goes.")],
    ) -> Record:
        """Take back an item of a delivered order."""
        if refund_to not in ("original payment", "gift card"):
            raise ValueError("refund_to must be 'original payment' or 'gift card'")
        _item(self._found("orders", order_id), item_id)
        order = self._in_status(order_id, "delivered")
        order |= {"status": "return requested", "returned": item_id, "refund_to": refund_to}
        return order

    def swap_item(
        self,
        order_id: OrderId,
        item_id: ItemId,
        new_item_id: Annotated[str, Field(description="Id of another variant of the same product.")],
    ) -> Record:
        """Replace an item of a pending order by another variant of the same product, at its price."""
        product = self._found("products", _item(self._found("orders", order_id), item_id)["product"])
        variant = product["variants"].get(new_item_id)
        if variant is None:
            raise ValueError(f"{new_item_id} is no variant of the product {product['name']}")
        if not variant["stock"]:
            raise ValueError(f"{new_item_id} is sold out")
        order = self._in_status(order_id, "pending")
        item = _item(order, item_id)
        order["total"] = round(order["total"] - item["price"] + variant["price"], 2)
        item |= {"item_id": new_item_id, "colour": variant["colour"], "price": variant["price"]}
        return order

    def change_address(
        self,
        order_id: OrderId,
        address: Annotated[str, Field(description="Street and number, city and postal code in one line.")],
    ) -> Record:
        """Send a pending order to another address."""
        order = self._in_status(order_id, "pending")
        order["address"] = address.strip()
        return order

    def hand_over(self, summary: Annotated[str, Field(description="What the customer wants.")]) -> str:
        """Hand the conversation over to a human, which ends it."""
        return "A human takes over."

    def _found(self, table: str, key: str) -> Record:
        if key not in self._database[table]:
            raise ValueError(f"there is no {table.removesuffix('s')} {key}")
        return self._database[table][key]

    def _in_status(self, order_id: str, status: str) -> Record:
        """Return an order to be changed, if it has the status."""
        found = self._found("orders", order_id)["status"]
        if found != status:
            raise ValueError(f"order {order_id} is {found}, not {status}")
        return own(self._database, "orders", order_id)


def _item(order: Record, item_id: str) -> Record:
    for item in order["items"]:
        if item["item_id"] == item_id:
            found: Record = item
            return found
    raise ValueError(f"{item_id} is not in order {order['order_id']}")
