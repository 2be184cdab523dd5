"""Whole programs on brackets, intervals, words and boards."""

from __future__ import annotations

import random

from code_problems.problem import Problem, letters, numbers, text


def _intervals(seed: int, count: int, high: int, longest: int) -> str:
    starts, lengths = numbers(seed, count, 0, high), numbers(seed + 1, count, 1, longest)
    return f"{count}\n" + "".join(f"{a} {a + length}\n" for a, length in zip(starts, lengths, strict=True))


def _board(seed: int, rows: int, columns: int, share: float) -> str:
    generator = random.Random(seed)
    board = ["".join("~" if generator.random() < share else "." for _ in range(columns)) for _ in range(rows)]
    return f"{rows} {columns}\n" + "\n".join(board) + "\n"


BRACKETS = Problem(
    id="bracket-check",
    level=2,
    statement=text("""
        Check the brackets ( ) [ ] { } of a text; all other characters do not matter. A closing bracket must close the
        bracket that was opened last and is not closed yet, and that must be of the same kind.

        Input: one line of 0 to 100000 characters.
        Output: OK if all is well. Else the place of the first closing bracket that is wrong, counted from 1. If no
        closing bracket is wrong but some brackets stay open, the place of the leftmost one that stays open.
        """),
    reference=text("""
        import sys

        line = sys.stdin.readline().rstrip("\\n")
        pairs = {")": "(", "]": "[", "}": "{"}
        stack = []
        wrong = 0
        for place, character in enumerate(line, start=1):
            if character in "([{":
                stack.append((character, place))
            elif character in pairs:
                if not stack or stack.pop()[0] != pairs[character]:
                    wrong = place
                    break
        if not wrong and stack:
            wrong = stack[0][1]
        print(wrong or "OK")
        """),
    wrong={
        "counts each kind by itself": text("""
            line = input()
            fine = all(line.count(a) == line.count(b) for a, b in ("()", "[]", "{}"))
            print("OK" if fine else 1)
            """),
        "names the rightmost bracket that stays open": text("""
            line = input()
            pairs, stack, wrong = {")": "(", "]": "[", "}": "{"}, [], 0
            for place, c in enumerate(line, 1):
                if c in "([{":
                    stack.append((c, place))
                elif c in pairs and (not stack or stack.pop()[0] != pairs[c]):
                    wrong = place
                    break
            print(wrong or (stack[-1][1] if stack else "OK"))
            """),
        "forgets brackets that stay open": text("""
            line = input()
            pairs, stack = {")": "(", "]": "[", "}": "{"}, []
            for place, c in enumerate(line, 1):
                if c in "([{":
                    stack.append(c)
                elif c in pairs and (not stack or stack.pop() != pairs[c]):
                    print(place)
                    break
            else:
                print("OK")
            """),
    },
    inputs=[
        "f(a[1], {b: (c)})\n",
        "(]\n",
        "([)]\n",
        "((a)(b\n",
        ")\n",
        "\n",
        "no brackets at all\n",
        "(" * 4000 + ")" * 4000 + "\n",
        "[" + "{}" * 2000 + "(()" + "\n",
        f"{letters(10, 500, '()')}\n",
    ],
)

WALL = Problem(
    id="painted-wall",
    level=2,
    statement=text("""
        Painters work along one straight wall. Each paints a stretch from metre a to metre b; stretches may overlap,
        touch or lie apart. How many metres of the wall are painted in the end?

        Input: the number n of stretches (1 to 100000), then n lines with a and b (0 <= a < b <= 10^9).
        Output: the number of painted metres.
        """),
    reference=text("""
        import sys

        data = list(map(int, sys.stdin.read().split()))
        stretches = sorted(zip(data[1::2], data[2::2]))
        total, end = 0, 0
        for a, b in stretches:
            total += max(0, b - max(a, end))
            end = max(end, b)
        print(total)
        """),
    wrong={
        "adds up what overlaps": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            print(sum(b - a for a, b in zip(data[1::2], data[2::2])))
            """),
        "forgets a long stretch once a short one inside of it has ended": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            total, end = 0, 0
            for a, b in sorted(zip(data[1::2], data[2::2])):
                total += max(0, b - max(a, end))
                end = b
            print(total)
            """),
        "takes the stretches to be in order": text("""
            import sys
            data = list(map(int, sys.stdin.read().split()))
            total, end = 0, 0
            for a, b in zip(data[1::2], data[2::2]):
                total += max(0, b - max(a, end))
                end = max(end, b)
            print(total)
            """),
    },
    inputs=[
        "2\n0 5\n3 8\n",
        "2\n10 20\n0 5\n",
        "3\n0 100\n10 20\n30 40\n",
        "2\n0 5\n5 9\n",
        "1\n0 1000000000\n",
        "3\n1 2\n1 2\n1 2\n",
        _intervals(11, 500, 10_000, 40),
        _intervals(13, 1000, 1_000_000, 5000),
    ],
)

