"""missionsim."""
