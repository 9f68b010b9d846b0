"""What happened, measured or simulated: runs, their covariates, how they drive a model, motion and errors."""
