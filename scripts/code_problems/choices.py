"""Whole programs that choose, count and search."""

from __future__ import annotations

from code_problems.problem import Problem, letters, numbers, row, text


def _list(values: list[int], *first: object) -> str:
    return f"{row([len(values), *first])}\n{row(values)}\n"


COINS = Problem(
    id="ways-to-pay",
    level=2,
    statement=text("""
        In how many ways can an amount be paid exactly with coins of given kinds? There are as many coins of each kind
        as you like, and the order in which coins are put down does not matter.

        Input: a line with the number n of kinds and the amount a (1 <= n <= 50, 0 <= a <= 20000); a line with the n
        values (1 to 20000), of which no two are equal.
        Output: the number of ways modulo 1000000007.
        """),
    reference=text("""
        n, amount = map(int, input().split())
        ways = [1] + [0] * amount
        for coin in map(int, input().split()):
            for total in range(coin, amount + 1):
                ways[total] = (ways[total] + ways[total - coin]) % 1_000_000_007
        print(ways[amount])
        """),
    wrong={
        "counts orders of coins as different ways": text("""
            n, amount = map(int, input().split())
            coins = list(map(int, input().split()))
            ways = [1] + [0] * amount
            for total in range(1, amount + 1):
                ways[total] = sum(ways[total - c] for c in coins if c <= total) % 1_000_000_007
            print(ways[amount])
            """),
        "has one coin of each kind": text("""
            n, amount = map(int, input().split())
            ways = [1] + [0] * amount
            for coin in map(int, input().split()):
                for total in range(amount, coin - 1, -1):
                    ways[total] = (ways[total] + ways[total - coin]) % 1_000_000_007
            print(ways[amount])
            """),
        "forgets the modulus": text("""
            n, amount = map(int, input().split())
            ways = [1] + [0] * amount
            for coin in map(int, input().split()):
                for total in range(coin, amount + 1):
                    ways[total] += ways[total - coin]
            print(ways[amount])
            """),
    },
    inputs=[
        "3 5\n1 2 5\n",
        "1 3\n2\n",
        "2 0\n1 2\n",
        "1 7\n7\n",
        "4 10\n10 5 2 1\n",
        "10 5000\n1 2 3 4 5 6 7 8 9 10\n",
        "6 9999\n1 5 10 25 50 100\n",
    ],
)

CLIMB = Problem(
    id="longest-climb",
    level=3,
    statement=text("""
        Along a path stand signs with heights. You may read as many signs as you like, leaving out others, but always in
        the order of the path. How many can you read at most so that each is strictly higher than the one before?

        Input: a line with the number n of signs (1 to 100000), and a line with the n heights (-10^9 to 10^9).
        Output: the largest number of signs.
        """),
    reference=text("""
        from bisect import bisect_left

        input()
        lowest = []
        for height in map(int, input().split()):
            place = bisect_left(lowest, height)
            lowest[place : place + 1] = [height]
        print(len(lowest))
        """),
    wrong={
        "reads equal heights too": text("""
            from bisect import bisect_right
            input()
            lowest = []
            for height in map(int, input().split()):
                place = bisect_right(lowest, height)
                lowest[place : place + 1] = [height]
            print(len(lowest))
            """),
        "leaves out no sign in between": text("""
            input()
            heights = list(map(int, input().split()))
            best = run = 1
            for a, b in zip(heights, heights[1:]):
                run = run + 1 if b > a else 1
                best = max(best, run)
            print(best)
            """),
        "takes every sign that is higher than the last one taken": text("""
            input()
            count, last = 0, -10**10
            for height in map(int, input().split()):
                if height > last:
                    count, last = count + 1, height
            print(count)
            """),
    },
    inputs=[
        _list([3, 1, 2, 5, 4]),
        _list([7]),
        _list([2, 2, 2]),
        _list([9, 8, 7]),
        _list([10, 1, 2, 3]),
        _list([-5, 0, -3, 4, -1, 2]),
        _list(numbers(30, 1000, -(10**9), 10**9)),
        _list(numbers(31, 2000, 1, 60)),
    ],
)

ROPE = Problem(
    id="rope-pieces",
    level=3,
    statement=text("""
        There are n ropes. From them you need at least k pieces of one and the same length, in whole centimetres; a
        piece is cut from a single rope, and what is left over is thrown away. How long can the pieces be?

        Input: a line with n and k (1 <= n <= 100000, 1 <= k <= 10^9), and a line with the lengths of the ropes in
        centimetres (1 to 10^9).
        Output: the greatest length, or 0 if not even pieces of one centimetre suffice.
        """),
    reference=text("""
        n, k = map(int, input().split())
        ropes = list(map(int, input().split()))
        low, high = 0, max(ropes)
        while low < high:
            middle = (low + high + 1) // 2
            if sum(rope // middle for rope in ropes) >= k:
                low = middle
            else:
                high = middle - 1
        print(low)
        """),
    wrong={
        "ties the ropes together": text("""
            n, k = map(int, input().split())
            print(sum(map(int, input().split())) // k)
            """),
        "stops one short": text("""
            n, k = map(int, input().split())
            ropes = list(map(int, input().split()))
            low, high = 0, max(ropes)
            while low + 1 < high:
                middle = (low + high) // 2
                if sum(rope // middle for rope in ropes) >= k:
                    low = middle
                else:
                    high = middle
            print(low)
            """),
        "divides by zero where there is too little rope": text("""
            n, k = map(int, input().split())
            ropes = list(map(int, input().split()))
            length = max(ropes)
            low, high = 1, length
            while sum(rope // length for rope in ropes) < k:
                length = (low + high) // 2
                if sum(rope // length for rope in ropes) >= k and sum(rope // (length + 1) for rope in ropes) < k:
                    break
                if sum(rope // length for rope in ropes) >= k:
                    low, length = length + 1, high + 1
                else:
                    high = length - 1
            print(length)
            """),
    },
    inputs=[
        _list([8, 7, 4], 5),
        _list([10], 1),
        _list([1, 1, 1], 4),
        _list([5, 5], 2),
        _list([1000000000, 1], 1000000000),
        _list([3, 9, 14], 3),
        _list(numbers(32, 1500, 1, 10**9), 20_000),
        _list(numbers(33, 300, 1, 100), 9000),
    ],
)

