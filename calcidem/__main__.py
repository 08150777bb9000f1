"""`python -m calcidem`: the command line, for launchers that start Python."""

from calcidem.app.cli.main import main

if __name__ == "__main__":
    main()
