"""missionsim.uncertainty"""
