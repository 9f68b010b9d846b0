"""missionsim.engine"""
