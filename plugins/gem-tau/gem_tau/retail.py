"""The tools of the retail shop, as in tau-bench or as in tau2-bench, which differ in what they refuse and how.

Effects, their order, roundings and answers are those of sierra-research/tau-bench at 59a200c and
sierra-research/tau2-bench at a2c0247.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gem_tau.database import Record, own
from gem_tau.records import UserAddress
from gem_tau.toolkit import Toolkit, UserId

OrderId = Annotated[str, Field(description="Order number with its '#', such as '#W0000000'.")]
ItemIds = Annotated[
    list[str], Field(description="Ids of items in the order; one that is there twice may be given twice.")
]
NewItemIds = Annotated[
    list[str], Field(description="Ids of the items to get instead, in the same order, each of the same product.")
]
PaymentId = Annotated[str, Field(description="Id of one of the user's payment methods, such as 'gift_card_0000000'.")]
Zip = Annotated[str, Field(description="Postal code, such as '12345'.")]


class RetailTools(Toolkit):
    """The tools of both shops; ``think`` is tau-bench's only, ``get_item_details`` is tau2-bench's."""

    def find_user_id_by_email(self, email: Annotated[str, Field(description="The user's email address.")]) -> str:
        """Find the id of a user by email address."""
        for user_id, user in self._database["users"].items():
            if user["email"].lower() == email.lower():
                return user_id
        raise self._refusal("user not found")

    def find_user_id_by_name_zip(
        self,
        first_name: Annotated[str, Field(description="The user's first name, such as 'John'.")],
        last_name: Annotated[str, Field(description="The user's last name, such as 'Doe'.")],
        zip: Zip,
    ) -> str:
        """Find the id of a user by name and postal code, where the email address is not known."""
        for user_id, user in self._database["users"].items():
            if (
                user["name"]["first_name"].lower() == first_name.lower()
                and user["name"]["last_name"].lower() == last_name.lower()
                and user["address"]["zip"] == zip
            ):
                return user_id
        raise self._refusal("user not found")

    def list_all_product_types(self) -> dict[str, str]:
        """List the names of all products with their product ids."""
        products = {product["name"]: product["product_id"] for product in self._database["products"].values()}
        return dict(sorted(products.items()))

    def get_order_details(self, order_id: OrderId) -> Record:
        """Show an order: its items, status, address, deliveries and payments."""
        return self._found("orders", order_id)

    def get_product_details(
        self,
        product_id: Annotated[
            str, Field(description="Product id, such as '6086499569'; an item id is something else.")
        ],
    ) -> Record:
        """Show a product: all its variants with their item ids, options, prices and whether they are in stock."""
        return self._found("products", product_id)

    def get_item_details(
        self,
        item_id: Annotated[str, Field(description="Item id, such as '6086499569'; a product id is something else.")],
    ) -> Record:
        """Show one variant of a product: its options, its price and whether it is in stock."""
        for product in self._database["products"].values():
            if item_id in product["variants"]:
                found: Record = product["variants"][item_id]
                return found
        raise self._refusal("item not found")

    def get_user_details(self, user_id: UserId) -> Record:
        """Show a user: name, address, payment methods and orders."""
        return self._found("users", user_id)

    def think(self, thought: Annotated[str, Field(description="What there is to think about.")]) -> str:
        """Write down a thought. It changes nothing and finds nothing out."""
        return ""

    def cancel_pending_order(
        self,
        order_id: OrderId,
        reason: Annotated[
            str,
            Field(
                description="Why it is cancelled.",
                json_schema_extra={"enum": ["no longer needed", "ordered by mistake"]},
            ),
        ],
    ) -> Record:
        """Cancel a pending order and refund it: to a gift card at once, to another payment method within days.

        Tell the user the details first, and get an explicit yes.
        """
        self._order(order_id, "pending", "cancelled")
        reasons = ["no longer needed", "ordered by mistake"]
        if reason not in (set(reasons) if self._tau2 else reasons):  # a reason that cannot be hashed is another error
            raise self._refusal("invalid reason")
        order = own(self._database, "orders", order_id)
        refunds = []
        for payment in order["payment_history"]:
            payment_id, amount = payment["payment_method_id"], payment["amount"]
            refunds.append(_transaction("refund", amount, payment_id))
            if self._is_gift_card(order, payment_id):
                self._add_to_gift_card(order, payment_id, amount)
        order["status"] = "cancelled"
        order["cancel_reason"] = reason
        order["payment_history"].extend(refunds)
        return order

    def exchange_delivered_order_items(
        self, order_id: OrderId, item_ids: ItemIds, new_item_ids: NewItemIds, payment_method_id: PaymentId
    ) -> Record:
        """Ask for items of a delivered order to be exchanged for others of the same products; only once for an order.

        Tell the user the details first, and get an explicit yes.
        """
        order = self._order(order_id, "delivered", "exchanged")
        difference, _ = self._new_variants(order, item_ids, new_item_ids)
        difference = round(difference, 2)
        self._check_balance(order, payment_method_id, difference, "pay for the price difference")
        order = own(self._database, "orders", order_id)
        order["status"] = "exchange requested"
        order["exchange_items"] = sorted(item_ids)
        order["exchange_new_items"] = sorted(new_item_ids)
        order["exchange_payment_method_id"] = payment_method_id
        order["exchange_price_difference"] = difference
        return order

    def modify_pending_order_address(
        self, order_id: OrderId, address1: str, address2: str, city: str, state: str, country: str, zip: Zip
    ) -> Record:
        """Change the address to which a pending order is sent.

        Tell the user the details first, and get an explicit yes.
        """
        self._modifiable_order(order_id)
        address = self._address(address1=address1, address2=address2, city=city, state=state, country=country, zip=zip)
        order = own(self._database, "orders", order_id)
        order["address"] = address
        return order

    def modify_pending_order_items(
        self, order_id: OrderId, item_ids: ItemIds, new_item_ids: NewItemIds, payment_method_id: PaymentId
    ) -> Record:
        """Change items of a pending order for others of the same products; only once for an order.

        Tell the user the details first, and get an explicit yes.
        """
        order = self._order(order_id, "pending", "modified")
        difference, variants = self._new_variants(order, item_ids, new_item_ids)
        self._check_balance(order, payment_method_id, difference, "pay for the new item")
        if self._tau2:  # all get price and options of the last, and the benchmark's own databases have it so
            difference, variants = float(difference), variants[-1:] * len(variants)
        order = own(self._database, "orders", order_id)
        kind = "payment" if difference > 0 else "refund"
        order["payment_history"].append(_transaction(kind, abs(difference), payment_method_id))
        if self._payment_method(order, payment_method_id)["source"] == "gift_card":
            self._add_to_gift_card(order, payment_method_id, -difference)
        for item_id, new_item_id, variant in zip(item_ids, new_item_ids, variants, strict=True):
            item = _item(order, item_id)
            item["item_id"] = new_item_id
            item["price"] = variant["price"]
            item["options"] = variant["options"]
        order["status"] = "pending (item modified)"
        return order

    def modify_pending_order_payment(self, order_id: OrderId, payment_method_id: PaymentId) -> Record:
        """Pay a pending order by another payment method, and refund the one before.

        Tell the user the details first, and get an explicit yes.
        """
        order = self._modifiable_order(order_id)
        method = self._payment_method(order, payment_method_id)
        history = order["payment_history"]
        if len(history) != 1 or history[0]["transaction_type"] != "payment":
            raise self._refusal("there should be exactly one payment for a pending order")
        amount, old_id = history[0]["amount"], history[0]["payment_method_id"]
        if old_id == payment_method_id:
            raise self._refusal("the new payment method should be different from the current one")
        self._check_balance(order, payment_method_id, amount, "pay for the order")
        order = own(self._database, "orders", order_id)
        order["payment_history"].append(_transaction("payment", amount, payment_method_id))
        order["payment_history"].append(_transaction("refund", amount, old_id))
        if method["source"] == "gift_card":
            self._add_to_gift_card(order, payment_method_id, -amount)
        if self._is_gift_card(order, old_id):
            self._add_to_gift_card(order, old_id, amount)
        return order

    def modify_user_address(
        self, user_id: UserId, address1: str, address2: str, city: str, state: str, country: str, zip: Zip
    ) -> Record:
        """Change the address that a user's account has.

        Tell the user the details first, and get an explicit yes.
        """
        self._found("users", user_id)
        address = self._address(address1=address1, address2=address2, city=city, state=state, country=country, zip=zip)
        user = own(self._database, "users", user_id)
        user["address"] = address
        return user

    def return_delivered_order_items(
        self, order_id: OrderId, item_ids: ItemIds, payment_method_id: PaymentId
    ) -> Record:
        """Ask for items of a delivered order to be taken back, and refunded to a gift card or to what paid for them.

        Tell the user the details first, and get an explicit yes.
        """
        order = self._order(order_id, "delivered", "returned")
        self._payment_method(order, payment_method_id)
        original = order["payment_history"][0]["payment_method_id"]
        if not self._is_gift_card(order, payment_method_id) and payment_method_id != original:
            either, card = ("", "") if self._tau2 else ("either ", " or a gift card")
            raise self._refusal(f"payment method should be {either}the original payment method{card}")
        self._check_items(order, item_ids, "Some item not found" if self._tau2 else "some item not found")
        order = own(self._database, "orders", order_id)
        order["status"] = "return requested"
        order["return_items"] = sorted(item_ids)
        order["return_payment_method_id"] = payment_method_id
        return order

    def _found(self, table: str, key: str) -> Record:
        if key not in self._database[table]:
            raise self._refusal(f"{table.removesuffix('s')} not found")
        return self._database[table][key]

    def _order(self, order_id: str, status: str, change: str) -> Record:
        """Return an order, if it has the status in which it can be changed."""
        order = self._found("orders", order_id)
        if order["status"] != status:
            raise self._refusal(f"non-{status} order cannot be {change}")
        return order

    def _modifiable_order(self, order_id: str) -> Record:
        """Return a pending order; in tau2-bench also one whose items were changed."""
        order = self._found("orders", order_id)
        modified = self._tau2 and order["status"] == "pending (item modified)"
        return order if modified else self._order(order_id, "pending", "modified")

    def _payment_method(self, order: Record, payment_id: str) -> Record:
        methods: dict[str, Record] = self._found("users", order["user_id"])["payment_methods"]
        if payment_id not in methods:
            raise self._refusal("payment method not found")
        return methods[payment_id]

    def _is_gift_card(self, order: Record, payment_id: str) -> bool:
        if self._tau2:
            return bool(self._payment_method(order, payment_id)["source"] == "gift_card")
        return "gift_card" in payment_id

    def _check_balance(self, order: Record, payment_id: str, amount: float, purpose: str) -> None:
        method = self._payment_method(order, payment_id)
        if method["source"] == "gift_card" and method["balance"] < amount:
            raise self._refusal(f"insufficient gift card balance to {purpose}")

    def _add_to_gift_card(self, order: Record, payment_id: str, amount: float) -> None:
        """Add dollars to a gift card of the user of an order, or take them off, and round the balance to cents."""
        method = own(self._database, "users", order["user_id"])["payment_methods"][payment_id]
        method["balance"] = round(method["balance"] + amount, 2)

    def _check_items(self, order: Record, item_ids: list[str], refusal: str) -> None:
        """Check that an order has items, and as often as they are named."""
        in_order = [item["item_id"] for item in order["items"]]
        for item_id in item_ids:
            if item_ids.count(item_id) > in_order.count(item_id):
                raise ValueError(refusal.format(item_id))

    def _new_variants(self, order: Record, item_ids: list[str], new_item_ids: list[str]) -> tuple[float, list[Record]]:
        """Return what the new items cost more than the old ones, and their variants, if they can be had."""
        exchange = self._tau2 and order["status"] == "delivered"  # tau2-bench words these refusals in its own way
        self._check_items(order, item_ids, "Number of {} not found." if exchange else "{} not found")
        if len(item_ids) != len(new_item_ids):
            raise self._refusal(f"the number of items to be exchanged should match{'.' if exchange else ''}")
        difference: float = 0
        variants = []
        for item_id, new_item_id in zip(item_ids, new_item_ids, strict=True):
            if self._tau2 and not exchange and item_id == new_item_id:
                raise self._refusal("the new item id should be different from the old item id")
            item = _item(order, item_id)
            variant = self._found("products", item["product_id"])["variants"].get(new_item_id)
            if variant is None and self._tau2:
                raise self._refusal("variant not found")
            if variant is None or not variant["available"]:
                raise self._refusal(f"new item {new_item_id} not found or available")
            difference += variant["price"] - item["price"]
            variants.append(variant)
        return difference, variants

    def _address(self, **parts: str) -> Record:
        return UserAddress(**parts).model_dump() if self._tau2 else parts


def _item(order: Record, item_id: str) -> Record:
    """Return the first item of an order with an id, which is known to be in it."""
    return next(item for item in order["items"] if item["item_id"] == item_id)


def _transaction(kind: str, amount: float, payment_id: str) -> Record:
    return {"transaction_type": kind, "amount": amount, "payment_method_id": payment_id}
