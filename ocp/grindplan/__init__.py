"""`grindplan COMMAND`: all commands under one name, as pip installs it.

Here: the names of the commands, and the list that `grindplan --help` and a shell's completion show. Not here: anything that a
command does; a command's room is imported when it is called.
"""
