"""Modules that run inside the simulator (``tb_*``), and the tests that start them."""
