"""The command line.

`main` is the process and its exit codes, `grammar` its verbs and options, `verbs` has a function
for each verb, `texts` for those that run nothing. `places` says where results go, `streams` what
stdout and stderr do where they cannot be written, `terminal` how texts look on one, `completion`
what shells complete.
"""
