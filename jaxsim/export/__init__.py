"""From a law in Python to the machine it runs on."""
