"""Terms: materials, growth, loads, ground, pressure, supports. Knows no scene."""
