"""A card tests itself: ``magtrak self-test``. One idea per module; :mod:`.run` has them in order.

Each check is a function of a :class:`~.bench.Bench`, documented with what it looks at; it returns what it found, in a
few words, or raises :class:`~.bench.FailedError` or :class:`~.bench.NotTriedError`.
"""
