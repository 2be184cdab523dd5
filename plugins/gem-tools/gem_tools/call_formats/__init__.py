"""The forms in which model families are trained to call tools, as their chat templates write them.

``table`` has a record for each family: how its calls begin, and which reader takes them from there. ``readers`` holds
these; each finds a ``ParsedCall``, which ``found`` makes a call of a tool. ``values`` reads what calls hold. All take
any text, in time that grows with its length alone, and raise nothing.
"""
