"""Whole programs that read a few lines: simple rules, with their edges."""

from __future__ import annotations

from code_problems.problem import Problem, letters, numbers, row, text


def _list(values: list[int], *rest: object) -> str:
    return f"{len(values)}\n{row(values)}\n" + "".join(f"{item}\n" for item in rest)


NEXT_BUS = Problem(
    id="next-bus",
    level=1,
    statement=text("""
        A bus stop has a list of departure times, in minutes after midnight and in no particular order. You reach the
        stop at minute t, and you can still catch a bus that leaves in that very minute.

        Input: the number n of departures (1 to 1000), a line with the n times, and a line with t.
        Output: the time of the first bus that you can catch, or WALK if there is none.
        """),
    reference=text("""
        n = int(input())
        times = list(map(int, input().split()))
        t = int(input())
        later = [time for time in times if time >= t]
        print(min(later) if later else "WALK")
        """),
    wrong={
        "misses the bus of the same minute": text("""
            n = int(input())
            times = list(map(int, input().split()))
            t = int(input())
            later = [time for time in times if time > t]
            print(min(later) if later else "WALK")
            """),
        "takes the list to be in order": text("""
            n = int(input())
            times = list(map(int, input().split()))
            t = int(input())
            for time in times:
                if time >= t:
                    print(time)
                    break
            else:
                print("WALK")
            """),
    },
    inputs=[
        _list([480, 510, 540], 500),
        _list([480, 510, 540], 510),
        _list([900, 300, 620, 610], 605),
        _list([100], 101),
        _list([0], 0),
        _list([1439, 5, 700], 1439),
        _list(numbers(1, 300, 0, 1439), 777),
        _list(numbers(2, 1000, 0, 900), 901),
    ],
)

PARKING = Problem(
    id="parking-fee",
    level=1,
    statement=text("""
        A car park charges nothing for a stay of up to 30 minutes. For a longer stay every hour that has begun costs 2
        coins, counted from the arrival. For each full day of 1440 minutes the fee is 20 coins instead, and what is left
        after the full days is charged by the hour, but never more than 20 coins either. (The free half hour only exists
        for stays of 30 minutes or less in all.)

        Input: one line with the length of the stay in minutes, from 0 to 1000000.
        Output: the fee in coins.
        """),
    reference=text("""
        minutes = int(input())
        if minutes <= 30:
            print(0)
        else:
            days, rest = divmod(minutes, 1440)
            print(20 * days + min(20, 2 * -(-rest // 60)))
        """),
    wrong={
        "does not count an hour that has begun": text("""
            minutes = int(input())
            days, rest = divmod(minutes, 1440)
            print(0 if minutes <= 30 else 20 * days + min(20, 2 * (rest // 60)))
            """),
        "forgets the daily maximum": text("""
            minutes = int(input())
            print(0 if minutes <= 30 else 2 * ((minutes + 59) // 60))
            """),
        "gives a free half hour after each day": text("""
            minutes = int(input())
            days, rest = divmod(minutes, 1440)
            print(20 * days + (0 if rest <= 30 else min(20, 2 * ((rest + 59) // 60))))
            """),
    },
    inputs=[f"{minutes}\n" for minutes in (0, 30, 31, 60, 61, 600, 601, 1439, 1440, 1450, 1471, 5000, 999_999)],
)

VOWELS = Problem(
    id="vowel-run",
    level=1,
    statement=text("""
        Find the longest stretch of neighbouring vowels in a line of text. The vowels are a, e, i, o and u, small or
        capital; every other character, a space too, ends a stretch.

        Input: one line of 0 to 10000 characters.
        Output: the length of the longest stretch, 0 if there is no vowel.
        """),
    reference=text("""
        import sys

        line = sys.stdin.readline().rstrip("\\n").lower()
        best = run = 0
        for character in line:
            run = run + 1 if character in "aeiou" else 0
            best = max(best, run)
        print(best)
        """),
    wrong={
        "overlooks capital letters": text("""
            import re
            print(max(map(len, re.findall("[aeiou]+", input())), default=0))
            """),
        "counts all vowels": text("""
            print(sum(character in "aeiouAEIOU" for character in input()))
            """),
        "forgets a stretch at the end of the line": text("""
            best = run = 0
            for character in input().lower():
                if character in "aeiou":
                    run += 1
                else:
                    best, run = max(best, run), 0
            print(best)
            """),
    },
    inputs=[
        "queueing\n",
        "rhythm\n",
        "\n",
        "AEiou AEIOUa\n",
        "the sea air\n",
        "banana\n",
        f"{letters(3, 5000, 'aeioubcd')}\n",
        f"{letters(4, 9000, 'AEIOUxyz ')}oooooooooooooooooooooooooooooooooooooooooooooo\n",
    ],
)

