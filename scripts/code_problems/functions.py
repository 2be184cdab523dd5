"""Functions on lists, texts and numbers."""

from __future__ import annotations

from code_problems.problem import Problem, letters, numbers, text

CLAMP = Problem(
    id="clamp-all",
    level=1,
    statement=text("""
        Write a function clamp_all(values, low, high) that returns a new list in which each number below low is replaced
        by low, and each above high by high. If low is greater than high, it raises ValueError. The list that was given
        stays as it is.
        """),
    function="clamp_all",
    reference=text("""
        def clamp_all(values, low, high):
            if low > high:
                raise ValueError("low is greater than high")
            return [min(max(value, low), high) for value in values]
        """),
    wrong={
        "leaves out what is out of range": text("""
            def clamp_all(values, low, high):
                if low > high:
                    raise ValueError
                return [value for value in values if low <= value <= high]
            """),
        "changes the given list": text("""
            def clamp_all(values, low, high):
                if low > high:
                    raise ValueError
                for i, value in enumerate(values):
                    values[i] = min(max(value, low), high)
                return values
            """),
        "does not mind bounds in the wrong order": text("""
            def clamp_all(values, low, high):
                return [min(max(value, low), high) for value in values]
            """),
    },
    calls=[([1, 5, 9], 2, 8), ([], 0, 1), ([3], 3, 3), ([-5, 0, 5], -1, 1), ([1.5, 2.5], 2, 2.25), ([7, 7], 0, 10)],
    more=text("""
        given = [0, 10]
        assert candidate(given, 3, 4) == [3, 4] and given == [0, 10]
        try:
            candidate([1], 2, 1)
            raised = False
        except ValueError:
            raised = True
        assert raised
        """),
)

INITIALS = Problem(
    id="initials",
    level=1,
    statement=text("""
        Write a function initials(name) that returns the first letters of the words of a name as capitals, each followed
        by a full stop: "ada king lovelace" gives "A.K.L.". There may be any white space before, between and behind the
        words. A hyphen joins two names, which both count: "jean-luc" gives "J.-L.". An empty name gives "".
        """),
    function="initials",
    reference=text("""
        def initials(name):
            return "".join("-".join(f"{part[0].upper()}." for part in word.split("-") if part) for word in name.split())
        """),
    wrong={
        "stumbles over two blanks in a row": text("""
            def initials(name):
                return "".join("-".join(p[0].upper() + "." for p in w.split("-")) for w in name.split(" "))
            """),
        "overlooks hyphens": text("""
            def initials(name):
                return "".join(word[0].upper() + "." for word in name.split())
            """),
        "leaves small letters small": text("""
            def initials(name):
                return "".join("-".join(p[0] + "." for p in w.split("-")) for w in name.split())
            """),
    },
    calls=[
        ("ada king lovelace",),
        ("jean-luc picard",),
        ("  grace   hopper ",),
        ("",),
        ("Plato",),
        ("anna-maria van der-berg",),
        ("\tmax\nmoritz",),
    ],
)

SECOND = Problem(
    id="second-largest",
    level=1,
    statement=text("""
        Write a function second_largest(values) that returns the second largest of the different numbers in a list: of
        [5, 1, 5, 3] that is 3. If the list has fewer than two different numbers, it returns None.
        """),
    function="second_largest",
    reference=text("""
        def second_largest(values):
            different = sorted(set(values))
            return different[-2] if len(different) > 1 else None
        """),
    wrong={
        "counts the largest twice": text("""
            def second_largest(values):
                return sorted(values)[-2] if len(values) > 1 else None
            """),
        "takes 0 for nothing": text("""
            def second_largest(values):
                largest = max(values, default=0)
                return max((value for value in values if value != largest), default=0) or None
            """),
        "starts from 0": text("""
            def second_largest(values):
                first = second = 0
                for value in values:
                    if value > first:
                        first, second = value, first
                    elif second < value < first:
                        second = value
                return second if len(set(values)) > 1 else None
            """),
    },
    calls=[
        ([5, 1, 5, 3],),
        ([],),
        ([4],),
        ([4, 4],),
        ([0, 7],),
        ([-3, -1, -2],),
        (numbers(40, 200, -50, 50),),
        ([2, 1],),
    ],
)

DIGITS = Problem(
    id="digit-count",
    level=1,
    statement=text("""
        Write a function digit_count(n, digit) that returns how often a digit (0 to 9) is written when all whole numbers
        from 0 to n are written down. digit_count(11, 1) is 4: in 1, once in 10, and twice in 11. n is at most 100000.
        """),
    function="digit_count",
    reference=text("""
        def digit_count(n, digit):
            return sum(str(number).count(str(digit)) for number in range(n + 1))
        """),
    wrong={
        "leaves out n itself": text("""
            def digit_count(n, digit):
                return sum(str(number).count(str(digit)) for number in range(n))
            """),
        "counts a number once that has the digit twice": text("""
            def digit_count(n, digit):
                return sum(str(digit) in str(number) for number in range(n + 1))
            """),
        "does not write the number 0": text("""
            def digit_count(n, digit):
                return sum(str(number).count(str(digit)) for number in range(1, n + 1))
            """),
    },
    calls=[(11, 1), (0, 0), (0, 5), (100, 0), (99, 9), (2024, 2), (100_000, 7)],
)

