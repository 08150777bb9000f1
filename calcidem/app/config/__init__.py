"""What a campaign is: the frozen configuration, how it is read from a TOML file, and what is refused."""
