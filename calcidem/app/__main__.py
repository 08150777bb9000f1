"""`python -m calcidem.app`: the command line, for launchers that start Python."""

from calcidem.app.command_line import main

main()
