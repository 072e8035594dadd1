"""The command line.

`main` is the process and its exit codes, `grammar` its verbs and options, `verbs` has a function
for each verb, `studies` for those that run a model many times, `texts` for those that run nothing,
`ahead_of_time` for the compilation of all kernels.
`arguments` are what they ask for, `places` where results go; `streams` says what stdout and stderr
do where they cannot be written, `terminal` how texts look on one, `completion` what shells
complete.
"""