WORDS = Problem(
    id="frequent-words",
    level=2,
    statement=text("""
        List the k most frequent words of a text. Words are separated by white space; capitals and small letters are the
        same. Of words that are equally frequent, the one that comes first in the alphabet is listed first.

        Input: a line with k (1 to 100), then one or more lines of text made of letters and white space.
        Output: up to k lines, each with a word in small letters and how often it occurs.
        """),
    reference=text("""
        import sys
        from collections import Counter

        k, _, rest = sys.stdin.read().partition("\\n")
        counts = Counter(rest.lower().split())
        for word, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))[: int(k)]:
            print(word, count)
        """),
    wrong={
        "lists equally frequent words as they come": text("""
            import sys
            from collections import Counter
            k, _, rest = sys.stdin.read().partition("\\n")
            for word, count in Counter(rest.lower().split()).most_common(int(k)):
                print(word, count)
            """),
        "tells capitals from small letters": text("""
            import sys
            from collections import Counter
            k, _, rest = sys.stdin.read().partition("\\n")
            counts = Counter(rest.split())
            for word, count in sorted(counts.items(), key=lambda i: (-i[1], i[0]))[: int(k)]:
                print(word, count)
            """),
        "reads one line of the text": text("""
            from collections import Counter
            k = int(input())
            counts = Counter(input().lower().split())
            for word, count in sorted(counts.items(), key=lambda i: (-i[1], i[0]))[:k]:
                print(word, count)
            """),
    },
    inputs=[
        "2\nthe cat and the dog and the bird\n",
        "3\nzeta alpha zeta alpha mid\n",
        "5\nOne one ONE two\nTwo three\n",
        "10\nsingle\n",
        "1\nb a\n",
        "4\n  spaces   between\twords words\n\nspaces\n",
        "20\n" + " ".join(letters(seed, 2, "abcd") for seed in range(400)) + "\n",
    ],
)

ROBOT = Problem(
    id="robot-walk",
    level=2,
    statement=text("""
        A robot stands on a square board of n by n fields, on the field in column 1 of row 1, and looks east. Columns
        are counted eastwards, rows southwards. It obeys letters: F is one step forwards (it stays where it is if that
        would lead off the board), R a turn to the right, L a turn to the left.

        Input: a line with n (1 to 10^6), and a line with 1 to 100000 letters.
        Output: its column, its row, and N, E, S or W for where it looks in the end.
        """),
    reference=text("""
        n = int(input())
        column, row, heading = 1, 1, 1
        steps = [(0, -1), (1, 0), (0, 1), (-1, 0)]
        for letter in input().strip():
            if letter == "R":
                heading = (heading + 1) % 4
            elif letter == "L":
                heading = (heading - 1) % 4
            else:
                dx, dy = steps[heading]
                column = min(n, max(1, column + dx))
                row = min(n, max(1, row + dy))
        print(column, row, "NESW"[heading])
        """),
    wrong={
        "walks round the edge to the other side": text("""
            n = int(input())
            x, y, h = 0, 0, 1
            for c in input().strip():
                if c == "F":
                    dx, dy = [(0, -1), (1, 0), (0, 1), (-1, 0)][h]
                    x, y = (x + dx) % n, (y + dy) % n
                else:
                    h = (h + (1 if c == "R" else -1)) % 4
            print(x + 1, y + 1, "NESW"[h])
            """),
        "counts rows northwards": text("""
            n = int(input())
            x, y, h = 1, 1, 1
            for c in input().strip():
                if c == "F":
                    dx, dy = [(0, 1), (1, 0), (0, -1), (-1, 0)][h]
                    x, y = min(n, max(1, x + dx)), min(n, max(1, y + dy))
                else:
                    h = (h + (1 if c == "R" else -1)) % 4
            print(x, y, "NESW"[h])
            """),
    },
    inputs=[
        "5\nFFRFF\n",
        "3\nFFFFF\n",
        "1\nFRFRFRF\n",
        "4\nLF\n",
        "10\nRFFFLFFRRRR\n",
        "2\nL\n",
        f"50\n{letters(15, 3000, 'FFFFRL')}\n",
        f"7\n{letters(16, 3000, 'FFFRL')}\n",
    ],
)

