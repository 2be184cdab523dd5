"""Whole programs on networks, orders and sums that change."""

from __future__ import annotations

import random

from code_problems.problem import Problem, text


def _network(seed: int, nodes: int, edges: int, *, weight: int = 0, query: tuple[int, int] | None = None) -> str:
    generator = random.Random(seed)
    lines = []
    for _ in range(edges):
        edge = [generator.randint(1, nodes), generator.randint(1, nodes)]
        lines.append(" ".join(map(str, edge + ([generator.randint(1, weight)] if weight else []))))
    ends = query or (1, nodes)
    return f"{nodes} {edges} {ends[0]} {ends[1]}\n" + "".join(f"{line}\n" for line in lines)


def _orders(seed: int, tasks: int, rules: int) -> str:
    """Return rules that some order of the tasks keeps."""
    generator = random.Random(seed)
    order = generator.sample(range(1, tasks + 1), tasks)
    lines = []
    for _ in range(rules):
        a, b = sorted(generator.sample(range(tasks), 2))
        lines.append(f"{order[a]} {order[b]}\n")
    return f"{tasks} {rules}\n" + "".join(lines)


def _ledger(seed: int, count: int, queries: int) -> str:
    generator = random.Random(seed)
    lines = [" ".join(str(generator.randint(-1000, 1000)) for _ in range(count))]
    for _ in range(queries):
        if generator.random() < 0.5:
            lines.append(f"add {generator.randint(1, count)} {generator.randint(-1000, 1000)}")
        else:
            a, b = sorted(generator.randint(1, count) for _ in range(2))
            lines.append(f"sum {a} {b}")
    return f"{count} {queries}\n" + "\n".join([*lines, f"sum 1 {count}"][: queries + 1]) + "\n"


HOPS = Problem(
    id="fewest-hops",
    level=2,
    statement=text("""
        Airports are joined by direct flights, each of which goes both ways. How many flights does it take, at least, to
        get from airport s to airport t?

        Input: a line with the number n of airports, the number m of flights, s and t (1 <= n <= 50000,
        0 <= m <= 100000); then m lines with the two airports of a flight, which may be named twice, or be the same.
        Output: the smallest number of flights, or -1 if there is no way.
        """),
    reference=text("""
        import sys
        from collections import deque

        data = list(map(int, sys.stdin.read().split()))
        n, m, s, t = data[:4]
        near = [[] for _ in range(n + 1)]
        for a, b in zip(data[4::2], data[5::2]):
            near[a].append(b)
            near[b].append(a)
        hops = {s: 0}
        queue = deque([s])
        while queue:
            here = queue.popleft()
            for there in near[here]:
                if there not in hops:
                    hops[there] = hops[here] + 1
                    queue.append(there)
        print(hops.get(t, -1))
        """),
    wrong={
        "takes flights to go one way": text("""
            import sys
            from collections import deque
            data = list(map(int, sys.stdin.read().split()))
            n, m, s, t = data[:4]
            near = [[] for _ in range(n + 1)]
            for a, b in zip(data[4::2], data[5::2]):
                near[a].append(b)
            hops, queue = {s: 0}, deque([s])
            while queue:
                here = queue.popleft()
                for there in near[here]:
                    if there not in hops:
                        hops[there] = hops[here] + 1
                        queue.append(there)
            print(hops.get(t, -1))
            """),
        "goes deep first and keeps the first way it finds": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            n, m, s, t = data[:4]
            near = [[] for _ in range(n + 1)]
            for a, b in zip(data[4::2], data[5::2]):
                near[a].append(b)
                near[b].append(a)
            hops, stack = {s: 0}, [s]
            while stack:
                here = stack.pop()
                for there in near[here]:
                    if there not in hops:
                        hops[there] = hops[here] + 1
                        stack.append(there)
            print(hops.get(t, -1))
            """),
        "fails where there is no way": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            n, m, s, t = data[:4]
            near = [set() for _ in range(n + 1)]
            for a, b in zip(data[4::2], data[5::2]):
                near[a].add(b)
                near[b].add(a)
            seen, count = {s}, 0
            while t not in seen:
                seen = seen.union(*(near[x] for x in seen))
                count += 1
                if count > n:
                    raise ValueError("no way")
            print(count)
            """),
    },
    inputs=[
        "4 3 1 4\n1 2\n2 3\n3 4\n",
        "4 3 4 1\n1 2\n2 3\n3 4\n",
        "3 1 1 3\n1 2\n",
        "1 0 1 1\n",
        "6 7 1 6\n1 2\n2 3\n3 6\n1 4\n4 5\n5 6\n1 6\n",
        "5 6 1 5\n1 2\n1 3\n3 4\n4 5\n2 5\n1 1\n",
        _network(20, 300, 420),
        _network(21, 1000, 2000, query=(17, 998)),
    ],
)

