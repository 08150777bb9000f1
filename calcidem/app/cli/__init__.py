"""The command line: a module for each group of commands, each the function `<name>_command`."""
