"""Laws that no library holds, hidden in logs of the little world, and how often the proposal is right."""
