"""Fuzzers: each a program of its own for a long run, with a short one in ``make test``."""
