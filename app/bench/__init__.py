"""The first day with a tool: is it wired as its file says?"""
