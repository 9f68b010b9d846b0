"""Effects: named power terms in watts, pure functions of covariates and parameters."""