ROTATE = Problem(
    id="rotate",
    level=1,
    statement=text("""
        Write a function rotate(items, k) that returns a new list with all items moved k places to the right; those that
        leave at the end come back in at the front. A negative k moves them to the left, k may be larger than the list
        is long, and the list may be empty.
        """),
    function="rotate",
    reference=text("""
        def rotate(items, k):
            if not items:
                return []
            k %= len(items)
            return items[-k:] + items[:-k] if k else list(items)
        """),
    wrong={
        "moves to the left": text("""
            def rotate(items, k):
                k = k % len(items) if items else 0
                return items[k:] + items[:k]
            """),
        "does not take k modulo the length": text("""
            def rotate(items, k):
                return items[-k:] + items[:-k]
            """),
        "fails on an empty list": text("""
            def rotate(items, k):
                k %= len(items)
                return items[len(items) - k :] + items[: len(items) - k]
            """),
    },
    calls=[([1, 2, 3, 4], 1), ([1, 2, 3], 0), ([1, 2, 3], 7), ([1, 2, 3, 4], -1), ([], 5), (["a"], 3), ([1, 2], -5)],
    check_form=False,
)

RUNS = Problem(
    id="run-lengths",
    level=1,
    statement=text("""
        Write a function run_lengths(text) that returns a list of pairs (character, length), one for each stretch of
        equal neighbouring characters, in their order: "aab" gives [("a", 2), ("b", 1)].
        """),
    function="run_lengths",
    reference=text("""
        from itertools import groupby


        def run_lengths(text):
            return [(character, len(list(group))) for character, group in groupby(text)]
        """),
    wrong={
        "forgets the last stretch": text("""
            def run_lengths(text):
                runs, count = [], 1
                for a, b in zip(text, text[1:]):
                    if a == b:
                        count += 1
                    else:
                        runs.append((a, count))
                        count = 1
                return runs
            """),
        "adds up all stretches of a character": text("""
            from collections import Counter


            def run_lengths(text):
                return list(Counter(text).items())
            """),
        "returns lists for pairs": text("""
            from itertools import groupby


            def run_lengths(text):
                return [[c, len(list(g))] for c, g in groupby(text)]
            """),
    },
    calls=[("aab",), ("",), ("x",), ("abab",), ("  !!",), ("zzzzzzzzzz",), (letters(41, 300, "ab"),)],
    check_form=False,
)

ROMAN = Problem(
    id="roman-number",
    level=2,
    statement=text("""
        Write a function roman(n) that returns a whole number from 1 to 3999 in Roman numerals, with the usual forms for
        four and nine: IV, IX, XL, XC, CD, CM. For any other number it raises ValueError.
        """),
    function="roman",
    reference=text("""
        SIGNS = [
            (1000, "M"), (900, "CM"), (500, "D"), (400, "CD"), (100, "C"), (90, "XC"), (50, "L"), (40, "XL"),
            (10, "X"), (9, "IX"), (5, "V"), (4, "IV"), (1, "I"),
        ]


        def roman(n):
            if not 1 <= n <= 3999:
                raise ValueError(f"{n} has no Roman form")
            written = ""
            for value, sign in SIGNS:
                count, n = divmod(n, value)
                written += sign * count
            return written
        """),
    wrong={
        "writes four as IIII": text("""
            def roman(n):
                if not 1 <= n <= 3999:
                    raise ValueError
                written = ""
                for value, sign in zip((1000, 500, 100, 50, 10, 5, 1), "MDCLXVI"):
                    count, n = divmod(n, value)
                    written += sign * count
                return written
            """),
        "writes numbers that have no Roman form": text("""
            def roman(n):
                ones = ["", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX"]
                tens = [c.translate(str.maketrans("IVX", "XLC")) for c in ones]
                hundreds = [c.translate(str.maketrans("IVX", "CDM")) for c in ones]
                return "M" * (n // 1000) + hundreds[n // 100 % 10] + tens[n // 10 % 10] + ones[n % 10]
            """),
    },
    calls=[(1,), (4,), (9,), (14,), (40,), (90,), (444,), (1994,), (3999,), (2026,)],
    more=text("""
        for n in (0, 4000, -3):
            try:
                candidate(n)
                raised = False
            except ValueError:
                raised = True
            assert raised
        """),
)

MERGE = Problem(
    id="merge-sorted",
    level=2,
    statement=text("""
        Write a function merge_sorted(first, second) that joins two lists of numbers, each in ascending order, into one
        new list in ascending order. Every number is kept, those that occur several times too, and the two lists that
        were given stay as they are.
        """),
    function="merge_sorted",
    reference=text("""
        from heapq import merge


        def merge_sorted(first, second):
            return list(merge(first, second))
        """),
    wrong={
        "keeps equal numbers once": text("""
            def merge_sorted(first, second):
                return sorted(set(first) | set(second))
            """),
        "empties the given lists": text("""
            def merge_sorted(first, second):
                merged = []
                while first and second:
                    merged.append(first.pop(0) if first[0] <= second[0] else second.pop(0))
                return merged + first + second
            """),
        "forgets what is left of the longer list": text("""
            def merge_sorted(first, second):
                merged, i, j = [], 0, 0
                while i < len(first) and j < len(second):
                    if first[i] <= second[j]:
                        merged.append(first[i])
                        i += 1
                    else:
                        merged.append(second[j])
                        j += 1
                return merged
            """),
    },
    calls=[
        ([1, 3], [2, 4]),
        ([], []),
        ([], [1]),
        ([1, 1], [1]),
        ([1, 2, 3], [10]),
        ([-5, 0], [-5, 0]),
        (sorted(numbers(42, 100, 0, 60)), sorted(numbers(43, 80, 0, 60))),
    ],
    more=text("""
        first, second = [1, 4], [2, 3]
        assert candidate(first, second) == [1, 2, 3, 4]
        assert (first, second) == ([1, 4], [2, 3])
        """),
)

PROBLEMS = [CLAMP, INITIALS, SECOND, DIGITS, ROTATE, RUNS, ROMAN, MERGE]
