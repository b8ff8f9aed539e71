"""Image sources and what watches them."""
