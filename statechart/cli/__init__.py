"""The command line.

`main` is the grammar and the exit codes, `verbs` has a function for each verb, `streams` is what
stdout and stderr do where they cannot be written.
"""
