"""From a robot and its logs to a verdict: which physical effect is missing, or what to drive to find out."""
