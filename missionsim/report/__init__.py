"""missionsim.report"""
