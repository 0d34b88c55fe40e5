"""Tissue libraries from recordings: what a grasp's loading curve tells, how it scatters, and what that makes likely.

Mathematics alone: files are in `app.analysis.learning`.
"""
