"""missionsim.published"""
