"""The command line.

`main` is the grammar and the exit codes, `verbs` has a function for each verb, `places` says where
results go, `streams` is what stdout and stderr do where they cannot be written.
"""
