"""Between the domain of the pixels and the card's: one kind of signal a file, each with its contract."""