EDIT = Problem(
    id="edit-cost",
    level=3,
    statement=text("""
        Turn one word into another. To insert a letter costs i, to delete one costs d, and to replace one by another
        costs r. What is the lowest total cost?

        Input: a line with i, d and r (0 to 1000 each), then the first word, then the second, each on a line of its own;
        a word has up to 400 small letters, and may be empty.
        Output: the lowest cost.
        """),
    reference=text("""
        import sys

        costs, first, second = (sys.stdin.read() + "\\n\\n").split("\\n")[:3]
        insert, delete, replace = map(int, costs.split())
        line = [insert * j for j in range(len(second) + 1)]
        for a in first:
            above, line = line, [line[0] + delete]
            for j, b in enumerate(second):
                same = above[j] + (0 if a == b else replace)
                line.append(min(same, above[j + 1] + delete, line[j] + insert))
        print(line[-1])
        """),
    wrong={
        "mixes up inserting and deleting": text("""
            import sys
            costs, first, second = (sys.stdin.read() + "\\n\\n").split("\\n")[:3]
            delete, insert, replace = map(int, costs.split())
            line = [insert * j for j in range(len(second) + 1)]
            for a in first:
                above, line = line, [line[0] + delete]
                for j, b in enumerate(second):
                    line.append(min(above[j] + replace * (a != b), above[j + 1] + delete, line[j] + insert))
            print(line[-1])
            """),
        "lets every step cost one": text("""
            import sys
            costs, first, second = (sys.stdin.read() + "\\n\\n").split("\\n")[:3]
            line = list(range(len(second) + 1))
            for a in first:
                above, line = line, [line[0] + 1]
                for j, b in enumerate(second):
                    line.append(min(above[j] + (a != b), above[j + 1] + 1, line[j] + 1))
            print(line[-1])
            """),
        "never deletes and inserts where replacing is dearer": text("""
            import sys
            costs, first, second = (sys.stdin.read() + "\\n\\n").split("\\n")[:3]
            insert, delete, replace = map(int, costs.split())
            changed = sum(a != b for a, b in zip(first, second))
            more = len(second) - len(first)
            print(changed * replace + (more * insert if more > 0 else -more * delete))
            """),
    },
    inputs=[
        "1 1 1\nkitchen\nchicken\n",
        "2 3 100\nabc\nxyz\n",
        "5 7 1\n\nabc\n",
        "5 7 1\nabc\n\n",
        "4 4 4\nsame\nsame\n",
        "0 1000 1000\na\nbbb\n",
        f"3 5 6\n{letters(34, 120, 'abcd')}\n{letters(35, 100, 'abcd')}\n",
        f"10 1 9\n{letters(36, 200, 'xy')}\n{letters(37, 190, 'xyz')}\n",
    ],
)

MEDIANS = Problem(
    id="running-median",
    level=3,
    statement=text("""
        Numbers arrive one by one. After each, give the median of all that have arrived so far: the one in the middle
        when they are in order, and of two in the middle the smaller one.

        Input: a line with n (1 to 100000), and a line with the n numbers (-10^9 to 10^9).
        Output: one line with the n medians.
        """),
    reference=text("""
        import heapq

        input()
        lower, upper, medians = [], [], []
        for number in map(int, input().split()):
            heapq.heappush(upper, -heapq.heappushpop(lower, -number))
            if len(upper) > len(lower):
                heapq.heappush(lower, -heapq.heappop(upper))
            medians.append(-lower[0])
        print(*medians)
        """),
    wrong={
        "gives the larger of two in the middle": text("""
            from bisect import insort
            input()
            seen, medians = [], []
            for number in map(int, input().split()):
                insort(seen, number)
                medians.append(seen[len(seen) // 2])
            print(*medians)
            """),
        "gives the mean of two in the middle": text("""
            from bisect import insort
            from statistics import median
            input()
            seen, medians = [], []
            for number in map(int, input().split()):
                insort(seen, number)
                medians.append(int(median(seen)))
            print(*medians)
            """),
        "gives the number in the middle of the order of arrival": text("""
            input()
            numbers = list(map(int, input().split()))
            print(*(numbers[i // 2] for i in range(len(numbers))))
            """),
    },
    inputs=[
        _list([5, 1, 4, 2]),
        _list([7]),
        _list([1, 1, 1, 2]),
        _list([1, 2, 3, 4, 5, 6]),
        _list([6, 5, 4, 3, 2, 1]),
        _list([-1000000000, 1000000000]),
        _list(numbers(38, 800, -1000, 1000)),
    ],
)

PROBLEMS = [COINS, CLIMB, ROPE, EDIT, MEDIANS]
