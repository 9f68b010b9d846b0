"""Physics: bare functions of scalars or arrays, inputs first and parameters after, SI units, NumPy alone."""
