"""The command line.

`main` is the process and its exit codes; `grammar` its verbs and options, and their completion in
shells; `verbs` has a function for each verb, of which `ahead_of_time` compiles all kernels.
`output_files` checks the files that they write, `streams` are stdout and stderr, with their errors
explained.
"""