ROUTE = Problem(
    id="cheapest-route",
    level=3,
    statement=text("""
        One-way roads join towns, each with a toll. What is the smallest sum of tolls on a way from town s to town t?

        Input: a line with the number n of towns, the number m of roads, s and t (1 <= n <= 20000, 0 <= m <= 50000);
        then m lines with where a road begins, where it ends, and its toll (1 to 10^6).
        Output: the smallest sum of tolls, 0 if s is t, or -1 if there is no way.
        """),
    reference=text("""
        import heapq
        import sys

        data = list(map(int, sys.stdin.read().split()))
        n, m, s, t = data[:4]
        roads = [[] for _ in range(n + 1)]
        for a, b, toll in zip(data[4::3], data[5::3], data[6::3]):
            roads[a].append((b, toll))
        best = [None] * (n + 1)
        heap = [(0, s)]
        while heap:
            cost, here = heapq.heappop(heap)
            if best[here] is not None:
                continue
            best[here] = cost
            for there, toll in roads[here]:
                if best[there] is None:
                    heapq.heappush(heap, (cost + toll, there))
        print(-1 if best[t] is None else best[t])
        """),
    wrong={
        "takes the way with the fewest roads": text("""
            import sys
            from collections import deque
            data = list(map(int, sys.stdin.read().split()))
            n, m, s, t = data[:4]
            roads = [[] for _ in range(n + 1)]
            for a, b, toll in zip(data[4::3], data[5::3], data[6::3]):
                roads[a].append((b, toll))
            cost, queue = {s: 0}, deque([s])
            while queue:
                here = queue.popleft()
                for there, toll in roads[here]:
                    if there not in cost:
                        cost[there] = cost[here] + toll
                        queue.append(there)
            print(cost.get(t, -1))
            """),
        "always follows the cheapest road": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            n, m, s, t = data[:4]
            roads = [[] for _ in range(n + 1)]
            for a, b, toll in zip(data[4::3], data[5::3], data[6::3]):
                roads[a].append((toll, b))
            here, total, seen = s, 0, {s}
            while here != t:
                open_roads = [road for road in roads[here] if road[1] not in seen]
                if not open_roads:
                    total = -1
                    break
                toll, here = min(open_roads)
                seen.add(here)
                total += toll
            print(total)
            """),
        "lets roads be driven both ways": text("""
            import heapq
            import sys
            data = list(map(int, sys.stdin.read().split()))
            n, m, s, t = data[:4]
            roads = [[] for _ in range(n + 1)]
            for a, b, toll in zip(data[4::3], data[5::3], data[6::3]):
                roads[a].append((b, toll))
                roads[b].append((a, toll))
            best, heap = {}, [(0, s)]
            while heap:
                cost, here = heapq.heappop(heap)
                if here not in best:
                    best[here] = cost
                    for there, toll in roads[here]:
                        heapq.heappush(heap, (cost + toll, there))
            print(best.get(t, -1))
            """),
    },
    inputs=[
        "3 3 1 3\n1 3 10\n1 2 3\n2 3 4\n",
        "2 1 2 1\n1 2 5\n",
        "1 0 1 1\n",
        "4 4 1 4\n1 2 1\n2 3 100\n1 3 5\n3 4 1\n",
        "3 3 1 3\n1 2 9\n1 2 4\n2 3 1\n",
        _network(22, 100, 300, weight=1000),
        _network(23, 500, 2000, weight=1_000_000),
        _network(24, 800, 1200, weight=50, query=(3, 700)),
    ],
)

TASKS = Problem(
    id="task-order",
    level=3,
    statement=text("""
        Tasks are numbered from 1 to n. Each of m rules says that task a has to be done before task b. Give the order in
        which all tasks are done; whenever there are several that could come next, the one with the smallest number
        does.

        Input: a line with n and m (1 <= n <= 50000, 0 <= m <= 100000), then m lines with a and b.
        Output: the tasks in order, separated by blanks; or IMPOSSIBLE if no order keeps all rules.
        """),
    reference=text("""
        import heapq
        import sys

        data = list(map(int, sys.stdin.read().split()))
        n, m = data[:2]
        after = [[] for _ in range(n + 1)]
        waits = [0] * (n + 1)
        for a, b in zip(data[2::2], data[3::2]):
            after[a].append(b)
            waits[b] += 1
        ready = [task for task in range(1, n + 1) if not waits[task]]
        order = []
        while ready:
            task = heapq.heappop(ready)
            order.append(task)
            for later in after[task]:
                waits[later] -= 1
                if not waits[later]:
                    heapq.heappush(ready, later)
        print(*order if len(order) == n else ["IMPOSSIBLE"])
        """),
    wrong={
        "does tasks in the order in which they become possible": text("""
            import sys
            from collections import deque
            data = list(map(int, sys.stdin.read().split()))
            n, m = data[:2]
            after, waits = [[] for _ in range(n + 1)], [0] * (n + 1)
            for a, b in zip(data[2::2], data[3::2]):
                after[a].append(b)
                waits[b] += 1
            ready, order = deque(t for t in range(1, n + 1) if not waits[t]), []
            while ready:
                order.append(ready.popleft())
                for later in after[order[-1]]:
                    waits[later] -= 1
                    if not waits[later]:
                        ready.append(later)
            print(*order if len(order) == n else ["IMPOSSIBLE"])
            """),
        "does not notice rules in a circle": text("""
            import heapq
            import sys
            data = list(map(int, sys.stdin.read().split()))
            n, m = data[:2]
            after, waits = [[] for _ in range(n + 1)], [0] * (n + 1)
            for a, b in zip(data[2::2], data[3::2]):
                after[a].append(b)
                waits[b] += 1
            ready, order = [t for t in range(1, n + 1) if not waits[t]], []
            while ready:
                order.append(heapq.heappop(ready))
                for later in after[order[-1]]:
                    waits[later] -= 1
                    if not waits[later]:
                        heapq.heappush(ready, later)
            print(*order)
            """),
        "sorts by what comes first in the rules": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            n, m = data[:2]
            before = {t: set() for t in range(1, n + 1)}
            for a, b in zip(data[2::2], data[3::2]):
                before[b].add(a)
            order = sorted(before, key=lambda t: (len(before[t]), t))
            print(*order)
            """),
    },
    inputs=[
        "4 3\n1 2\n3 2\n4 3\n",
        "3 0\n",
        "2 2\n1 2\n2 1\n",
        "3 1\n2 2\n",
        "5 4\n5 1\n4 2\n4 3\n1 2\n",
        "3 2\n3 1\n3 1\n",
        _orders(25, 200, 300),
        _orders(26, 1500, 1500),
    ],
)

