"""The command line: a module for each group of commands; a command is a function `<name>_command`."""
