"""Functions that take more thought."""

from __future__ import annotations

from code_problems.problem import Problem, letters, numbers, text

FLATTEN = Problem(
    id="flatten",
    level=2,
    statement=text("""
        Write a function flatten(nested, depth) that returns a new list in which lists within the list are replaced by
        their items, down to the given depth. With depth 0 nothing is replaced; with depth 1 only lists that are items
        of the list itself are; and so on. With depth None there is no list left inside. Only lists count, not texts.
        """),
    function="flatten",
    reference=text("""
        def flatten(nested, depth):
            flat = []
            for item in nested:
                if isinstance(item, list) and depth != 0:
                    flat += flatten(item, None if depth is None else depth - 1)
                else:
                    flat.append(item)
            return flat
        """),
    wrong={
        "always goes all the way down": text("""
            def flatten(nested, depth):
                flat = []
                for item in nested:
                    flat += flatten(item, depth) if isinstance(item, list) else [item]
                return flat
            """),
        "takes None for 0": text("""
            def flatten(nested, depth):
                flat = []
                for item in nested:
                    flat += flatten(item, depth - 1) if isinstance(item, list) and depth else [item]
                return flat
            """),
        "takes texts apart": text("""
            def flatten(nested, depth):
                flat = []
                for item in nested:
                    if hasattr(item, "__iter__") and depth != 0 and item != nested:
                        flat += flatten(list(item), None if depth is None else depth - 1)
                    else:
                        flat.append(item)
                return flat
            """),
    },
    calls=[
        ([1, [2, [3, [4]]]], 1),
        ([1, [2, [3, [4]]]], 0),
        ([1, [2, [3, [4]]]], None),
        ([], None),
        ([[], [[]]], 2),
        (["ab", ["cd", ["ef"]]], 1),
        ([[[["deep"]]], 5], None),
        ([[1], [[2]], [[[3]]]], 2),
    ],
)

DURATION = Problem(
    id="parse-duration",
    level=2,
    statement=text("""
        Write a function parse_duration(text) that returns a duration in seconds. It is written as hours, minutes and
        seconds in this order, each as digits followed by h, m or s; any of the three may be left out, but not all:
        "1h30m" is 5400, "90s" is 90. There is no white space. Anything else raises ValueError.
        """),
    function="parse_duration",
    reference=text("""
        import re


        def parse_duration(text):
            match = re.fullmatch("(?:([0-9]+)h)?(?:([0-9]+)m)?(?:([0-9]+)s)?", text)
            if not text or not match:
                raise ValueError(f"{text!r} is no duration")
            hours, minutes, seconds = (int(part or 0) for part in match.groups())
            return 3600 * hours + 60 * minutes + seconds
        """),
    wrong={
        "adds up whatever it finds": text("""
            import re


            def parse_duration(text):
                units = {"h": 3600, "m": 60, "s": 1}
                return sum(int(count) * units[unit] for count, unit in re.findall("([0-9]+)([hms])", text))
            """),
        "accepts nothing at all": text("""
            import re


            def parse_duration(text):
                match = re.fullmatch("(?:([0-9]+)h)?(?:([0-9]+)m)?(?:([0-9]+)s)?", text)
                if not match:
                    raise ValueError
                h, m, s = (int(part or 0) for part in match.groups())
                return 3600 * h + 60 * m + s
            """),
        "wants all three": text("""
            import re


            def parse_duration(text):
                match = re.fullmatch("([0-9]+)h([0-9]+)m([0-9]+)s", text)
                if not match:
                    raise ValueError
                h, m, s = map(int, match.groups())
                return 3600 * h + 60 * m + s
            """),
    },
    calls=[("1h30m",), ("90s",), ("0s",), ("2h",), ("1h1m1s",), ("100m",), ("007s",)],
    more=text("""
        for wrong in ("", "5", "h", "1m1h", "1h 2m", "1h1h", "-5s", "1d"):
            try:
                candidate(wrong)
                raised = False
            except ValueError:
                raised = True
            assert raised, wrong
        """),
)

