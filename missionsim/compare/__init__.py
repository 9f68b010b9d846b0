"""missionsim.compare"""