LEAP = Problem(
    id="leap-days",
    level=1,
    statement=text("""
        Count how often there was, or will be, a 29th of February in the years from a to b, both included. A year has
        one if it can be divided by 4; but years that can be divided by 100 have none, unless they can be divided by
        400.

        Input: one line with a and b (1 <= a <= b <= 10^15).
        Output: the number of such days.
        """),
    reference=text("""
        def until(year):
            return year // 4 - year // 100 + year // 400

        a, b = map(int, input().split())
        print(until(b) - until(a - 1))
        """),
    wrong={
        "leaves out the first year": text("""
            def until(year):
                return year // 4 - year // 100 + year // 400

            a, b = map(int, input().split())
            print(until(b) - until(a))
            """),
        "knows the rule of four alone": text("""
            a, b = map(int, input().split())
            print(b // 4 - (a - 1) // 4)
            """),
    },
    inputs=[
        "2000 2000\n",
        "1900 1900\n",
        "1 3\n",
        "1896 1904\n",
        "2024 2100\n",
        "4 400\n",
        "1 1000000000000000\n",
        "123456789012345 987654321098764\n",
    ],
)

SEATS = Problem(
    id="free-seat",
    level=1,
    statement=text("""
        The seats of a hall are numbered 1, 2, 3, and so on without end. Some are booked; the list of bookings is not in
        order, and may name a seat more than once. Find the k-th free seat, counted from seat 1.

        Input: a line with the number m of bookings (0 to 100000) and k (1 to 10^9); then a line with the m booked
        seats, from 1 to 10^9, which is empty if m is 0.
        Output: the number of the k-th free seat.
        """),
    reference=text("""
        import sys

        data = list(map(int, sys.stdin.read().split()))
        m, k = data[:2]
        seat = k
        for booked in sorted(set(data[2:])):
            if booked <= seat:
                seat += 1
        print(seat)
        """),
    wrong={
        "counts a seat twice that was booked twice": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            seat = data[1]
            for booked in sorted(data[2:]):
                if booked <= seat:
                    seat += 1
            print(seat)
            """),
        "does not move on over seats that come into reach": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            k, booked = data[1], set(data[2:])
            print(k + sum(seat <= k for seat in booked))
            """),
    },
    inputs=[
        "0 5\n\n",
        "3 1\n1 2 3\n",
        "3 2\n2 2 2\n",
        "4 3\n9 1 4 3\n",
        "2 1000000000\n1 1000000000\n",
        f"3000 500\n{row(numbers(5, 3000, 1, 4000))}\n",
        f"2000 1999\n{row(numbers(6, 2000, 1, 3000))}\n",
        "1 1\n2\n",
    ],
)

SWING = Problem(
    id="largest-swing",
    level=1,
    statement=text("""
        A weather station notes the temperature once a day. By how much did it change from one day to the next, at most?

        Input: the number n of days (1 to 100000), and a line with the n temperatures (whole numbers, -1000 to 1000).
        Output: the largest change between two neighbouring days, up or down; 0 if there is one day only.
        """),
    reference=text("""
        n = int(input())
        days = list(map(int, input().split()))
        print(max((abs(a - b) for a, b in zip(days, days[1:])), default=0))
        """),
    wrong={
        "looks at rises alone": text("""
            n = int(input())
            days = list(map(int, input().split()))
            print(max([0] + [b - a for a, b in zip(days, days[1:])]))
            """),
        "compares days that are no neighbours": text("""
            n = int(input())
            days = list(map(int, input().split()))
            print(max(days) - min(days))
            """),
        "fails for a single day": text("""
            n = int(input())
            days = list(map(int, input().split()))
            print(max(abs(a - b) for a, b in zip(days, days[1:])))
            """),
    },
    inputs=[
        _list([3, 7, 2, 2]),
        _list([-5]),
        _list([10, -10, 0]),
        _list([0, 1, 2, 3, 4, 5]),
        _list([1000, -1000]),
        _list([4, 4, 4]),
        _list(numbers(7, 2000, -1000, 1000)),
    ],
)

TICKETS = Problem(
    id="ticket-queue",
    level=2,
    statement=text("""
        People stand in a queue. The first buys one ticket, which takes a minute, and goes to the end of the queue if he
        wants more, and home if he does not. Then it is the next one's turn. You know how many tickets each wants. When
        does the person at place p (counted from 1) hold all of his tickets?

        Input: a line with n and p (1 <= p <= n <= 100000), and a line with the n numbers of tickets (1 to 10^9).
        Output: the number of minutes.
        """),
    reference=text("""
        n, p = map(int, input().split())
        wanted = list(map(int, input().split()))
        mine = wanted[p - 1]
        before = sum(min(count, mine) for count in wanted[:p])
        print(before + sum(min(count, mine - 1) for count in wanted[p:]))
        """),
    wrong={
        "lets those behind buy in the last round too": text("""
            n, p = map(int, input().split())
            wanted = list(map(int, input().split()))
            print(sum(min(count, wanted[p - 1]) for count in wanted))
            """),
        "lets those in front miss the last round": text("""
            n, p = map(int, input().split())
            wanted = list(map(int, input().split()))
            mine = wanted[p - 1]
            print(mine + sum(min(c, mine - 1) for i, c in enumerate(wanted) if i != p - 1))
            """),
    },
    inputs=[
        "3 3\n2 3 2\n",
        "1 1\n5\n",
        "4 1\n1 9 9 9\n",
        "4 4\n9 9 9 1\n",
        "5 2\n1000000000 1000000000 1000000000 1000000000 1000000000\n",
        f"3000 1500\n{row(numbers(8, 3000, 1, 50))}\n",
        f"1000 1\n{row(numbers(9, 1000, 1, 10**9))}\n",
    ],
)

PROBLEMS = [NEXT_BUS, PARKING, VOWELS, LEAP, SEATS, SWING, TICKETS]
