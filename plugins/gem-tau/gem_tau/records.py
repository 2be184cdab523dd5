"""The records of tau2-bench's databases, with their fields in its order; and those of tau-bench's shop, to check them.

A database of tau2-bench is read through these models, which fills in what is missing and makes a float of an integer
where the field is one; its hash is of what comes out. The names of the models stand in what an assistant reads when
its arguments do not fit. Source: the data models of sierra-research/tau2-bench at a2c0247.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel


class UserName(BaseModel):
    """A person's name."""

    first_name: str
    last_name: str


class UserAddress(BaseModel):
    """Where a user lives, or an order goes."""

    address1: str
    address2: str
    city: str
    country: str
    state: str
    zip: str


class CreditCard(BaseModel):
    """A payment method without a balance."""

    source: Literal["credit_card"]
    id: str
    brand: str
    last_four: str


class Paypal(BaseModel):
    """A payment method without a balance."""

    source: Literal["paypal"]
    id: str


class ShopGiftCard(BaseModel):
    """A payment method of the shop that can run out, in dollars."""

    source: Literal["gift_card"]
    id: str
    balance: float


class User(BaseModel):
    """A customer of the shop."""

    user_id: str
    name: UserName
    address: UserAddress
    email: str
    payment_methods: dict[str, CreditCard | ShopGiftCard | Paypal]
    orders: list[str]


class Variant(BaseModel):
    """What can be bought of a product; the price is in dollars."""

    item_id: str
    options: dict[str, str]
    available: bool
    price: float


class Product(BaseModel):
    """A kind of thing that the shop sells."""

    name: str
    product_id: str
    variants: dict[str, Variant]


class OrderItem(BaseModel):
    """A thing in an order."""

    name: str
    product_id: str
    item_id: str
    price: float
    options: dict[str, str]


class Fulfillment(BaseModel):
    """Items that were sent together."""

    tracking_id: list[str]
    item_ids: list[str]


class OrderPayment(BaseModel):
    """A payment or refund, in dollars."""

    transaction_type: Literal["payment", "refund"]
    amount: float
    payment_method_id: str


class Order(BaseModel):
    """An order and what became of it."""

    order_id: str
    user_id: str
    address: UserAddress
    items: list[OrderItem]
    status: Literal[
        "processed",
        "pending",
        "pending (item modified)",
        "delivered",
        "cancelled",
        "exchange requested",
        "return requested",
    ]
    fulfillments: list[Fulfillment]
    payment_history: list[OrderPayment]
    cancel_reason: Literal["no longer needed", "ordered by mistake"] | None = None
    exchange_items: list[str] | None = None
    exchange_new_items: list[str] | None = None
    exchange_payment_method_id: str | None = None
    exchange_price_difference: float | None = None
    return_items: list[str] | None = None
    return_payment_method_id: str | None = None


class Shop(BaseModel):
    """The database of tau2-bench's retail domain."""

    products: dict[str, Product]
    users: dict[str, User]
    orders: dict[str, Order]


class TauUser(User):
    """A user as tau-bench has them: the id is only the key."""

    user_id: str = ""


class Address(UserAddress):
    """Where a passenger lives."""

    address2: str | None = None  # type: ignore[assignment]  # not every address has it


class Certificate(BaseModel):
    """A payment method that can be used once, in dollars; and a gift card, which can run out."""

    source: Literal["certificate", "gift_card"]
    id: str
    amount: float


class Passenger(BaseModel):
    """A passenger."""

    first_name: str
    last_name: str
    dob: str


class Traveller(BaseModel):
    """A customer of the airline."""

    user_id: str
    name: UserName
    address: Address
    email: str
    dob: str
    payment_methods: dict[str, CreditCard | Certificate]
    saved_passengers: list[Passenger]
    membership: Literal["gold", "silver", "regular"]
    reservations: list[str]


Cabin = Literal["business", "economy", "basic_economy"]


class Available(BaseModel):
    """A flight on a day on which it can be booked; prices are in dollars."""

    status: Literal["available"]
    available_seats: dict[Cabin, int]
    prices: dict[Cabin, int]


class Flight(BaseModel):
    """A flight number, and on each day what can be booked, or how it went."""

    flight_number: str
    origin: str
    destination: str
    scheduled_departure_time_est: str
    scheduled_arrival_time_est: str
    dates: dict[str, Available | dict[str, str]]


class FlightInfo(BaseModel):
    """A flight on a day."""

    flight_number: str
    date: str


class ReservationFlight(BaseModel):
    """A flight in a reservation."""

    flight_number: str
    origin: str
    destination: str
    date: str
    price: int


class Payment(BaseModel):
    """A payment of a reservation, or a refund if it is negative, in dollars."""

    payment_id: str
    amount: int


class Reservation(BaseModel):
    """A booking."""

    reservation_id: str
    user_id: str
    origin: str
    destination: str
    flight_type: Literal["round_trip", "one_way"]
    cabin: Cabin
    flights: list[ReservationFlight]
    passengers: list[Passenger]
    payment_history: list[Payment]
    created_at: str
    total_baggages: int
    nonfree_baggages: int
    insurance: Literal["yes", "no"]
    status: Literal["cancelled"] | None = None


class Airline(BaseModel):
    """The database of tau2-bench's airline domain."""

    flights: dict[str, Flight]
    users: dict[str, Traveller]
    reservations: dict[str, Reservation]
