"""missionsim.plan"""
