"""How good a scanner is: the paper's own tests, and artefacts of known size. ``docs/validation.md`` explains each."""
