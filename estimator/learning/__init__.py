"""Tissue libraries from recordings: what a grasp's loading curve tells, how it scatters, and what that makes likely.

Mathematics alone: files and the command line are in `app.learn`.
"""
