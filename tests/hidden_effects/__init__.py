"""An independent little world with hidden effects, its scorer and its peers."""
