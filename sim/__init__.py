"""The virtual card: the gateware in Verilator, with scene, camera and motor around it."""