LAKES = Problem(
    id="lakes",
    level=2,
    statement=text("""
        A map is made of fields: water ~ and land . (a dot). Fields of water that touch along a side belong to the same
        lake; those that touch at a corner alone do not.

        Input: a line with the numbers of rows and columns (1 to 300 each), then the rows of the map.
        Output: the number of lakes, and the number of fields of the largest one (0 if there is none).
        """),
    reference=text("""
        rows, columns = map(int, input().split())
        board = [input().strip() for _ in range(rows)]
        seen = [[False] * columns for _ in range(rows)]
        lakes = largest = 0
        for r in range(rows):
            for c in range(columns):
                if board[r][c] != "~" or seen[r][c]:
                    continue
                lakes += 1
                size, stack, seen[r][c] = 0, [(r, c)], True
                while stack:
                    y, x = stack.pop()
                    size += 1
                    for v, u in ((y + 1, x), (y - 1, x), (y, x + 1), (y, x - 1)):
                        if 0 <= v < rows and 0 <= u < columns and board[v][u] == "~" and not seen[v][u]:
                            seen[v][u] = True
                            stack.append((v, u))
                largest = max(largest, size)
        print(lakes, largest)
        """),
    wrong={
        "lets lakes meet at corners": text("""
            rows, columns = map(int, input().split())
            water = {(r, c) for r in range(rows) for c, f in enumerate(input().strip()) if f == "~"}
            sizes = []
            while water:
                stack, size = [water.pop()], 0
                while stack:
                    r, c = stack.pop()
                    size += 1
                    for n in [(r + a, c + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]:
                        if n in water:
                            water.remove(n)
                            stack.append(n)
                sizes.append(size)
            print(len(sizes), max(sizes, default=0))
            """),
        "calls itself too deeply on large lakes": text("""
            rows, columns = map(int, input().split())
            board = [list(input().strip()) for _ in range(rows)]

            def fill(r, c):
                if not (0 <= r < rows and 0 <= c < columns) or board[r][c] != "~":
                    return 0
                board[r][c] = "."
                return 1 + fill(r + 1, c) + fill(r - 1, c) + fill(r, c + 1) + fill(r, c - 1)

            sizes = [size for r in range(rows) for c in range(columns) if (size := fill(r, c))]
            print(len(sizes), max(sizes, default=0))
            """),
        "fails on a map without water": text("""
            rows, columns = map(int, input().split())
            water = {(r, c) for r in range(rows) for c, f in enumerate(input().strip()) if f == "~"}
            sizes = []
            while water:
                stack, size = [water.pop()], 0
                while stack:
                    r, c = stack.pop()
                    size += 1
                    for n in ((r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)):
                        if n in water:
                            water.remove(n)
                            stack.append(n)
                sizes.append(size)
            print(len(sizes), max(sizes))
            """),
    },
    inputs=[
        "3 4\n~~..\n..~.\n~~.~\n",
        "1 1\n.\n",
        "1 1\n~\n",
        "2 2\n~.\n.~\n",
        "2 3\n...\n...\n",
        "60 60\n" + "\n".join(["~" * 60] * 60) + "\n",
        _board(17, 40, 50, 0.5),
        _board(18, 80, 30, 0.62),
    ],
)

PROBLEMS = [BRACKETS, WALL, WORDS, ROBOT, LAKES]