ANAGRAMS = Problem(
    id="anagram-groups",
    level=2,
    statement=text("""
        Write a function anagram_groups(words) that puts words together that are made of the same letters, each the same
        number of times. It returns a list of lists: the words of a group in alphabetical order, with repeated words as
        often as they were given, and the groups in the order of their first words. Groups of one word are included.
        """),
    function="anagram_groups",
    reference=text("""
        def anagram_groups(words):
            groups = {}
            for word in sorted(words):
                groups.setdefault("".join(sorted(word)), []).append(word)
            return sorted(groups.values())
        """),
    wrong={
        "does not mind how often a letter occurs": text("""
            def anagram_groups(words):
                groups = {}
                for word in sorted(words):
                    groups.setdefault(frozenset(word), []).append(word)
                return sorted(groups.values())
            """),
        "drops repeated words": text("""
            def anagram_groups(words):
                groups = {}
                for word in sorted(set(words)):
                    groups.setdefault("".join(sorted(word)), []).append(word)
                return sorted(groups.values())
            """),
        "leaves groups in the order of arrival": text("""
            def anagram_groups(words):
                groups = {}
                for word in words:
                    groups.setdefault("".join(sorted(word)), []).append(word)
                return [sorted(group) for group in groups.values()]
            """),
    },
    calls=[
        (["tea", "eat", "tan", "ate", "nat", "bat"],),
        ([],),
        (["a"],),
        (["ab", "aab", "ba", "baa"],),
        (["on", "no", "on"],),
        (["", ""],),
        ([letters(seed, 3, "abc") for seed in range(60)],),
    ],
    check_form=False,
)

EVALUATE = Problem(
    id="evaluate",
    level=3,
    statement=text("""
        Write a function evaluate(expression) that works out an expression of whole numbers, + - * and round brackets.
        Multiplication comes before addition and subtraction, which go from left to right. A minus sign may also stand
        in front of a number, a bracket or another such minus sign. Blanks may stand anywhere but inside a number.
        """),
    function="evaluate",
    reference=text("""
        import re


        def evaluate(expression):
            tokens = re.findall(r"[0-9]+|[-+*()]", expression)
            place = 0

            def factor():
                nonlocal place
                token = tokens[place]
                place += 1
                if token == "-":
                    return -factor()
                if token == "(":
                    value = total()
                    place += 1
                    return value
                return int(token)

            def product():
                nonlocal place
                value = factor()
                while place < len(tokens) and tokens[place] == "*":
                    place += 1
                    value *= factor()
                return value

            def total():
                nonlocal place
                value = product()
                while place < len(tokens) and tokens[place] in "+-":
                    place += 1
                    value += product() if tokens[place - 1] == "+" else -product()
                return value

            return total()
        """),
    wrong={
        "goes from left to right throughout": text("""
            import re


            def evaluate(expression):
                while "(" in expression:
                    expression = re.sub(r"[(]([^()]*)[)]", lambda m: str(evaluate(m[1])), expression)
                tokens = re.findall(r"(?:(?<=[-+*])|^)-?[0-9]+|[-+*]|[0-9]+", expression.replace(" ", ""))
                value = int(tokens[0])
                for sign, number in zip(tokens[1::2], tokens[2::2]):
                    value = {"+": value + int(number), "-": value - int(number), "*": value * int(number)}[sign]
                return value
            """),
        "has no minus sign in front of a bracket": text("""
            def evaluate(expression):
                text = expression.replace(" ", "")
                if "-(" in text or "--" in text:
                    return 0
                return eval(text)
            """),
        "subtracts from right to left": text("""
            def evaluate(expression):
                text = expression.replace(" ", "")

                def total(t):
                    depth = 0
                    for i, c in enumerate(t):
                        depth += (c == "(") - (c == ")")
                        if i and not depth and c in "+-" and t[i - 1] not in "+-*(":
                            rest = total(t[i + 1 :])
                            return total(t[:i]) + (rest if c == "+" else -rest)
                    return eval(t)

                return total(text)
            """),
    },
    calls=[
        ("1 + 2 * 3",),
        ("(1 + 2) * 3",),
        ("10 - 4 - 3",),
        ("-(2 + 3) * 2",),
        ("--5",),
        ("2*-3",),
        ("7",),
        ("((((1))))",),
        ("100 - (3 - (20 - 5)) * 2 - 1",),
        ("123456789 * 987654321 - 1",),
    ],
)

