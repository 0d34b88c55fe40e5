"""A tool on the bench: is it wired as its file says, and does it do what it should?"""
