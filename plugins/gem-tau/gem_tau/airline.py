"""The tools of tau2-bench's airline: what each does to the database, and what it answers.

Effects, their order and answers are those of sierra-research/tau2-bench at a2c0247. A tool raises what the assistant
reads after ``Error: ``; what it has changed until then stays changed, as there.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, Field

from gem_tau.database import Record, own
from gem_tau.records import Cabin, Certificate, FlightInfo, Passenger, Payment, Reservation, ReservationFlight
from gem_tau.toolkit import Toolkit, UserId

T = TypeVar("T", bound=BaseModel)

_NOW = "2024-05-15T15:00:00"
_RESERVATION_IDS = ("HATHAT", "HATHAU", "HATHAV")
_CERTIFICATE_IDS = ("certificate_3221322", "certificate_3221323", "certificate_3221324")
_AIRPORTS = {
    "SFO": "San Francisco",
    "JFK": "New York",
    "LAX": "Los Angeles",
    "ORD": "Chicago",
    "DFW": "Dallas",
    "DEN": "Denver",
    "SEA": "Seattle",
    "ATL": "Atlanta",
    "MIA": "Miami",
    "BOS": "Boston",
    "PHX": "Phoenix",
    "IAH": "Houston",
    "LAS": "Las Vegas",
    "MCO": "Orlando",
    "EWR": "Newark",
    "CLT": "Charlotte",
    "MSP": "Minneapolis",
    "DTW": "Detroit",
    "PHL": "Philadelphia",
    "LGA": "LaGuardia",
}

ReservationId = Annotated[str, Field(description="Reservation id, such as 'ZFA04Y'.")]
PaymentId = Annotated[str, Field(description="Id of one of the user's payment methods, such as 'gift_card_7815826'.")]
Origin = Annotated[str, Field(description="Airport that the flight leaves from, such as 'JFK'.")]
Destination = Annotated[str, Field(description="Airport that the flight goes to, such as 'LAX'.")]
Date = Annotated[str, Field(description="Day of the flight, such as '2024-05-01'.")]
Flights = Annotated[
    list[FlightInfo], Field(description="All flights of the trip in order, also those that stay when it is changed.")
]
Passengers = Annotated[list[Passenger], Field(description="All passengers, with dates of birth such as '1990-04-05'.")]
TotalBags = Annotated[int, Field(description="All checked bags of the reservation.")]
PaidBags = Annotated[int, Field(description="Those of the bags that are paid for.")]


class AirlineTools(Toolkit):
    """The tools of the airline."""

    def book_reservation(
        self,
        user_id: UserId,
        origin: Origin,
        destination: Destination,
        flight_type: Annotated[Literal["one_way", "round_trip"], Field(description="Kind of trip.")],
        cabin: Annotated[Cabin, Field(description="Cabin, the same on all flights.")],
        flights: Flights,
        passengers: Passengers,
        payment_methods: Annotated[
            list[Payment],
            Field(description="What is paid by which payment method, in dollars; together the whole price."),
        ],
        total_baggages: TotalBags,
        nonfree_baggages: PaidBags,
        insurance: Annotated[Literal["yes", "no"], Field(description="Whether the passengers are insured.")],
    ) -> Record:
        """Book a trip."""
        wanted = _models(FlightInfo, flights)
        travellers = _models(Passenger, passengers)
        payments = _models(Payment, payment_methods)
        user = self._found("users", user_id)
        reservation_id = self._free_id(_RESERVATION_IDS, self._database["reservations"], "Too many reservations")
        reservation = Reservation(
            reservation_id=reservation_id,
            user_id=user_id,
            origin=origin,
            destination=destination,
            flight_type=flight_type,
            cabin=cabin,
            flights=[],
            passengers=travellers,
            payment_history=payments,
            created_at=_NOW,
            total_baggages=total_baggages,
            nonfree_baggages=nonfree_baggages,
            insurance=insurance,
        )
        total = 0
        for flight in wanted:
            booked = self._new_flight(flight, cabin, len(travellers))
            reservation.flights.append(booked)
            total += booked.price * len(travellers)
        if insurance == "yes":
            total += 30 * len(travellers)
        total += 50 * nonfree_baggages
        self._check_payments(user, payments, total)
        self._pay(user_id, payments)
        for flight in wanted:
            seats = own(self._database, "flights", flight.flight_number)["dates"][flight.date]["available_seats"]
            seats[cabin] -= len(travellers)
        self._database["reservations"][reservation_id] = reservation.model_dump()
        own(self._database, "users", user_id)["reservations"].append(reservation_id)
        return self._database["reservations"][reservation_id]

    def cancel_reservation(self, reservation_id: ReservationId) -> Record:
        """Cancel a whole reservation and refund its payments."""
        self._found("reservations", reservation_id)
        reservation = own(self._database, "reservations", reservation_id)
        history = reservation["payment_history"]
        history += [{"payment_id": each["payment_id"], "amount": -each["amount"]} for each in history]
        reservation["status"] = "cancelled"
        return reservation

    def get_flight_status(
        self, flight_number: Annotated[str, Field(description="Such as 'HAT001'.")], date: Date
    ) -> str:
        """Show the status of a flight on a day."""
        status: str = self._flight_on(flight_number, date)["status"]
        return status

    def get_reservation_details(self, reservation_id: ReservationId) -> Record:
        """Show a reservation: flights, cabin, passengers, payments, bags and insurance."""
        return self._found("reservations", reservation_id)

    def get_user_details(self, user_id: UserId) -> Record:
        """Show a user: name, address, payment methods, membership, saved passengers and reservations."""
        return self._found("users", user_id)

    def list_all_airports(self) -> list[dict[str, str]]:
        """List all airports with their cities."""
        return [{"iata": code, "city": city} for code, city in _AIRPORTS.items()]

    def search_direct_flight(self, origin: Origin, destination: Destination, date: Date) -> list[Record]:
        """Find the flights between two airports that can be booked for a day, with their prices and free seats."""
        return self._search(date, origin=origin, destination=destination)

    def search_onestop_flight(self, origin: Origin, destination: Destination, date: Date) -> list[list[Record]]:
        """Find pairs of flights between two airports, with one stop, that can be booked for a day."""
        found = []
        for first in self._search(date, origin=origin):
            first["date"] = date
            arrival = first["scheduled_arrival_time_est"]
            then = f"2024-05-{int(date[-2:]) + 1}" if "+1" in arrival else date
            onward = self._search(then, origin=first["destination"], destination=destination, leave_after=arrival)
            found += [[first, {**second, "date": then}] for second in onward]
        return found

    def send_certificate(
        self, user_id: UserId, amount: Annotated[int, Field(description="Its value in dollars.")]
    ) -> str:
        """Give a user a certificate, which pays for a later booking."""
        methods = self._found("users", user_id)["payment_methods"]
        certificate_id = self._free_id(_CERTIFICATE_IDS, methods, "Too many certificates")
        certificate = Certificate(id=certificate_id, amount=amount, source="certificate")
        own(self._database, "users", user_id)["payment_methods"][certificate_id] = certificate.model_dump()
        return f"Certificate {certificate_id} added to user {user_id} with amount {amount}."

    def update_reservation_baggages(
        self,
        reservation_id: ReservationId,
        total_baggages: TotalBags,
        nonfree_baggages: PaidBags,
        payment_id: PaymentId,
    ) -> Record:
        """Change the bags of a reservation; what is paid for them in addition goes by the payment method."""
        before = self._found("reservations", reservation_id)
        self._found("users", before["user_id"])
        price = 50 * max(0, nonfree_baggages - before["nonfree_baggages"])
        payment = self._pay_for_update(before["user_id"], payment_id, price)
        reservation = own(self._database, "reservations", reservation_id)
        reservation["payment_history"] += payment
        reservation["total_baggages"] = total_baggages
        reservation["nonfree_baggages"] = nonfree_baggages
        return reservation

    def update_reservation_flights(
        self, reservation_id: ReservationId, cabin: Cabin, flights: Flights, payment_id: PaymentId
    ) -> Record:
        """Change the flights or the cabin of a reservation; the difference in price goes by the payment method."""
        wanted = _models(FlightInfo, flights)
        before = self._found("reservations", reservation_id)
        self._found("users", before["user_id"])
        travellers = len(before["passengers"])
        total = 0
        updated = []
        for flight in wanted:
            kept = [
                each
                for each in before["flights"]
                if each["flight_number"] == flight.flight_number
                and each["date"] == flight.date
                and cabin == before["cabin"]
            ]
            new = kept[0] if kept else self._new_flight(flight, cabin, travellers).model_dump()
            total += new["price"] * travellers
            updated.append(new)
        total -= sum(each["price"] for each in before["flights"]) * travellers
        payment = self._pay_for_update(before["user_id"], payment_id, total)
        reservation = own(self._database, "reservations", reservation_id)
        reservation["payment_history"] += payment
        reservation["flights"] = updated
        reservation["cabin"] = cabin
        return reservation

    def update_reservation_passengers(self, reservation_id: ReservationId, passengers: Passengers) -> Record:
        """Change the passengers of a reservation, but not how many they are."""
        travellers: Any = passengers
        if all(isinstance(each, dict) for each in travellers):
            travellers = [Passenger(**each).model_dump() for each in travellers]
        before = self._found("reservations", reservation_id)
        if len(travellers) != len(before["passengers"]):
            raise ValueError("Number of passengers does not match")
        reservation = own(self._database, "reservations", reservation_id)
        reservation["passengers"] = travellers
        return reservation

    def _found(self, table: str, key: str) -> Record:
        if key not in self._database[table]:
            raise ValueError(f"{table.removesuffix('s').capitalize()} {key} not found")
        return self._database[table][key]

    def _flight_on(self, flight_number: str, date: str) -> Record:
        dates: dict[str, Record] = self._found("flights", flight_number)["dates"]
        if date not in dates:
            raise ValueError(f"Flight {flight_number} not found on date {date}")
        return dates[date]

    def _new_flight(self, flight: FlightInfo, cabin: str, travellers: int) -> ReservationFlight:
        """Return a flight for a reservation, if there are seats."""
        number = flight.flight_number
        route = self._found("flights", number)
        day = self._flight_on(number, flight.date)
        if day["status"] != "available":
            raise ValueError(f"Flight {number} not available on date {flight.date}")
        if day["available_seats"][cabin] < travellers:
            raise ValueError(f"Not enough seats on flight {number}")
        return ReservationFlight(
            flight_number=number,
            origin=route["origin"],
            destination=route["destination"],
            date=flight.date,
            price=day["prices"][cabin],
        )

    def _free_id(self, ids: tuple[str, ...], taken: dict[str, Record], refusal: str) -> str:
        for each in ids:
            if each not in taken:
                return each
        raise ValueError(refusal)

    def _check_payments(self, user: Record, payments: list[Payment], total: int) -> None:
        for payment in payments:
            method = user["payment_methods"].get(payment.payment_id)
            if method is None:
                raise ValueError(f"Payment method {payment.payment_id} not found")
            if method["source"] in {"gift_card", "certificate"} and method["amount"] < payment.amount:
                raise ValueError(f"Not enough balance in payment method {payment.payment_id}")
        paid = sum(payment.amount for payment in payments)
        if paid != total:
            raise ValueError(f"Payment amount does not add up, total price is {total}, but paid {paid}")

    def _pay(self, user_id: str, payments: list[Payment]) -> None:
        """Take payments off gift cards, and use certificates up."""
        methods = own(self._database, "users", user_id)["payment_methods"]
        for payment in payments:
            method = methods[payment.payment_id]
            if method["source"] == "gift_card":
                method["amount"] -= payment.amount
            elif method["source"] == "certificate":
                methods.pop(payment.payment_id)

    def _pay_for_update(self, user_id: str, payment_id: str, price: int) -> list[Record]:
        """Take a price off a gift card, if it is one, and return what the payment history gets: nothing for 0."""
        methods = self._database["users"][user_id]["payment_methods"]
        if payment_id not in methods:
            raise ValueError("Payment method not found")
        source = methods[payment_id]["source"]
        if source == "certificate":
            raise ValueError("Certificate cannot be used to update reservation")
        if source == "gift_card":
            if methods[payment_id]["amount"] < price:
                raise ValueError("Gift card balance is not enough")
            own(self._database, "users", user_id)["payment_methods"][payment_id]["amount"] -= price
        return [Payment(payment_id=payment_id, amount=price).model_dump()] if price != 0 else []

    def _search(
        self,
        date: str,
        *,
        origin: str,
        destination: str | None = None,
        leave_after: str | None = None,
    ) -> list[Record]:
        return [
            {
                "flight_number": flight["flight_number"],
                "origin": flight["origin"],
                "destination": flight["destination"],
                "status": "available",
                "scheduled_departure_time_est": flight["scheduled_departure_time_est"],
                "scheduled_arrival_time_est": flight["scheduled_arrival_time_est"],
                "date": None,
                "available_seats": flight["dates"][date]["available_seats"],
                "prices": flight["dates"][date]["prices"],
            }
            for flight in self._database["flights"].values()
            if (origin is None or flight["origin"] == origin)
            and (destination is None or flight["destination"] == destination)
            and date in flight["dates"]
            and flight["dates"][date]["status"] == "available"
            and (leave_after is None or flight["scheduled_departure_time_est"] >= leave_after)
        ]


def _models(form: type[T], values: list[Any]) -> list[T]:
    # Where one of them is no object, all stay as they are, and using one as a record fails.
    return [form(**value) for value in values] if all(isinstance(value, dict) for value in values) else values