LRU = Problem(
    id="least-recently-used",
    level=3,
    statement=text("""
        A cache holds at most `capacity` (1 or more) entries. Write a function lru(capacity, operations) that plays
        operations on an empty cache and returns the list of what the lookups found. An operation is ("put", key, value)
        or ("get", key). A get finds the value, or None. If a put of a new key would exceed the capacity, the entry goes
        that was not used for the longest time; both a get that finds its key and a put are uses.
        """),
    function="lru",
    reference=text("""
        def lru(capacity, operations):
            cache, found = {}, []
            for operation, key, *value in operations:
                if operation == "get":
                    found.append(cache.get(key))
                    if key in cache:
                        cache[key] = cache.pop(key)
                else:
                    cache.pop(key, None)
                    if len(cache) == capacity:
                        del cache[next(iter(cache))]
                    cache[key] = value[0]
            return found
        """),
    wrong={
        "drops the entry that came first": text("""
            def lru(capacity, operations):
                cache, found = {}, []
                for operation, key, *value in operations:
                    if operation == "get":
                        found.append(cache.get(key))
                    else:
                        cache.pop(key, None)
                        if len(cache) == capacity:
                            del cache[next(iter(cache))]
                        cache[key] = value[0]
                return found
            """),
        "does not count a put to a known key as use": text("""
            def lru(capacity, operations):
                cache, found = {}, []
                for operation, key, *value in operations:
                    if operation == "get":
                        found.append(cache.get(key))
                        if key in cache:
                            cache[key] = cache.pop(key)
                    else:
                        if key not in cache and len(cache) == capacity:
                            del cache[next(iter(cache))]
                        cache[key] = value[0]
                return found
            """),
        "drops an entry for a key that is there already": text("""
            def lru(capacity, operations):
                cache, found = {}, []
                for operation, key, *value in operations:
                    if operation == "get":
                        found.append(cache.get(key))
                        if key in cache:
                            cache[key] = cache.pop(key)
                    else:
                        if len(cache) == capacity:
                            del cache[next(iter(cache))]
                        cache.pop(key, None)
                        cache[key] = value[0]
                return found
            """),
    },
    calls=[
        (2, [("put", 1, "a"), ("put", 2, "b"), ("get", 1), ("put", 3, "c"), ("get", 2), ("get", 1), ("get", 3)]),
        (1, [("get", 1), ("put", 1, 1), ("get", 1), ("put", 2, 2), ("get", 1), ("get", 2)]),
        (2, [("put", 1, "a"), ("put", 2, "b"), ("put", 1, "A"), ("put", 3, "c"), ("get", 1), ("get", 2)]),
        (2, [("put", 1, "a"), ("put", 2, "b"), ("put", 2, "B"), ("get", 1), ("get", 2)]),
        (3, []),
        (2, [("put", "x", None), ("get", "x"), ("put", "y", 0), ("put", "z", 1), ("get", "x"), ("get", "y")]),
        (
            5,
            [("put", key, number) if number % 3 else ("get", key) for number, key in enumerate(numbers(44, 200, 1, 9))],
        ),
    ],
)

