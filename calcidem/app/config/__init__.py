"""The frozen configuration of a campaign, its reader of TOML files, and its checks."""
