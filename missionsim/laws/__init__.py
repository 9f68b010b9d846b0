"""When no effect of the library fits: laws proposed from the data, as formulas that a robot file can hold."""