SPIRAL = Problem(
    id="spiral",
    level=3,
    statement=text("""
        Write a function spiral(matrix) that returns the numbers of a rectangular matrix, a list of rows of equal
        length, in the order of a spiral: along the first row, down the last column, back along the last row, up the
        first column, and so on inwards. The matrix may have no rows, or rows without columns.
        """),
    function="spiral",
    reference=text("""
        def spiral(matrix):
            numbers = []
            rows = [list(row) for row in matrix]
            while rows:
                numbers += rows.pop(0)
                rows = [list(column) for column in zip(*rows)][::-1]
            return numbers
        """),
    wrong={
        "reads a lone row or column twice": text("""
            def spiral(matrix):
                numbers = []
                if not matrix:
                    return numbers
                top, bottom, left, right = 0, len(matrix) - 1, 0, len(matrix[0]) - 1
                while top <= bottom and left <= right:
                    numbers += [matrix[top][c] for c in range(left, right + 1)]
                    numbers += [matrix[r][right] for r in range(top + 1, bottom + 1)]
                    numbers += [matrix[bottom][c] for c in range(right - 1, left - 1, -1)]
                    numbers += [matrix[r][left] for r in range(bottom - 1, top, -1)]
                    top, bottom, left, right = top + 1, bottom - 1, left + 1, right - 1
                return numbers
            """),
        "turns to the other side": text("""
            def spiral(matrix):
                numbers, rows = [], [list(row) for row in zip(*matrix)]
                while rows:
                    numbers += rows.pop(0)
                    rows = [list(column) for column in zip(*rows)][::-1]
                return numbers
            """),
        "takes every matrix to be square": text("""
            def spiral(matrix):
                n, numbers, layer = len(matrix), [], 0
                while 2 * layer < n:
                    a, b = layer, n - 1 - layer
                    numbers += matrix[a][a : b + 1]
                    numbers += [matrix[r][b] for r in range(a + 1, b + 1)]
                    if a < b:
                        numbers += [matrix[b][c] for c in range(b - 1, a - 1, -1)]
                        numbers += [matrix[r][a] for r in range(b - 1, a, -1)]
                    layer += 1
                return numbers
            """),
    },
    calls=[
        ([[1, 2, 3], [4, 5, 6], [7, 8, 9]],),
        ([[1, 2, 3, 4]],),
        ([[1], [2], [3]],),
        ([],),
        ([[]],),
        ([[1, 2], [3, 4], [5, 6]],),
        ([[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12]],),
        ([numbers(seed, 7, 0, 99) for seed in range(5)],),
    ],
)

BACKPACK = Problem(
    id="backpack",
    level=3,
    statement=text("""
        Write a function best_value(things, capacity) that returns the highest total value of things that fit into a
        backpack. things is a list of pairs (weight, value) of whole numbers from 0 up; each thing can be taken once or
        left. The weights that are taken add up to at most capacity (0 to 10000). There are up to 60 things.
        """),
    function="best_value",
    reference=text("""
        def best_value(things, capacity):
            best = [0] * (capacity + 1)
            for weight, value in things:
                for room in range(capacity, weight - 1, -1):
                    best[room] = max(best[room], best[room - weight] + value)
            return best[capacity]
        """),
    wrong={
        "takes what is worth most for its weight": text("""
            def best_value(things, capacity):
                total = 0
                for weight, value in sorted(things, key=lambda t: -t[1] / (t[0] or 1e-9)):
                    if weight <= capacity:
                        capacity, total = capacity - weight, total + value
                return total
            """),
        "takes a thing more than once": text("""
            def best_value(things, capacity):
                best = [0] * (capacity + 1)
                for weight, value in things:
                    for room in range(max(weight, 1), capacity + 1):
                        best[room] = max(best[room], best[room - weight] + value)
                return best[capacity]
            """),
        "wants the backpack to be full": text("""
            def best_value(things, capacity):
                best = [0] + [float("-inf")] * capacity
                for weight, value in things:
                    for room in range(capacity, weight - 1, -1):
                        best[room] = max(best[room], best[room - weight] + value)
                return max(best[capacity], 0)
            """),
    },
    calls=[
        ([(5, 10), (4, 40), (6, 30), (3, 50)], 10),
        ([], 5),
        ([(1, 1)], 0),
        ([(0, 7), (2, 3)], 1),
        ([(10, 60), (20, 100), (30, 120)], 50),
        ([(3, 5)], 10),
        ([(6, 7), (5, 5), (5, 5)], 10),
        (list(zip(numbers(45, 40, 1, 90), numbers(46, 40, 0, 500), strict=True)), 700),
    ],
)

PROBLEMS = [FLATTEN, DURATION, ANAGRAMS, EVALUATE, LRU, SPIRAL, BACKPACK]