LEDGER = Problem(
    id="running-ledger",
    level=3,
    statement=text("""
        A ledger has n accounts. Orders come one after another: "add i v" adds v to account i, and "sum a b" asks for
        the sum of all accounts from a to b, both included.

        Input: a line with n and the number q of orders (1 <= n, q <= 100000); a line with the n accounts as they are at
        first; then the q orders, with numbers from -10^9 to 10^9 and 1 <= a <= b <= n.
        Output: for each "sum", a line with the answer.
        """),
    reference=text("""
        import sys

        read = sys.stdin.readline
        n, q = map(int, read().split())
        tree = [0, *map(int, read().split())]
        for i in range(1, n + 1):
            above = i + (i & -i)
            if above <= n:
                tree[above] += tree[i]

        def until(i):
            total = 0
            while i:
                total += tree[i]
                i -= i & -i
            return total

        for _ in range(q):
            word, a, b = read().split()
            a, b = int(a), int(b)
            if word == "sum":
                print(until(b) - until(a - 1))
            else:
                while a <= n:
                    tree[a] += b
                    a += a & -a
        """),
    wrong={
        "answers from the first state for ever": text("""
            from itertools import accumulate
            n, q = map(int, input().split())
            sums = [0, *accumulate(map(int, input().split()))]
            for _ in range(q):
                word, a, b = input().split()
                if word == "sum":
                    print(sums[int(b)] - sums[int(a) - 1])
            """),
        "leaves out the last account": text("""
            n, q = map(int, input().split())
            accounts = list(map(int, input().split()))
            for _ in range(q):
                word, a, b = input().split()
                if word == "sum":
                    print(sum(accounts[int(a) - 1 : int(b) - 1]))
                else:
                    accounts[int(a) - 1] += int(b)
            """),
        "sets an account where it should add": text("""
            n, q = map(int, input().split())
            accounts = list(map(int, input().split()))
            for _ in range(q):
                word, a, b = input().split()
                if word == "sum":
                    print(sum(accounts[int(a) - 1 : int(b)]))
                else:
                    accounts[int(a) - 1] = int(b)
            """),
    },
    inputs=[
        "5 4\n1 2 3 4 5\nsum 2 4\nadd 3 10\nsum 1 5\nsum 3 3\n",
        "1 3\n7\nsum 1 1\nadd 1 -7\nsum 1 1\n",
        "2 2\n-1000000000 1000000000\nadd 1 -1000000000\nsum 1 2\n",
        "3 3\n0 0 0\nadd 1 5\nadd 1 5\nsum 1 3\n",
        _ledger(27, 50, 200),
        _ledger(28, 900, 900),
        _ledger(29, 8, 100),
    ],
)

PROBLEMS = [HOPS, ROUTE, TASKS, LEDGER]
